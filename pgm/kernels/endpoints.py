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
# The most cells that an int32 counts.
MOST_CELLS = 2**31 - 1


def summed(table: Single, poses: Array, ends: Array) -> Array:
    """The sums over beams that all poses share, (m,).

    Parameters
    ----------
    table : ndarray
        (rows, columns), contiguous. Ends beyond its edge count as in the cell on the edge.
    poses : ndarray
        (m, 3): column, row and heading.
    ends : ndarray
        (2, beams): where beams end in the frame of the pose, in cells.
    """
    count, beams = len(poses), ends.shape[1]
    turn = poses[:, 2]
    ahead = np.ones((count, 4), dtype=np.float32)
    ahead[:, 0], ahead[:, 1] = np.cos(turn), np.sin(turn)
    ahead[:, 2], ahead[:, 3] = poses[:, 0], poses[:, 1]
    x, y = ends
    one, none = np.ones(beams), np.zeros(beams)
    to_column = np.stack([x, -y, one, none]).astype(np.float32)
    to_row = np.stack([y, x, none, one]).astype(np.float32)
    size = min(count, max(BLOCK // max(beams, 1), 1))
    work = _Work(table, (size, beams))
    found = np.empty(count)
    ones = np.ones(beams, dtype=np.float32)
    for first in range(0, count, size):
        part = ahead[first : first + size]
        work.cut(len(part))
        np.matmul(part, to_column, out=work.column)
        np.matmul(part, to_row, out=work.row)
        found[first : first + size] = work.taken() @ ones
    return found


def summed_apart(table: Single, poses: Array, ends: Array, seen: Mask) -> Array:
    """The sums over beams of each pose's own, (m,).

    Parameters
    ----------
    table, poses
        As of `summed`.
    ends : ndarray
        (2, m, beams): where beams end in the frame of their pose, in cells.
    seen : ndarray of bool
        (m, beams): which beams count.
    """
    _, count, beams = ends.shape
    size = min(count, max(BLOCK // max(beams, 1), 1))
    work = _Work(table, (size, beams))
    found = np.empty(count)
    for first in range(0, count, size):
        place = slice(first, min(first + size, count))
        turn = poses[place, 2]
        column, row, cos, sin = (
            each.astype(np.float32)[:, None]
            for each in (poses[place, 0], poses[place, 1], np.cos(turn), np.sin(turn))
        )
        x, y = ends[:, place].astype(np.float32)
        work.cut(len(column))
        work.column[...] = column + cos * x - sin * y
        work.row[...] = row + sin * x + cos * y
        found[place] = np.einsum("mb,mb->m", work.taken(), seen[place])
    return found


class _Work:
    """The arrays of a block, (size, beams) each."""

    def __init__(self, table: Single, shape: tuple[int, int]) -> None:
        self.table, self.flat = table, table.ravel()
        self._floats = np.empty((2, *shape), dtype=np.float32)
        self._indices = np.empty((2, *shape), dtype=np.int32)
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
        np.multiply(self._other, np.int32(width), out=self._other)
        np.add(self._index, self._other, out=self._index)
        found: Single = np.take(self.flat, self._index, out=self.column, mode="clip")
        return found
