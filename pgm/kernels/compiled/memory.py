"""Memory and functions by their addresses: kernels are compiled once, whatever they are given."""

from __future__ import annotations

from pathlib import Path
from threading import Lock
from typing import Any
from zlib import crc32

from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

# Of the text of all kernels: code on disk is of this text, or is not loaded.
STAMP = crc32(b"".join(file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py"))))
Numbers = types.CPointer(types.float64)
Places = types.CPointer(types.int64)


def _viewed(pointer: Any) -> Any:
    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return pointer(types.int64), made


_LOCK = Lock()


def ready(kernel: Any, signature: str) -> Any:
    """A kernel, compiled for a signature or loaded from the disk.

    LLVM's second level makes of these short loops what the third does, in three quarters of the
    time, and without vectorised loops, which are for long ones.
    """
    with _LOCK:
        if not kernel.signatures:
            before = config.OPT, config.LOOP_VECTORIZE
            config.OPT, config.LOOP_VECTORIZE = type(config.OPT)(2), 0
            try:
                kernel.compile(signature)
            finally:
                config.OPT, config.LOOP_VECTORIZE = before
    return kernel


@intrinsic
def numbers(typing: Any, address: Any) -> Any:
    """The floats at an address."""
    return _viewed(Numbers)


@intrinsic
def places(typing: Any, address: Any) -> Any:
    """The integers at an address."""
    return _viewed(Places)


@intrinsic
def past(typing: Any, pointer: Any, count: Any) -> Any:
    """The floats, or integers, so many on."""

    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.gep(arguments[0], [arguments[1]])

    return pointer(pointer, types.int64), made


@intrinsic
def call(typing: Any, address: Any, x: Any, u: Any, value: Any, slope: Any) -> Any:
    """Call the function at an address: ``f(x, u, value, slope)`` writes the last two."""

    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointers = [argument.type for argument in arguments[1:]]
        kind = ir.FunctionType(ir.VoidType(), pointers)
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        builder.call(function, arguments[1:])
        return context.get_dummy_value()

    return types.void(types.int64, Numbers, Numbers, Numbers, Numbers), made
