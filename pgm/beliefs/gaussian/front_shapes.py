"""Which fronts of a tree are eliminated together, and to which shape they are padded.

A front of p pivots and s separators has r rows, which become triangular in some r (p + s)²
operations. A stack of B fronts costs as many for each of them, of the largest sizes among them, and
a stack more costs the calls of NumPy, which take as long as CALLS operations. So fronts of one
level are joined where their padding costs less than a stack of their own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import Integers

# Operations that take as long as the calls of NumPy for a stack.
CALLS = 200_000


class Shapes(NamedTuple):
    """The fronts of stacks, and their sizes after padding.

    Attributes
    ----------
    stacks : list of list of ndarray
        For each level the numbers of the fronts of each of its stacks.
    pivots, separators, rows : ndarray of int
        The sizes of each front, which are the same in all fronts of a stack, (fronts,).
    """

    stacks: list[list[Integers]]
    pivots: Integers
    separators: Integers
    rows: Integers


def alike(levels: list[Integers], *sizes: Integers) -> Shapes:
    """The stacks of fronts of equal sizes, pivots and separators, and about as many rows."""
    return _shaped([_split(level, *sizes) for level in levels], *sizes)


def joined(levels: list[Integers], *sizes: Integers) -> Shapes:
    """Fewer stacks than those of fronts alike, where padding costs less than their calls."""
    return _shaped([_joined(_split(level, *sizes), *sizes) for level in levels], *sizes)


def _split(
    level: Integers, pivots: Integers, separators: Integers, rows: Integers
) -> list[Integers]:
    """The fronts of a level, split by sizes; rows by the next power of two, or fewer than wide."""
    own, shared, count = pivots[level], separators[level], rows[level]
    powers = 1 << np.ceil(np.log2(np.maximum(count, 1))).astype(np.intp)
    shapes = np.stack([own, shared, np.maximum(powers, own + shared)])
    _, kind = np.unique(shapes, axis=1, return_inverse=True)
    order = np.argsort(kind.ravel(), kind="stable")
    bounds = np.cumsum(np.bincount(kind.ravel()))[:-1]
    return np.split(level[order], bounds)


class _Sizes(NamedTuple):
    """The sizes of a stack of fronts, the largest of each; `spare` is the most rows − pivots."""

    fronts: int
    pivots: int
    separators: int
    spare: int

    @classmethod
    def of(
        cls, members: Integers, pivots: Integers, separators: Integers, rows: Integers
    ) -> _Sizes:
        """The sizes of some fronts."""
        own = pivots[members]
        sizes = own.max(), separators[members].max(), (rows[members] - own).max()
        return cls(len(members), *(int(size) for size in sizes))

    def with_(self, other: _Sizes) -> _Sizes:
        """The sizes of both stacks in one."""
        return _Sizes(self.fronts + other.fronts, *map(max, self[1:], other[1:]))

    @property
    def cost(self) -> int:
        """The operations of the stack's elimination."""
        width = self.pivots + self.separators
        # Each pivot that stands for no component comes with a row.
        return self.fronts * max(self.pivots + self.spare, width) * width**2


def _joined(stacks: list[Integers], *sizes: Integers) -> list[Integers]:
    """Stacks, in the order of sizes, each joined to the one before where this costs less."""
    found: list[list[Integers]] = []
    last: _Sizes | None = None
    for members in stacks:
        own = _Sizes.of(members, *sizes)
        both = None if last is None else last.with_(own)
        if last is None or both is None or both.cost > last.cost + own.cost + CALLS:
            found.append([members])
            last = own
        else:
            found[-1].append(members)
            last = both
    return [np.concatenate(members) for members in found]


def _shaped(
    stacks: list[list[Integers]], pivots: Integers, separators: Integers, rows: Integers
) -> Shapes:
    own, shared, count = pivots.copy(), separators.copy(), rows.copy()
    for members in (members for level in stacks for members in level):
        largest = _Sizes.of(members, pivots, separators, rows)
        own[members], shared[members] = largest.pivots, largest.separators
        width = largest.pivots + largest.separators
        count[members] = max(largest.pivots + largest.spare, width, 1)
    return Shapes(stacks, own, shared, count)
