"""Stacks of fronts that are eliminated together, and where their rows stand in the buffer.

The *rows* of a front are those of its clusters' CPDs and those that its children leave: of a factor
exp(−½ ‖A ξ − r‖²) over its components ξ, the rows of A, with r. Fronts of one level of the tree and
one shape make a stack. In large trees fronts are padded to a shape that more of them share: a front
then has columns that stand for no component, with a unit row each where they are pivots.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.beliefs.gaussian.assembly import Assembly
from pgm.beliefs.gaussian.front_shapes import Shapes, alike, joined
from pgm.beliefs.gaussian.fronts import Fronts, ranges
from pgm.beliefs.gaussian.rounds import Stack
from pgm.kernels.arrays import Integers

# Trees of so many fronts have fronts padded; smaller ones are often inferred for many runs at once.
MANY = 100


@dataclass(frozen=True, eq=False)
class FrontStacks:
    """The rows of a tree's fronts in one buffer: the `Places` of a `Buffer`.

    The rows of CPDs come first, group by group, then those that each front leaves to its parent,
    then a zero, and the entry of unit rows.
    """

    assembly: Assembly
    fronts: Fronts

    @property
    def pivots(self) -> Integers:
        """The number of pivots of each front, padded, (fronts,)."""
        return self._shapes.pivots

    @property
    def separators(self) -> Integers:
        """The number of separators of each front, padded, (fronts,)."""
        return self._shapes.separators

    @cached_property
    def _shapes(self) -> Shapes:
        fronts = self.fronts
        left = np.where(fronts.parent >= 0, fronts.separators, 0)
        rows = np.bincount(np.maximum(fronts.parent, 0), left, len(fronts)).astype(np.intp)
        for factors in self.assembly.factors:
            own = self.of_cluster[factors.clusters]
            rows += np.bincount(own, minlength=len(fronts)) * factors.height
        shaped = joined if len(fronts) >= MANY else alike
        return shaped(fronts.levels, fronts.pivots, fronts.separators, rows)

    @cached_property
    def entry_starts(self) -> Integers:
        """The index of the first entry that each front leaves, and of the zero, (fronts + 1,)."""
        sizes = self.separators**2
        return int(self.assembly.entry_starts[-1]) + np.concatenate([[0], np.cumsum(sizes)])

    @cached_property
    def row_starts(self) -> Integers:
        """The index of the first row that each front leaves, and of the zero, (fronts + 1,)."""
        return int(self.assembly.row_starts[-1]) + np.concatenate([[0], np.cumsum(self.separators)])

    @property
    def logs(self) -> int:
        """How many log-scales the buffer has: those of the fronts' CPDs."""
        return len(self.fronts)

    @property
    def of_cluster(self) -> Integers:
        """The front of each cluster, (clusters,), which has the log-scale of its CPDs."""
        return self.fronts.of_cluster

    @cached_property
    def levels(self) -> list[list[Stack]]:
        """The stacks of each level of the tree, from the fronts without children on."""
        rooms, widths = self._shapes.rows, self.pivots + self.separators
        entries, right = self._filled(rooms, widths, self.pivots - self.fronts.pivots)
        return [
            [self._stack(members, rooms, entries, right) for members in level]
            for level in self._shapes.stacks
        ]

    def _filled(
        self, rooms: Integers, widths: Integers, spare: Integers
    ) -> tuple[_Ragged, _Ragged]:
        """The indices of all fronts' entries (rooms, widths) and right sides (rooms,)."""
        fronts, blocks = self.fronts, self.fronts.blocks
        zero, zero_row = int(self.entry_starts[-1]), int(self.row_starts[-1])
        entries = _Ragged.of(rooms * widths, zero)
        right = _Ragged.of(rooms, zero_row)
        used, assembly = np.zeros(len(fronts), dtype=np.intp), self.assembly
        for k, factors in enumerate(assembly.factors):
            height, width = factors.height, factors.places.shape[1]
            front = self.of_cluster[factors.clusters]
            columns = self.padded(front, blocks.columns(front, factors.places))
            slots = _slots(front, np.full(front.size, height), used)
            at, inside = slots[:, None] + np.arange(height), np.arange(width)
            count = np.arange(front.size)[:, None]
            row = count * height + np.arange(height)
            where = (at * widths[front][:, None])[..., None] + columns[:, None, :]
            entries.put(front, where, assembly.entry_starts[k] + (row * width)[..., None] + inside)
            right.put(front, at, assembly.row_starts[k] + row)
        begin = np.cumsum(fronts.separators) - fronts.separators
        sent = np.flatnonzero((fronts.parent >= 0) & (fronts.separators > 0))
        slots = np.zeros(len(fronts), dtype=np.intp)
        slots[sent] = _slots(fronts.parent[sent], fronts.separators[sent], used)
        for size in np.unique(fronts.separators[sent]).tolist():
            some = sent[fronts.separators[sent] == size]
            parent, inside = fronts.parent[some], np.arange(size)
            columns = self.padded(parent, fronts.above[begin[some][:, None] + inside])
            at = slots[some][:, None] + inside
            where = (at * widths[parent][:, None])[..., None] + columns[:, None, :]
            row = (inside * self.separators[some][:, None])[..., None] + inside
            entries.put(parent, where, self.entry_starts[some][:, None, None] + row)
            right.put(parent, at, self.row_starts[some][:, None] + inside)
        padded = np.repeat(np.arange(len(fronts)), spare)
        extra = ranges(np.zeros_like(spare), spare)
        at = (used[padded] + extra) * widths[padded] + fronts.pivots[padded] + extra
        entries.put(padded, at, np.full(at.shape, zero + 1))
        return entries, right

    def above(self, stack: Stack) -> Integers:
        """The columns (B, s) of a stack's separators in their parents; −1 of none, or no parent."""
        fronts, columns = self.fronts, stack.columns[:, stack.drop :]
        begin = np.cumsum(fronts.separators) - fronts.separators
        index = begin[stack.members][:, None] + columns - fronts.pivots[stack.members][:, None]
        return np.append(fronts.above, -1)[np.where(columns < 0, -1, index)]

    def padded(self, fronts: Integers, columns: Integers) -> Integers:
        """The columns (B, n) in matrices of fronts (B,) whose pivots are padded."""
        own = self.fronts.pivots[fronts][:, None]
        return np.where(columns >= own, columns + self.pivots[fronts][:, None] - own, columns)

    def _stack(self, members: Integers, rooms: Integers, entries: _Ragged, right: _Ragged) -> Stack:
        """The stack of some fronts of one shape."""
        first = members[0]
        room, drop = int(rooms[first]), int(self.pivots[first])
        width = drop + int(self.separators[first])
        inside, blocks = np.arange(width), self.fronts.blocks
        own, sizes = (each[members][:, None] for each in (self.fronts.pivots, blocks.sizes))
        column = np.where(inside < drop, inside, inside - drop + own)
        there = np.where(inside < drop, inside < own, column < sizes)
        place = np.append(blocks.components, 0)[
            np.where(there, blocks.starts[members][:, None] + column, -1)
        ]
        return Stack(
            members,
            members,
            drop,
            np.where(there, place, self.assembly.size),
            np.where(there, column, -1),
            entries.part(members, room * width).reshape(len(members), room, width),
            right.part(members, room),
            members[:, None],
            drop - own[:, 0],
        )


