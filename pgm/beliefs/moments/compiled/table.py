"""The table that machine code reads: addresses and lengths, and the arrays that it tells of."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.compiled.called import Call, Calls
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels.arrays import Array, address
from pgm.kernels.machine.emitter.memory import Runs
from pgm.kernels.machine.sweeps import told

Integers64 = npt.NDArray[np.int64]
# By name the arrays that a sweep fills or reads beside those of CPDs and sensors.
Record = dict[str, Array]
# How an array's owner, a CPD, a sensor or a record, is asked for it.
Get = Callable[[Any], Any]


class Table:
    """A table that is filled, and the `arrays` that it tells of, which stay in memory as it does.

    These are by the places of their addresses.

    `lanes` is how many runs are swept together, `record` the arrays that no CPD and no sensor owns;
    `calls` are the functions that are called, None where none may be.
    """

    def __init__(self, plan: ChainPlan, lanes: int, calls: Calls | None = None) -> None:
        self.lanes, self.calls, self._account = lanes, calls, plan.account
        self.numbers = [0] * told.FIRST
        self.numbers[told.LAST], self.numbers[told.RUNS] = plan.steps, plan.runs
        self.record: Record = {}
        self.arrays: dict[int, npt.NDArray[Any]] = {}

    def put(self, place: int, array: npt.NDArray[Any]) -> None:
        """Put the address of an array into the table."""
        self.arrays[place] = array
        self.numbers[place] = address(array)

    def at(self, array: npt.NDArray[Any]) -> int:
        """The place in the table of the address of an array."""
        self.numbers.append(0)
        self.put(len(self.numbers) - 1, array)
        return len(self.numbers) - 1

    def array(self, array: Array) -> told.Array:
        """An array (rows or 1, runs or 1, own axes), told."""
        array = readable(array)
        inner = [(k, n) for k, n in zip(array.strides[2:], array.shape[2:], strict=True) if n > 1]
        down, across = (
            0 if n == 1 else k // 8 for k, n in zip(array.strides, array.shape[:2], strict=False)
        )
        cell = inner[-1][0] // 8 if inner else 1
        place = self.at(array)
        self.numbers += [down, across, cell]
        runs = Runs.BESIDE
        if self.lanes > 1 and across != 1:
            runs = Runs.APART if across else Runs.SAME
        return told.Array(place, array.shape[2:], runs, cell == 1)

    def of(self, owner: Any, get: Get) -> told.Array:
        """An array that an owner has, told."""
        return self.array(get(owner))

    def at_of(self, owner: Any, get: Get) -> int:
        """The place in the table of the address of an array that an owner has."""
        return self.at(get(owner))

    def by_runs(self, cells: Array) -> told.Array:
        """An array (rows, own axes, runs), told."""
        return self.array(np.moveaxis(cells, -1, 1))

    def called(self, call: Call, lines: told.Lines, why: str) -> told.Called:
        """A function that is called, and why."""
        if self.calls is None:
            raise Uncompiled(f"{call.family.cpd!r}: {why}")
        self._account.call_back(call.family.cpd.child.name, why)
        self.calls.each.append(call)
        places = self.by_runs(call.points[None]), self.by_runs(call.told)
        return told.Called(len(self.calls.each) - 1, *places, lines)

    def count(self, number: int) -> int:
        """The place in the table of a number."""
        self.numbers.append(number)
        return len(self.numbers) - 1

    @property
    def whole(self) -> Integers64:
        """The table."""
        return np.array(self.numbers, dtype=np.int64)


def readable(array: Array) -> Array:
    """The array, or a copy, in which components of a row are at even distances."""
    if not array.size:  # which is never read, and has no distances
        return np.zeros((1, *array.shape[1:]))
    inner = [(k, n) for k, n in zip(array.strides[2:], array.shape[2:], strict=True) if n > 1]
    if any(outer != stride * size for (outer, _), (stride, size) in pairwise(inner)):
        return np.ascontiguousarray(array)
    return array
