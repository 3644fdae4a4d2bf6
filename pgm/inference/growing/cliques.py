"""Cliques of a tree, and the order in which variables leave that are eliminated anew."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pgm.compile.elimination import Filling, fill_order
from pgm.inference.growing.factors import Rows
from pgm.kernels.arrays import Array, Integers

# Cliques are joined while no more than this share of the joined columns' entries are zeros,
ZEROS = 0.3
# or while the columns that are eliminated together are so few.
FEW = 12


@dataclass(slots=True, eq=False)
class Clique:
    """A clique as it was eliminated: x = gain s + offset of its pivots x, given separators s.

    Attributes
    ----------
    pivots, separators : tuple of int
        Numbers of variables.
    first : tuple of int
        The columns at which the pivots begin.
    factors : tuple of int
        The numbers of the factors that are eliminated here.
    triangle : ndarray
        The rows [R₁₁ R₁₂ c], (own, size + 1), R₁₁ being upper triangular.
    solved : ndarray
        The gain, and the offset in the last column, (own, size − own + 1).
    left : Rows
        What it leaves to its parent.
    limits : ndarray
        How far each component of the pivots may be from its point, (own,).
    children : list of pairs
        Of each clique that hangs here its separators' columns in this one, (its separators,).
    """

    pivots: tuple[int, ...]
    separators: tuple[int, ...]
    first: tuple[int, ...]
    factors: tuple[int, ...]
    triangle: Array
    solved: Array
    left: Rows
    limits: Array
    children: list[tuple[Clique, Integers]] = field(default_factory=list)

    @property
    def lead(self) -> int:
        """The first of the pivots, by which the clique is known."""
        return self.pivots[0]


class Front(NamedTuple):
    """Variables that are to be eliminated together.

    Attributes
    ----------
    pivots, separators : list of int
        Numbers of variables, in the order in which they leave.
    parent : int
        The number of the front above, −1 of a root; it is a larger one.
    """

    pivots: list[int]
    separators: list[int]
    parent: int


def ordered(
    variables: Sequence[int], sizes: Sequence[int], scopes: Iterable[Sequence[int]], last: set[int]
) -> list[Front]:
    """Variables that are joined by scopes, in fronts, children before parents.

    They leave by least fill, those of `last` after all others. `sizes` are the numbers of
    components of the variables.
    """
    place = {variable: k for k, variable in enumerate(variables)}
    adjacent: list[set[int]] = [set() for _ in variables]
    for scope in scopes:
        near = [place[variable] for variable in scope]
        for k in near:
            adjacent[k].update(near)
    for k, around in enumerate(adjacent):
        around.discard(k)
    graph = Filling(adjacent, sizes)
    order, later = [], {}
    for k in fill_order(graph, [variable in last for variable in variables]):
        order.append(k)
        later[k] = graph.adjacent[k]
    position = [0] * len(order)
    for rank, k in enumerate(order):
        position[k] = rank
    above = [
        min(later[k], key=position.__getitem__) if later[k] else -1 for k in range(len(order))
    ]
    top = _joined(order, above, later, sizes)
    members: dict[int, list[int]] = {}
    for k in order:
        members.setdefault(top[k], []).append(k)
    tops = sorted(members, key=position.__getitem__)
    number = {k: front for front, k in enumerate(tops)}
    return [
        Front(
            [variables[j] for j in members[k]],
            [variables[j] for j in sorted(later[k], key=position.__getitem__)],
            number[top[above[k]]] if later[k] else -1,
        )
        for k in tops
    ]


def _joined(
    order: Sequence[int],
    above: Sequence[int],
    later: dict[int, set[int]],
    sizes: Sequence[int],
) -> list[int]:
    """The last variable of those that each is eliminated with; see `fronts` of Gaussian trees."""
    pivots = list(sizes)
    shared = [sum(sizes[j] for j in later[k]) for k in range(len(order))]
    filled = [p * (p + 1) // 2 + p * s for p, s in zip(pivots, shared, strict=True)]
    top = list(range(len(order)))
    for k in order:
        to = above[k]
        if to < 0:
            continue
        both, there = pivots[k] + pivots[to], filled[k] + filled[to]
        entries = both * (both + 1) // 2 + both * shared[to]
        if both <= FEW or entries - there <= ZEROS * entries:
            top[k] = to
            pivots[to], filled[to] = both, there
    for k in reversed(order):
        top[k] = top[top[k]]
    return top


def columns(
    pivots: Iterable[int], separators: Iterable[int], size: dict[int, int]
) -> dict[int, int]:
    """The column at which each variable of a front begins."""
    found, column = {}, 0
    for part in (pivots, separators):
        for variable in part:
            found[variable] = column
            column += size[variable]
    return found


def spread(scope: Iterable[int], column: dict[int, int], size: dict[int, int]) -> list[int]:
    """The columns of all components of some variables."""
    return [c for v in scope for c in range(column[v], column[v] + size[v])]