@dataclass(frozen=True, eq=False)
class _Ragged:
    """Whole numbers of all fronts, one front's after another's, in `values`."""

    starts: Integers
    values: Integers

    @classmethod
    def of(cls, sizes: Integers, value: int) -> _Ragged:
        """So many numbers of each front, all equal."""
        starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)
        return cls(starts, np.full(int(starts[-1]), value))

    def put(self, fronts: Integers, where: Integers, values: Integers) -> None:
        """Put numbers (B, ...) where they belong among those of fronts (B,)."""
        starts = self.starts[fronts]
        self.values[starts.reshape(-1, *[1] * (where.ndim - 1)) + where] = values

    def part(self, fronts: Integers, size: int) -> Integers:
        """The numbers of some fronts that have so many of them, (B, size)."""
        found: Integers = self.values[self.starts[fronts][:, None] + np.arange(size)]
        return found


def _slots(owners: Integers, heights: Integers, used: Integers) -> Integers:
    """The first row of each of some factors (B,) among those of its front, whose `used` rows grow.

    `owners` are the fronts, and `heights` how many rows each factor has.
    """
    order = np.argsort(owners, kind="stable")
    before = np.cumsum(heights[order]) - heights[order]
    begin = np.searchsorted(owners[order], owners[order])
    found = np.empty_like(owners)
    found[order] = used[owners[order]] + before - before[begin]
    np.add.at(used, owners, heights)
    return found
