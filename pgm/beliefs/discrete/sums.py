"""Sums of the entries of tables in flat storage, over the axes that a message leaves out.

Flat storage holds tables, (entries, [runs]), where [runs] is an axis that a single run lacks. Each
*sum* writes its results to a slice of an array, its *target*. The semiring says what a sum is: in
max-product it is a maximum.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.discrete.place import Merged, Place
from pgm.factors.axes import States, sizes, without
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import SUM_PRODUCT, Semiring
from pgm.variables import Discrete

# The most entries of a matrix that sums the storage to all marginals.
SMALL = 2**12


@dataclass(frozen=True, eq=False)
class GatheredSum:
    """Many sums in one call, each of equally many entries, which stand anywhere in flat storage.

    index: The positions of the entries, (entries of a sum, sums), or (sums, entries of a sum) where
        `axis` is 1.
    axis: The axis of `index` along which entries are summed.
    target: The slice of the output array that the results, (sums,), are written to.
    """

    index: Integers
    axis: int
    target: slice

    @classmethod
    def of(cls, sources: Sequence[tuple[Place, States]], start: int) -> GatheredSum:
        """The sums of some tables to wanted variables, to be written from index `start` on.

        sources: Of each table, its place and the variables wanted of it. Results stand in the order
            of the tables, each in C order of its wanted variables. All tables have equally many
            entries for each joint state of these.
        """
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
        """Sum entries of the storage into the target slice of `out`, and return that slice.

        `storage` is (entries, [runs]); `out`, (any length, [runs]), is where all sums are written.
        """
        into = out[self.target]
        if self.index.shape[self.axis] == 1:
            return storage.take(self.index.ravel(), 0, into, "clip")
        return semiring.total(storage.take(self.index, 0), self.axis, out=into)


@dataclass(frozen=True, eq=False)
class BlockSum:
    """The sum of a large table, which is contiguous, to some of its variables.

    entries: The slice of flat storage that has the table.
    view: The shape of the table with merged axes: neighbouring axes are merged if their variables
        are all wanted, or none is.
    sums: The sum over the axes of `view` that are not wanted.
    target: The slice of the output array that the results are written to.
    """

    entries: slice
    view: Merged
    sums: AxisSums
    target: slice

    @classmethod
    def of(cls, place: Place, wanted: States, start: int) -> BlockSum:
        """The sum of a large table to the wanted variables.

        The results are to be written from index `start` on, in C order of `wanted`.
        """
        target = slice(start, start + math.prod(sizes(wanted)))
        view = place.merged(wanted)
        return cls(place.entries, view, AxisSums.of(view.shape, view.others), target)

    def apply(self, storage: Array, semiring: Semiring, out: Array) -> Array:
        """Sum the table in the storage into the target slice of `out`, and return that slice.

        `storage` is (entries, [runs]); `out`, (any length, [runs]), is where all sums are written.
        """
        tail = storage.shape[1:]
        table = storage[self.entries].reshape((*self.view.shape, *tail))
        total = self.sums.total(table, semiring)
        into = out[self.target]
        ordered = total.reshape((*self.view.sizes, *tail)).transpose(self.view.axes(len(tail)))
        into.reshape(ordered.shape)[...] = ordered
        return into


Sum = GatheredSum | BlockSum


def summed(sources: Sequence[tuple[Place, States]], start: int) -> Sum:
    """The sums of some tables to wanted variables, to be written from index `start` on.

    sources: Of each table, its place and the variables wanted of it: one large table, or one or
        more small ones that have equally many entries for each joint state of the wanted variables.
        The results stand in the order of the tables.
    """
    place, wanted = sources[0]
    return BlockSum.of(place, wanted, start) if place.large else GatheredSum.of(sources, start)


@dataclass(frozen=True, eq=False)
class Marginals:
    """The sums of tables that make the marginals of all variables.

    The marginals stand one after the other in an array (count, [runs]).

    sums: The sums that together write all marginals.
    where: Of each variable, the slice of its marginal.
    first, widths: (variables,): of each marginal, its first index and its number of states.
    count: The number of states of all variables together.
    matrix: (length of the storage, count): zeros and ones. The tables of a single run, as one row,
        times this matrix are the marginals. None where it would have more than 4096 entries
        (`SMALL`).
    """

    sums: Sequence[Sum]
    where: Mapping[Discrete, slice]
    first: Integers
    widths: Integers
    count: int
    matrix: Array | None

    @classmethod
    def of(cls, sources: Mapping[Discrete, Place], length: int) -> Marginals:
        """Lay out the sums that make the marginals of all variables.

        sources: Of each variable, the place of the table from which its marginal is summed.
        length: The number of entries of the flat storage, including the sepsets' tables, which
            stand behind the clusters' if there are any.
        """
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

    def sum(self, tables: Array, semiring: Semiring) -> Array:
        """The sums of tables, (length of the storage, [runs]), to each variable, (count, [runs]).

        In max-product they are max-marginals.
        """
        out = np.empty((self.count, *tables.shape[1:]))
        if semiring.linear and self.matrix is not None and tables.ndim == 1:
            tables.dot(self.matrix, out)
        else:
            for each in self.sums:
                each.apply(tables, semiring, out)
        return out

    def read(self, tables: Array) -> Array:
        """The marginals, (count, [runs]), of calibrated tables, (length of the storage, [runs]).

        Each marginal is divided by its sum.
        """
        out = self.sum(tables, SUM_PRODUCT)
        # They sum to one but for rounding, which grows with the depth of a tree.
        out /= np.add.reduceat(out, self.first, 0).repeat(self.widths, 0)
        return out


# If at least so many entries lie behind the last axis that is summed, one call sums all axes.
LONG = 128
# Last axes of at most so many entries, with so many sums, are summed by a product of matrices.
ENTRIES, SUMS = 128, 8


@dataclass(frozen=True, eq=False)
class AxisSums:
    """A sum over some axes of a table.

    Axes are summed one by one, or by one call if many entries lie behind the last of them. Of plain
    numbers of a single run, the axes at the table's end, a *block*, are instead summed by one
    product with a matrix; the summed axes before the block are summed first. The block begins at
    the first summed axis from which on there are at most 128 entries (`ENTRIES`) and 8 sums
    (`SUMS`).

    shape: The shape of the table, without the axis of runs.
    axes: The axes that are summed, in ascending order.
    last: (entries of the block, sums): that matrix, of zeros and ones; None if no block is small
        enough.
    front: Those of `axes` that come before the block; all, if `last` is None.
    """

    shape: tuple[int, ...]
    axes: tuple[int, ...]
    last: Array | None
    front: tuple[int, ...]

    @classmethod
    def of(cls, shape: tuple[int, ...], axes: tuple[int, ...]) -> AxisSums:
        """Choose how a table of this shape is summed over `axes`, which are in ascending order."""
        for first in axes:
            block = shape[first:]
            kept = tuple(1 if k in axes else n for k, n in enumerate(block, first))
            if math.prod(block) <= ENTRIES and math.prod(kept) <= SUMS:
                column = np.arange(math.prod(kept)).reshape(kept)
                last = np.eye(column.size)[np.broadcast_to(column, block).ravel()]
                return cls(shape, axes, last, tuple(k for k in axes if k < first))
        return cls(shape, axes, None, axes)

    def total(self, table: Array, semiring: Semiring) -> Array:
        """The sums of a table (*shape, [runs]) over `axes`, in C order of the axes that are left.

        The axes that are left may be merged in the result, so that the caller has to reshape it;
        the axis of runs, if there is one, stays last. If `axes` is empty, the table itself is
        returned.
        """
        tail = table.shape[len(self.shape) :]
        if not self.axes:
            return table
        if math.prod(table.shape[self.axes[-1] + 1 :]) >= LONG:
            return semiring.total(table, self.axes)
        last = self.last if semiring.linear and not tail else None
        result = _one_by_one(table, self.axes if last is None else self.front, semiring)
        if last is None:
            return result
        # Not matmul, which looks for floating-point errors: there are none in sums.
        sums: Array = result.reshape(-1, len(last)).dot(last)
        return sums


def _one_by_one(table: Array, axes: Sequence[int], semiring: Semiring) -> Array:
    """A table summed over axes, which are given in ascending order, by one call for each.

    The first axis is summed first: each call then adds whole blocks, of the entries along all axes
    behind the one that is summed, so that NumPy's loops are long. The result lacks these axes.
    """
    for gone, axis in enumerate(axes):
        table = semiring.total(table, axis - gone)
    return table
