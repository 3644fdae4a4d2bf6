"""Sums of a table's entries at the ends of beams, over the beams of each pose.

Indices of cells are found in float32, to some ten thousandths of a cell on maps of some thousand
cells a side: an end that near to a cell's edge may count as in the next cell.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pgm.kernels.arrays import Array, Mask

Single = npt.NDArray[np.float32]
# Ends that are worked on at a time: their arrays stay in a core's cache.
BLOCK = 2**15
# More cells than an int32 counts.
_MANY = 2**31


def summed(table: Single, poses: Array, units: Array, ranges: Array, seen: Mask) -> Array:
    """The sums over the beams of each pose, (m,).

    Parameters
    ----------
    table : ndarray
        (rows, columns), contiguous. Ends beyond its edge count as in the cell on the edge.
    poses : ndarray
        (m, 3): column, row and heading.
    units : ndarray
        (2, beams): the directions of beams in the frame of their pose.
    ranges : ndarray
        (m, beams) in cells, or (1, beams) where all poses share one scan.
    seen : ndarray of bool
        As the ranges: which beams count.
    """
    shared = len(ranges) == 1
    if shared:
        units = (units * ranges[0])[:, seen[0]]
    beams = units.shape[1]
    size = max(min(len(poses), BLOCK // max(beams, 1)), 1)
    work = _Work(table, (size, beams))
    # Columns and rows are products of (cos, sin, place) with these, or sums of their parts.
    x, y = units
    rest = np.full(beams, 1.0 if shared else 0.0)
    to_column = np.stack([x, -y, rest]).astype(np.float32)
    to_row = np.stack([y, x, rest]).astype(np.float32)
    ones = np.ones(beams, dtype=np.float32)
    found = np.empty(len(poses))
    for first in range(0, len(poses), size):
        place = slice(first, min(first + size, len(poses)))
        ahead = np.empty((place.stop - first, 3), dtype=np.float32)
        column, row, heading = poses[place].T
        ahead[:, 0], ahead[:, 1] = np.cos(heading), np.sin(heading)
        work.cut(len(ahead))
        for position, matrix, out in ((column, to_column, work.column), (row, to_row, work.row)):
            ahead[:, 2] = position
            np.matmul(ahead, matrix, out=out)
        if not shared:
            own = ranges[place].astype(np.float32)
            for position, out in ((column, work.column), (row, work.row)):
                np.multiply(out, own, out=out)
                np.add(out, position.astype(np.float32)[:, None], out=out)
        values = work.taken()
        if not shared:
            np.multiply(values, seen[place], out=values)
        found[place] = values @ ones
    return found


class _Work:
    """The arrays of a block, (size, beams) each."""

    def __init__(self, table: Single, shape: tuple[int, int]) -> None:
        self.table, self.flat = table, table.ravel()
        self._floats = np.empty((2, *shape), dtype=np.float32)
        kind = np.int32 if table.size < _MANY else np.int64
        self._indices = np.empty((2, *shape), dtype=kind)
        self.cut(shape[0])

    def cut(self, size: int) -> None:
        """Use a first part of the block."""
        self.column, self.row = self._floats[:, :size]
        self._index, self._other = self._indices[:, :size]

    def taken(self) -> Single:
        """The entries of the table at columns and rows, which are overwritten."""
        height, width = self.table.shape
        np.clip(self.column, np.float32(0.0), np.float32(width - 1), out=self.column)
        np.clip(self.row, np.float32(0.0), np.float32(height - 1), out=self.row)
        np.copyto(self._index, self.column, casting="unsafe")
        np.copyto(self._other, self.row, casting="unsafe")
        np.multiply(self._other, width, out=self._other)
        np.add(self._index, self._other, out=self._index)
        found: Single = np.take(self.flat, self._index, out=self.column, mode="clip")
        return found
