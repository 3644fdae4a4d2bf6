"""Normal equations of a chain in memory, slice by slice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.wholes import Address
from pgm.kernels.machine.newton.blocks import Block, Workspace, padded
from pgm.kernels.numbers import Matrix

# A matrix of this many rows is worked on in straight lines; a larger one by loops, as a `Block`.
MOST = 5
# The floats of a slice are filled up to whole packs of so many.
PACK = 8


@dataclass(frozen=True)
class Layout:
    """The equations of a slice, of so many components, in memory.

    They are its own matrix, of which the upper half is kept, that across to the next slice, and
    the right side. Once it is eliminated there are the covariance, the gain and the offset of the
    slice given the next.
    """

    size: int

    @property
    def wide(self) -> int:
        """The floats from row to row of a matrix."""
        return self.size if self.size <= MOST else padded(self.size)

    @property
    def across(self) -> int:
        """Where the matrix across to the next slice begins."""
        return self.size * self.wide

    @property
    def right(self) -> int:
        """Where the right side begins."""
        return 2 * self.size * self.wide

    @property
    def length(self) -> int:
        """All floats of a slice."""
        return -(-(self.right + self.size) // PACK) * PACK

    def square(self, i: int, j: int) -> int:
        """Where the product of two components of a slice and the next goes."""
        (a, i), (b, j) = divmod(i, self.size), divmod(j, self.size)
        if a != b:
            return self.across + (j * self.wide + i if a else i * self.wide + j)
        return a * self.length + min(i, j) * self.wide + max(i, j)

    def side(self, i: int) -> int:
        """Where the right side of a component of a slice and the next is."""
        part, place = divmod(i, self.size)
        return part * self.length + self.right + place


class Kept:
    """Matrices of a slice's size in memory: copied into registers, or worked on where they lie."""

    def __init__(self, code: Code, layout: Layout, space: Workspace) -> None:
        self._code, self._layout, self._space = code, layout, space
        self._straight = layout.size <= MOST

    def room(self, count: int) -> Address:
        """Memory for so many floats."""
        return self._code.room(count).address if self._straight else self._space.take(count)

    def column(self, place: Address) -> Any:
        """The vector at an address."""
        if not self._straight:
            return Block(self._space, place, self._layout.size, 1)
        cells = Memory(self._code, place)
        return Matrix.column(cells.load(k) for k in range(self._layout.size))

    def matrix(self, place: Address) -> Any:
        """The matrix at an address."""
        return self._matrix(place, lambda i, j: (i, j))

    def symmetric(self, place: Address) -> Any:
        """The symmetric matrix at an address, of which the upper half is read."""
        return self._matrix(place, lambda i, j: (min(i, j), max(i, j)))

    def put(self, place: Address, matrix: Any) -> None:
        """Keep a vector or matrix at an address."""
        if not self._straight:
            Block(self._space, place, *matrix.shape).set(matrix)
            return
        cells = Memory(self._code, place)
        for k, number in enumerate(x for row in matrix.rows for x in row):
            cells.store(k, number)

    def clear(self, place: Address, count: int) -> None:
        """Set so many floats to zero."""
        cells = Memory(self._code, place)
        self._times(count, lambda k: cells.store(k, 0.0))

    def each(self, write: Callable[[Any], None]) -> None:
        """Write code for each component of a slice."""
        self._times(self._layout.size, write)

    def _times(self, count: int, write: Callable[[Any], None]) -> None:
        for k in range(count if self._straight else 0):
            write(k)
        if not self._straight:
            with self._code.loop(count) as index:
                write(index)

    def _matrix(self, place: Address, where: Callable[[int, int], tuple[int, int]]) -> Any:
        size = self._layout.size
        if not self._straight:
            return Block(self._space, place, size, size)
        cells, every = Memory(self._code, place), range(size)
        due = [[where(i, j) for j in every] for i in every]
        known = {(i, j): cells.load(i * size + j) for row in due for i, j in row}
        return Matrix([known[at] for at in row] for row in due)
