"""Memory and functions by their addresses: kernels are compiled once, whatever they are given."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any
from zlib import crc32

from llvmlite import ir
from numba import config, njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from pgm.kernels.compiled.packs import NUMBERS, ROW_PACK, RUN_PACK, Packs, bits, opposite, splat
from pgm.kernels.compiled.store import Store, Unkept
from pgm.kernels.compiled.tables import RUNS

# Of the text of all kernels: code on disk is of this text, or is not loaded.
STAMP = crc32(b"".join(file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py"))))
PLACES = types.CPointer(types.int64)
# They are called by each other alone, and hold no object of Python's.
_OPTIONS: Any = {"error_model": "numpy", "nogil": True, "_nrt": False}
_kernel: Any = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **_OPTIONS)
inlined: Any = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True, **_OPTIONS)
_LOCK = Lock()


def compiled(function: Callable[..., Any]) -> Any:
    """A kernel, which is compiled once for whole numbers, whatever literals it is called with."""
    kernel = _kernel(function)
    general = kernel.get_call_template
    kernel.get_call_template = lambda args, kws: general([types.unliteral(k) for k in args], kws)
    return kernel


def kept(function: Callable[..., Any], name: str, **options: Any) -> Any:
    """A kernel that Python calls, kept on the disk by its name where a folder takes it."""
    kernel = njit(error_model="numpy", **options)(function)
    try:
        kernel._cache = Store(function, name)
    except RuntimeError:
        kernel._cache = Unkept()
    return kernel


@compiled
def some(truth):
    """Whether one of a pack of truths is."""
    return bits(truth) != 0


@compiled
def every(truth):
    """Whether all of a pack of truths are."""
    return bits(opposite(truth)) == 0


def ready(kernel: Any, signature: str) -> None:
    """Compile a kernel for a signature, or load it from the disk.

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


def _seen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    target, value = context.get_value_type(signature.return_type), arguments[0]
    whole = isinstance(value.type, ir.IntType)
    return builder.inttoptr(value, target) if whole else builder.bitcast(value, target)


@intrinsic
def numbers(typing: Any, place: Any) -> Any:
    """The floats at an address or a pointer."""
    return NUMBERS(place), _seen


@intrinsic
def places(typing: Any, address: Any) -> Any:
    """The integers at an address."""
    return PLACES(address), _seen


@intrinsic
def by_row(typing: Any, pointer: Any) -> Any:
    """Rows of floats as packs; packs of runs stay as they are."""
    return (pointer if isinstance(pointer, Packs) else Packs(ROW_PACK))(pointer), _seen


@intrinsic(prefer_literal=True)
def opened(typing: Any, address: Any, count: Any) -> Any:
    """The floats, or packs of as many runs, at an address."""
    kind = NUMBERS if count.literal_value == 1 else Packs(RUN_PACK)
    return kind(address, count), _seen


@intrinsic
def past(typing: Any, pointer: Any, count: Any) -> Any:
    """The pointer so many on."""

    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.gep(arguments[0], [arguments[1]])

    return pointer(pointer, types.int64), made


@intrinsic
def call(typing: Any, address: Any, x: Any, u: Any, apart: Any, value: Any, slope: Any) -> Any:
    """Call the function at an address, which writes its value and its slope."""

    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [argument.type for argument in arguments[1:]])
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        builder.call(function, arguments[1:])
        return context.get_dummy_value()

    return types.void(types.int64, x, u, types.int64, value, slope), made


@intrinsic
def take(typing: Any, source: Any, here: Any, apart: Any, like: Any) -> Any:
    """A float of a run, or those of as many as a pointer has packs of, so far apart."""

    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, here, apart, _ = arguments
        first = builder.gep(source, [here])
        if not isinstance(like, Packs):
            return builder.load(first)
        kind = context.get_value_type(RUN_PACK)
        found = cgutils.alloca_once(builder, kind)
        with builder.if_else(_is(builder, apart, 1)) as (near, far):
            with near:
                pack = builder.load(builder.bitcast(first, kind.as_pointer()), align=8)
                builder.store(pack, found)
            with far, builder.if_else(_is(builder, apart, 0)) as (same, other):
                with same:
                    builder.store(splat(builder, builder.load(first), RUNS), found)
                with other:
                    pack = ir.Constant(kind, ir.Undefined)
                    for k in range(RUNS):
                        value = builder.load(builder.gep(source, [here]))
                        pack = builder.insert_element(pack, value, ir.Constant(ir.IntType(32), k))
                        here = builder.add(here, apart)
                    builder.store(pack, found)
        return builder.load(found)

    return like.dtype(source, types.int64, types.int64, like), made


@intrinsic
def give(typing: Any, target: Any, here: Any, apart: Any, value: Any, like: Any) -> Any:
    """Put a float of a run, or those of as many as a pointer has packs of, so far apart."""

    def made(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target, here, apart, value, _ = arguments
        first = builder.gep(target, [here])
        if not isinstance(like, Packs):
            builder.store(value, first)
            return context.get_dummy_value()
        with builder.if_else(_is(builder, apart, 1)) as (near, far):
            with near:
                builder.store(value, builder.bitcast(first, value.type.as_pointer()), align=8)
            with far:
                for k in range(RUNS):
                    each = builder.extract_element(value, ir.Constant(ir.IntType(32), k))
                    builder.store(each, builder.gep(target, [here]))
                    here = builder.add(here, apart)
        return context.get_dummy_value()

    return types.void(target, types.int64, types.int64, like.dtype, like), made


def _is(builder: Any, apart: Any, number: int) -> Any:
    return builder.icmp_signed("==", apart, ir.Constant(apart.type, number))
