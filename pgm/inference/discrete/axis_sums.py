"""Sums over axes of a table that stands by itself.

NumPy's sum over several axes is a loop over the entries behind the last of them, which for a few
entries costs ten times what their additions do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgm.kernels.arrays import Array
from pgm.kernels.semirings import Semiring

# Entries behind the last axis, from which on one call sums all axes.
LONG = 128
# Of the last axes that are summed by a product of matrices: entries, and sums of them.
ENTRIES, SUMS = 128, 8


@dataclass(frozen=True, eq=False)
class AxisSums:
    """How some axes of a table are summed over.

    Attributes
    ----------
    shape : tuple of int
        Of the table, without the axis of runs.
    axes : tuple of int
        Those summed over, in rising order.
    last : ndarray or None
        A matrix of zeros and ones that sums the last axes, if they have few entries.
    front : tuple of int
        The axes before these that are summed over.
    """

    shape: tuple[int, ...]
    axes: tuple[int, ...]
    last: Array | None
    front: tuple[int, ...]

    @classmethod
    def of(cls, shape: tuple[int, ...], axes: tuple[int, ...]) -> AxisSums:
        """Choose what sums the last axes."""
        for first in axes:
            block = shape[first:]
            kept = tuple(1 if k in axes else n for k, n in enumerate(block, first))
            if math.prod(block) <= ENTRIES and math.prod(kept) <= SUMS:
                column = np.arange(math.prod(kept)).reshape(kept)
                last = np.eye(column.size)[np.broadcast_to(column, block).ravel()]
                return cls(shape, axes, last, tuple(k for k in axes if k < first))
        return cls(shape, axes, None, axes)

    def total(self, table: Array, semiring: Semiring) -> Array:
        """The sums, in any shape; the table has an axis of runs or none."""
        tail = table.shape[len(self.shape) :]
        if not self.axes:
            return table
        if math.prod(table.shape[self.axes[-1] + 1 :]) >= LONG:
            return semiring.total(table, self.axes, None)
        last = self.last if semiring.linear and not tail else None
        result = _one_by_one(table, self.axes if last is None else self.front, semiring)
        if last is None:
            return result
        # Not matmul, which looks for floating-point errors: there are none in sums.
        sums: Array = result.reshape(-1, len(last)).dot(last)
        return sums


def _one_by_one(table: Array, axes: Sequence[int], semiring: Semiring) -> Array:
    """The first axis first: what is added are rows, long until little is left of the table."""
    for gone, axis in enumerate(axes):
        table = semiring.total(table, axis - gone, None)
    return table
