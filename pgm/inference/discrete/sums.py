"""Sums of the entries of tables in the flat storage, over the axes that a message leaves out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgm.factors.axes import States, sizes, without
from pgm.inference.discrete.place import Merged, Place
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import SUM_PRODUCT, Semiring
from pgm.variables import Discrete

# Entries of a matrix that sums the storage to all marginals, at the most.
SMALL = 2**12


@dataclass(frozen=True, eq=False)
class GatheredSum:
    """Many sums of equal length, of entries anywhere, in one call.

    index: (rows, sums), or (sums, rows) where `axis` is 1.
    """

    index: Integers
    axis: int
    target: slice

    @classmethod
    def of(cls, sources: Sequence[tuple[Place, States]], start: int) -> GatheredSum:
        """The sums of tables over all but the wanted variables of each, kept from `start` on."""
        matrices = []
        for place, wanted in sources:
            positions = place.positions((*without(place.scope, wanted), *wanted))
            matrices.append(positions.reshape(-1, math.prod(sizes(wanted))))
        matrix = np.concatenate(matrices, axis=1)
        rows, columns = matrix.shape
        axis = int(rows > columns)
        index = np.ascontiguousarray(matrix.T if axis else matrix)
        return cls(index, axis, slice(start, start + columns))

    def apply(self, storage: Array, semiring: Semiring, out: Array) -> Array:
        """Sum into a part of an array, which is returned."""
        into = out[self.target]
        if self.index.shape[self.axis] == 1:
            return storage.take(self.index.ravel(), 0, into, "clip")
        return semiring.total(storage.take(self.index, 0), self.axis, into)


@dataclass(frozen=True, eq=False)
class BlockSum:
    """A contiguous table, summed to some of its variables in place."""

    entries: slice
    view: Merged
    sums: AxisSums
    target: slice

    @classmethod
    def of(cls, place: Place, wanted: States, start: int) -> BlockSum:
        """The sums of one large table over all but the wanted variables, stored from `start` on."""
        target = slice(start, start + math.prod(sizes(wanted)))
        view = place.merged(wanted)
        return cls(place.entries, view, AxisSums.of(view.shape, view.others), target)

    def apply(self, storage: Array, semiring: Semiring, out: Array) -> Array:
        """Sum into a part of an array, which is returned."""
        tail = storage.shape[1:]
        table = storage[self.entries].reshape((*self.view.shape, *tail))
        total = self.sums.total(table, semiring)
        into = out[self.target]
        ordered = total.reshape((*self.view.sizes, *tail)).transpose(self.view.axes(len(tail)))
        into.reshape(ordered.shape)[...] = ordered
        return into


Sum = GatheredSum | BlockSum


def summed(sources: Sequence[tuple[Place, States]], start: int) -> Sum:
    """The sums of some tables, or of a contiguous one, from a place on.

    sources: Each to some of its variables, with equally many entries for each entry of these.
    """
    place, wanted = sources[0]
    return BlockSum.of(place, wanted, start) if place.large else GatheredSum.of(sources, start)


@dataclass(frozen=True, eq=False)
class Marginals:
    """The probabilities of all variables, one after the other.

    first, widths: (variables,): where they begin, and their numbers.
    matrix: (length of the storage, count): of zeros and ones, where it is small.
    """

    sums: Sequence[Sum]
    where: Mapping[Discrete, slice]
    first: Integers
    widths: Integers
    count: int
    matrix: Array | None

    @classmethod
    def of(cls, sources: Mapping[Discrete, Place], length: int) -> Marginals:
        """The sums of the marginals of all variables, each from the table of its home."""
        # A large table is summed by itself, others with those of as many entries for each state.
        together: dict[Discrete | int, list[tuple[Place, States]]] = {}
        for variable, place in sources.items():
            rows = place.size // variable.size
            together.setdefault(variable if place.large else rows, []).append((place, (variable,)))
        sums: list[Sum] = []
        where: dict[Discrete, slice] = {}
        stop = 0
        for found in together.values():
            sums.append(summed(found, stop))
            for _, (variable,) in found:
                where[variable] = slice(stop, stop + variable.size)
                stop += variable.size
        widths = np.array([variable.size for variable in where])
        matrix = None
        if length * stop <= SMALL:
            each, all_sums = np.eye(length), np.empty((stop, length))
            for one in sums:
                one.apply(each, SUM_PRODUCT, all_sums)
            matrix = np.ascontiguousarray(all_sums.T)
        return cls(sums, where, np.cumsum(widths) - widths, widths, stop, matrix)

    def read(self, tables: Array) -> Array:
        """The probabilities, (states of all variables, [runs])."""
        out = np.empty((self.count, *tables.shape[1:]))
        if self.matrix is not None and tables.ndim == 1:
            tables.dot(self.matrix, out)
        else:
            for each in self.sums:
                each.apply(tables, SUM_PRODUCT, out)
        # They sum to one but for rounding, which grows with the depth of a tree.
        out /= np.add.reduceat(out, self.first, 0).repeat(self.widths, 0)
        return out


# Entries behind the last axis, from which on one call sums all axes.
LONG = 128
# Of the last axes that are summed by a product of matrices: entries, and sums of them.
ENTRIES, SUMS = 128, 8


@dataclass(frozen=True, eq=False)
class AxisSums:
    """A sum over some axes of a table.

    shape: Of the table, without the axis of runs.
    last: A matrix of zeros and ones that sums the last axes, if they have few entries.
    """

    shape: tuple[int, ...]
    axes: tuple[int, ...]
    last: Array | None
    front: tuple[int, ...]

    @classmethod
    def of(cls, shape: tuple[int, ...], axes: tuple[int, ...]) -> AxisSums:
        """The quickest way to sum a table of this shape over some axes."""
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
    """Sum a table over one axis at a time, first axis first, so that whole rows are added."""
    for gone, axis in enumerate(axes):
        table = semiring.total(table, axis - gone, None)
    return table
