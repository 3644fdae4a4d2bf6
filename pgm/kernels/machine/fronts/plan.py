"""Fronts as machine code is told of them.

A sparse least-squares problem min ‖A x − r‖², of N right sides, is solved front by front. Each
*front* has columns of its own: its *pivots*, which are eliminated there, then the *separators* that
its parent has too. A *factor* is some rows of A over columns of one front. What a front leaves to
its parent is over its separators.

Children come before parents, right after one another: what they leave waits on a stack.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from pgm.kernels.arrays import Integers


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """The fronts of a problem, each array of whole numbers.

    Attributes
    ----------
    pivots, separators : ndarray
        How many each front has, (fronts,).
    first_child, children : ndarray
        Where each front's children begin, (fronts + 1,), and the children.
    first_column, above : ndarray
        Where each front's separators begin, (fronts + 1,), and the columns that they have in the
        matrix of its parent, ascending.
    first_factor, factors : ndarray
        Where each front's factors begin, (fronts + 1,); and of each factor the number of rows, the
        number of columns, where its entries begin, its first row, and where its columns begin in
        `columns`, (factors, 5).
    columns : ndarray
        The columns of all factors, in the front's matrix.
    """

    pivots: Integers
    separators: Integers
    first_child: Integers
    children: Integers
    first_column: Integers
    above: Integers
    first_factor: Integers
    factors: Integers
    columns: Integers

    @cached_property
    def sizes(self) -> Integers:
        """How many columns each front has."""
        return self.pivots + self.separators

    @cached_property
    def parents(self) -> Integers:
        """The front above each, −1 of a root."""
        found: Integers = np.full(self.pivots.size, -1)
        found[self.children] = np.repeat(np.arange(self.pivots.size), np.diff(self.first_child))
        return found

    @cached_property
    def rows(self) -> Integers:
        """How many rows each front has, those that its children leave among them, (fronts,)."""
        owners = np.repeat(np.arange(self.pivots.size), np.diff(self.first_factor))
        rows = np.bincount(owners, self.factors[:, 0], self.pivots.size).astype(np.intp).tolist()
        shared = self.separators.tolist()
        pairs = zip(self.pivots.tolist(), self.parents.tolist(), strict=True)
        for front, (pivots, parent) in enumerate(pairs):
            if parent >= 0:
                rows[parent] += min(max(rows[front] - pivots, 0), shared[front])
        return np.array(rows, dtype=np.intp)

    @cached_property
    def sent(self) -> Integers:
        """How many rows each front leaves to its parent, (fronts,)."""
        found: Integers = np.minimum(np.maximum(self.rows - self.pivots, 0), self.separators)
        return found

    def keeps(self, sides: int) -> Integers:
        """Where the columns of each front's triangle begin, then where all end, (fronts + 1,).

        Of each pivot the front keeps a column of the sizes' length, and a number of each right
        side.
        """
        return _ends(self.pivots * (self.sizes + sides))

    @cached_property
    def blocks(self) -> Integers:
        """Where each front's covariance begins, then where all end, (fronts + 1,)."""
        return _ends(self.sizes**2)

    @cached_property
    def means(self) -> Integers:
        """Where each front's means begin, then where all end, (fronts + 1,)."""
        return _ends(self.sizes)

    def waiting(self, sides: int) -> tuple[Integers, int]:
        """Where on the stack each front leaves its rows, and how many floats the stack has."""
        if sides not in self._stacks:
            self._stacks[sides] = self._stack(sides)
        return self._stacks[sides]

    @cached_property
    def _stacks(self) -> dict[int, tuple[Integers, int]]:
        return {}

    def _stack(self, sides: int) -> tuple[Integers, int]:
        size = (self.separators * (self.separators + sides)).tolist()
        first, children = self.first_child.tolist(), self.children.tolist()
        found, top, most = [0] * len(size), 0, 0
        for front, own in enumerate(size):
            here = children[first[front] : first[front + 1]]
            top = min((found[child] for child in here), default=top)
            found[front], top = top, top + own
            most = max(most, top)
        return np.array(found, dtype=np.intp), most


class KeepingPlan(Plan):
    """A plan whose fronts leave their rows beside one another, where they stay after a call."""

    def _stack(self, sides: int) -> tuple[Integers, int]:
        ends = _ends(self.separators * (self.separators + sides))
        return ends[:-1], int(ends[-1])


def _ends(sizes: Integers) -> Integers:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)


# The arrays of a plan, with those that hang on the number of right sides, as code finds them.
TOLD = (
    *(field.name for field in fields(Plan)),
    *("sizes", "parents", "rows", "sent", "keeps", "waiting", "blocks", "means"),
)
