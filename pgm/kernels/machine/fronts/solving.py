"""The machine code of fronts, compiled once a process, and its calls with NumPy's arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np

from pgm.kernels.arrays import Array, Integers
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.processor import PROCESSOR
from pgm.kernels.machine.fronts import back, rows, squares
from pgm.kernels.machine.fronts.plan import TOLD, Plan


@lru_cache(maxsize=1)
def _machine() -> dict[str, Callable[..., Any]]:
    module = Module()
    lanes = max(PROCESSOR.registers[0], 4)
    for part in (rows, squares, back):
        part.write(module, lanes)
    # Loops are written as they are to run: more of LLVM's passes make no faster code of them.
    compiled = module.compile(1)
    return {name: compiled.callable(name) for name in ("rows", "squares", "back")}


@dataclass(eq=False)
class Solver:
    """The memory in which a plan's problems of so many right sides are solved, one after another.

    Attributes
    ----------
    plan : Plan
    sides : int
        The number of right sides.
    """

    plan: Plan
    sides: int

    @cached_property
    def _lanes(self) -> int:
        return max(PROCESSOR.registers[0], 4)

    @cached_property
    def _table(self) -> tuple[Integers, list[Integers]]:
        """The addresses of a plan's arrays, and the arrays, which must outlive them."""
        found = []
        for name in TOLD:
            part = getattr(self.plan, name)
            if name == "keeps":
                part = self._keeps
            elif name == "waiting":
                part = part(self.sides)[0]
            found.append(np.ascontiguousarray(part, dtype=np.int64))
        return np.array([_address(part) for part in found], dtype=np.int64), found

    @cached_property
    def left(self) -> Array:
        """Where fronts leave rows to their parents, and those of a `KeepingPlan` stay."""
        return np.empty(self.plan.waiting(self.sides)[1] + 1)

    @cached_property
    def _work(self) -> Array:
        plan, lanes = self.plan, self._lanes
        size, pivots, shared = plan.sizes + self.sides, plan.pivots, plan.separators
        tall, rows = size + 2 * lanes, plan.rows + lanes
        up = np.maximum(rows * (size + 1), tall * (size + 1))
        pads = pivots + lanes
        down = tall * pivots + (shared + lanes) * shared + (tall + lanes) * pivots
        down = down + pads * plan.sizes + pads * pivots
        return np.empty(int(np.maximum(up, down).max(initial=0)) + 4 * lanes)

    def room(self) -> Array:
        """Room for the triangles of all fronts, one's columns after another's; see `Plan.keeps`."""
        return np.empty(int(self._keeps[-1]) + 1)

    @cached_property
    def _keeps(self) -> Integers:
        return self.plan.keeps(self.sides)

    def rows(
        self, entries: Array, right: Array, kept: Array, negligible: float
    ) -> tuple[Array, int]:
        """Make the rows of all fronts triangular; the rest of each side, and the front at fault.

        entries: The entries of all factors, as the plan has them.
        right: The right sides, (rows, sides).
        kept: The `room` for triangles.
        """
        residual = np.zeros(self.sides)
        arrays = entries, right, kept, self.left, residual, self._work
        fault: int = self._called("rows", *arrays)(negligible)
        return residual, fault

    def squares(self, entries: Array, right: Array, kept: Array, negligible: float) -> int:
        """Factorise the normal equations of all fronts: the front at fault, else −1."""
        arrays = entries, right, kept, self.left, self._work
        found: int = self._called("squares", *arrays)(negligible)
        return found

    def back(self, kept: Array, means: Array, covs: Array) -> float:
        """Find the moments of all fronts: how much larger summands are than a variance."""
        found: float = self._called("back", kept, means, covs, self._work)()
        return found

    def _called(self, name: str, *arrays: Array) -> Callable[..., Any]:
        """A function of all fronts, bound to its arrays."""
        function, count = _machine()[name], len(self.plan.pivots)
        table, _ = self._table
        given = _address(table), *map(_address, arrays), 0, count, self.sides
        return partial(function, *given)

    def log_pivots(self, kept: Array) -> float:
        """The sum of the logarithms of all pivots."""
        return float(np.log(kept[self._diagonal]).sum())

    @cached_property
    def _diagonal(self) -> Integers:
        pivots, size = self.plan.pivots, self.plan.sizes + self.sides
        owner = np.repeat(np.arange(pivots.size), pivots)
        inside = np.arange(owner.size) - np.repeat(np.cumsum(pivots) - pivots, pivots)
        found: Integers = self._keeps[owner] + inside * (size[owner] + 1)
        return found


def _address(array: Array | Integers) -> int:
    found: int = array.__array_interface__["data"][0]
    return found
