"""Machine code in memory, and its functions for Python."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pgm.kernels.machine.emitter.checks import FAULT
from pgm.kernels.machine.emitter.kinds import Kind, symbol
from pgm.kernels.machine.emitter.processor import layout, llvm, target_machine

# A process that forks while a thread is inside LLVM leaves its child LLVM's lock, taken for good.
_LOCK: Any = getattr(llvm().ffi.lib, "_lock", None)
if _LOCK is not None and hasattr(os, "register_at_fork"):

    def _release() -> None:
        _LOCK.__exit__(None, None, None)

    os.register_at_fork(before=_LOCK.__enter__, after_in_parent=_release, after_in_child=_release)


class Compiled:
    """Machine code in memory, kept as long as this object is."""

    def __init__(
        self,
        text: str,
        signatures: Mapping[str, tuple[Sequence[Kind], Kind | None]],
        faults: Sequence[str],
        level: int,
    ) -> None:
        self._signatures, self._faults = dict(signatures), tuple(faults)
        self._engine = _engine(f"{layout()}\n{text}", level)
        self._addresses: dict[str, int] = {
            name: self._engine.get_function_address(symbol(name)) for name in signatures
        }
        self._fault = self._engine.get_global_value_address(FAULT) if faults else 0

    def address(self, name: str) -> int:
        """The address of a function, good as long as this object is kept."""
        return self._addresses[name]

    def callable(self, name: str) -> Callable[..., Any]:
        """The function for Python, which releases the GIL; it keeps the machine code alive.

        It takes an address as an int or None, and has whole numbers and floats as Python does.
        """
        arguments, result = self._signatures[name]
        kind = ctypes.CFUNCTYPE(result and result.in_c, *(each.in_c for each in arguments))
        function: Any = kind(self._addresses[name])
        function.machine = self
        return self._checked(function) if self._faults else function

    def fault(self) -> str | None:
        """The first fault of checked code since the last question, in words."""
        if not self._fault:
            return None
        place = (ctypes.c_int64 * 3).from_address(self._fault)
        number, index, length = place
        place[0] = 0
        return self._faults[number - 1].format(index, length) if number else None

    def _checked(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def checked(*given: Any) -> Any:
            found = function(*given)
            fault = self.fault()
            if fault:
                raise IndexError(fault)
            return found

        return checked


# The passes of levels 0 and 1: numbers into registers, inlining, and no search beyond a block.
_LIGHT = ("always_inliner", "sroa", "simplify_cfg")


def _engine(text: str, level: int) -> Any:
    """Parse, optimise and compile a module."""
    machine = target_machine(level)
    module = llvm().parse_assembly(text)
    module.verify()
    tuning = llvm().create_pipeline_tuning_options(speed_level=level)
    # Packs are made as code is written, and sums side by side; LLVM's search for more takes longer
    # than it brings.
    tuning.slp_vectorization = tuning.loop_vectorization = tuning.loop_unrolling = False
    builder = llvm().create_pass_builder(machine, tuning)
    if level < 2:
        passes = llvm().create_new_module_pass_manager()
        for name in _LIGHT:
            getattr(passes, f"add_{name}_pass")()
    else:
        passes = builder.getModulePassManager()
    passes.run(module, builder)
    engine = llvm().create_mcjit_compiler(module, machine)
    engine.finalize_object()
    return engine
