"""The processor that code runs on, and the libraries of C that it calls."""

from __future__ import annotations

import ctypes.util
import sys
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.wholes import Address

# Where C's functions are, by platform; elsewhere the search for them may start a compiler.
_LIBRARIES = {"linux": "libm.so.6", "darwin": "libSystem.B.dylib", "win32": "ucrtbase.dll"}


@cache
def llvm() -> Any:
    """The bindings of LLVM, loaded when they are first needed: importing pgm does not."""
    from llvmlite import binding

    return binding


@cache
def prepare() -> None:
    """Make LLVM ready for this processor, and C's functions known to it."""
    llvm().initialize_native_target()
    llvm().initialize_native_asmprinter()
    _loaded(_LIBRARIES.get(sys.platform) or ctypes.util.find_library("m") or "")


def target_machine(level: int) -> Any:
    """LLVM's description of this processor; each engine owns one."""
    prepare()
    return (
        llvm()
        .Target.from_default_triple()
        .create_target_machine(
            cpu=llvm().get_host_cpu_name(),
            features=llvm().get_host_cpu_features().flatten(),
            opt=level,
            jit=True,
        )
    )


@cache
def layout() -> str:
    """How values lie in memory, as modules say it."""
    machine = target_machine(0)
    return f'target datalayout = "{machine.target_data}"\ntarget triple = "{machine.triple}"'


class Processor:
    """The processor at hand, as a `Target`."""

    exported = "define"

    def scalar_function(self, name: str) -> str:
        """The name of a function of C's that is there; LLVM would end the process for want of it.

        Raises an OSError where it is not.
        """
        return _known(name)

    def vector_function(self, name: str, arguments: int, lanes: int) -> tuple[str, int] | None:
        """The symbol of C's function for packs, and of how many lanes; None where there is none."""
        for width, prefix in _widths():
            symbol = f"{prefix}{'v' * arguments}_{name}"
            if lanes % width == 0 and llvm().address_of_symbol(symbol) is not None:
                return symbol, width
        return None

    def pointed(self, address: Address) -> Address:
        """An address that has been read from memory."""
        return address

    @property
    def registers(self) -> tuple[int, int]:
        """The floats of a register for vectors, and how many of them there are."""
        return _registers()


PROCESSOR = Processor()


@cache
def _known(name: str) -> str:
    prepare()
    if llvm().address_of_symbol(name) is None:
        raise OSError(f"C's function {name} is not found; machine code cannot be made with it")
    return name


@cache
def _registers() -> tuple[int, int]:
    has = llvm().get_host_cpu_features().get
    if has("avx512f"):
        return 8, 32
    return (4, 16) if has("avx") else (2, 32 if has("neon") else 16)


@cache
def _widths() -> tuple[tuple[int, str], ...]:
    """The widths of vectors of glibc's library on this processor, widest first."""
    prepare()
    if not _loaded("libmvec.so.1"):
        return ()
    has = llvm().get_host_cpu_features().get
    known = ((8, "_ZGVeN8", "avx512f"), (4, "_ZGVdN4", "avx2"))
    return tuple((width, prefix) for width, prefix, feature in known if has(feature))


def _loaded(library: str) -> bool:
    try:
        llvm().load_library_permanently(library)
    except RuntimeError:
        return False
    return True
