"""Machine code in memory, and its functions for Python."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from llvmlite import binding

from pgm.kernels.machine.checks import FAULT
from pgm.kernels.machine.kinds import Kind, symbol
from pgm.kernels.machine.processor import layout, target_machine

# Held while LLVM works, and while a process forks: a child would wait for a thread it has not.
_COMPILING = threading.Lock()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_COMPILING.acquire,
        after_in_parent=_COMPILING.release,
        after_in_child=_COMPILING.release,
    )


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
        with _COMPILING:
            self._engine = _engine(f"{layout()}\n{text}", level)
            self._addresses = {
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


def _engine(text: str, level: int) -> Any:
    """Parse, optimise and compile a module."""
    machine = target_machine(level)
    module = binding.parse_assembly(text)
    module.verify()
    tuning = binding.create_pipeline_tuning_options(speed_level=level)
    # Packs are made as code is written, and sums side by side; LLVM's search for more takes longer
    # than it brings.
    tuning.slp_vectorization = tuning.loop_vectorization = tuning.loop_unrolling = False
    builder = binding.create_pass_builder(machine, tuning)
    builder.getModulePassManager().run(module, builder)
    engine = binding.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    return engine
