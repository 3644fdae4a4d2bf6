"""The table of a sweep: by name the arrays of a plan that machine code is told of.

What machine code is told of a chain has two parts (`kernels.machine.told`): what decides the code,
and where numbers stand. The first is found once for plans of one form. The second is found for each
sweep: a table keeps the names of its arrays, and looks them up in the plan at hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.kernels.arrays import Array
from pgm.kernels.machine import told
from pgm.kernels.machine.memory import Runs

Integers64 = npt.NDArray[np.int64]
Get = Callable[[Any], Any]


def address(array: npt.NDArray[Any]) -> int:
    """Where an array's memory begins."""
    found: int = array.__array_interface__["data"][0]
    return found


class Named(NamedTuple):
    """An array of a plan: its place in the table, its owner's number, and how that is asked for it.

    `lies` is how it lay when the code was made, as it has to lie again; None where that is no
    matter. `copied` says that machine code cannot read it as it lies.
    """

    place: int
    owner: int
    get: Get
    lies: tuple[Any, ...] | None = None
    copied: bool = False


class Filled(NamedTuple):
    """The numbers of a table for one sweep, and the arrays that they point to, which they keep."""

    numbers: Integers64
    kept: Sequence[object]


class Table:
    """The names of a sweep's arrays, in the order of their places.

    Parameters
    ----------
    owners : sequence
        What has the arrays: CPDs of a plan, sensors, and the record that is filled.
    lanes : int
        How many runs are swept together.
    """

    def __init__(self, owners: Sequence[Any], lanes: int) -> None:
        self.lanes, self._owners = lanes, owners
        self._numbers = [0] * told.FIRST
        self._named: list[Named] = []

    def put(self, place: int, owner: int, get: Get) -> None:
        """Have the address of an array at a place."""
        self._named.append(Named(place, owner, get))

    def at(self, owner: int, get: Get) -> int:
        """A new place, of the address of an array."""
        self._numbers.append(0)
        self.put(len(self._numbers) - 1, owner, get)
        return len(self._numbers) - 1

    def array(self, owner: int, get: Get) -> told.Array:
        """An array (rows or 1, runs or 1, own axes), told."""
        given = get(self._owners[owner])
        array = _readable(given)
        inner = [(k, n) for k, n in zip(array.strides[2:], array.shape[2:], strict=True) if n > 1]
        down, across = (
            0 if n == 1 else k // 8 for k, n in zip(array.strides, array.shape[:2], strict=False)
        )
        cell = inner[-1][0] // 8 if inner else 1
        place = len(self._numbers)
        self._numbers += [0, down, across, cell]
        self._named.append(Named(place, owner, get, _lies(given), array is not given))
        runs = Runs.BESIDE
        if self.lanes > 1 and across != 1:
            runs = Runs.APART if across else Runs.SAME
        return told.Array(place, array.shape[2:], runs, cell == 1)

    def closed(self) -> Table:
        """The table, which keeps the names of arrays and none of their owners."""
        self._owners = ()
        return self

    def filled(self, owners: Sequence[Any], *first: int) -> Filled | None:
        """The table of arrays of these owners; None where they do not lie as the code has them.

        It begins with the numbers `first`.
        """
        numbers, kept = [*first, *self._numbers[len(first) :]], []
        for place, owner, get, lies, copied in self._named:
            array = get(owners[owner])
            if lies is not None and lies != _lies(array):
                return None
            if copied:
                array = _readable(array)
            kept.append(array)
            numbers[place] = address(array)
        return Filled(np.array(numbers, dtype=np.int64), kept)


def _lies(array: Array) -> tuple[Any, ...]:
    """How an array (rows, runs, own axes) lies, but for its number of rows."""
    return array.strides, array.shape[0] == 1, array.size == 0, array.shape[1:]


def _readable(array: Array) -> Array:
    """The array, or a copy, in which components of a row are at even distances."""
    if not array.size:  # which is never read, and has no distances
        return np.zeros((1, *array.shape[1:]))
    inner = [(k, n) for k, n in zip(array.strides[2:], array.shape[2:], strict=True) if n > 1]
    if any(outer != stride * size for (outer, _), (stride, size) in pairwise(inner)):
        return np.ascontiguousarray(array)
    return array
