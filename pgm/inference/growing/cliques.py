"""Cliques of a tree, and the order in which variables leave that are eliminated anew."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from typing import NamedTuple

from pgm.inference.growing.factors import Factor
from pgm.kernels.arrays import Array, Integers

# Cliques are joined while no more than this share of the joined columns' entries are zeros,
ZEROS = 0.1
# or while the columns that are eliminated together are so few.
FEW = 32


@dataclass(slots=True, eq=False)
class Clique:
    """A clique as it was eliminated: x = gain s + offset of its pivots x, given separators s.

    Attributes
    ----------
    pivots, separators : tuple of int
        Numbers of variables.
    first : tuple of int
        The columns at which the pivots begin.
    factors : list of pairs
        The factors that are eliminated here, with their rows [A b].
    triangle : ndarray
        The rows [R₁₁ R₁₂ c], (own, size + 1), R₁₁ being upper triangular.
    gain, offset : ndarray
        (own, size − own) and (own,).
    left : ndarray
        The rows [A b] that it leaves to its parent, over the separators.
    limits : ndarray
        How far each component of the pivots may be from its point, (own,).
    owners : ndarray
        The variable that each of these components is of, (own,).
    children : list of pairs
        Of each clique that hangs here its separators' columns in this one, (its separators,).
    """

    pivots: tuple[int, ...]
    separators: tuple[int, ...]
    first: tuple[int, ...]
    factors: list[tuple[Factor, Array]]
    triangle: Array
    gain: Array
    offset: Array
    left: Array
    limits: Array
    owners: Integers
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

    They leave by least degree, those of `last` after all others. `sizes` are the numbers of
    components of the variables.
    """
    place = {variable: k for k, variable in enumerate(variables)}
    adjacent: list[set[int]] = [set() for _ in variables]
    for scope in scopes:
        near = [place[variable] for variable in scope]
        if len(near) == 2:
            one, other = near
            adjacent[one].add(other)
            adjacent[other].add(one)
        else:
            for k in near:
                adjacent[k].update(near)
    for k, around in enumerate(adjacent):
        around.discard(k)
    late = [variable in last for variable in variables]
    order, later = _least_degree(adjacent, sizes, late)
    position = [0] * len(order)
    for rank, k in enumerate(order):
        position[k] = rank
    above = [min(later[k], key=position.__getitem__) if later[k] else -1 for k in range(len(order))]
    top = _joined(order, above, later, sizes, late)
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


def _least_degree(
    adjacent: list[set[int]], sizes: Sequence[int], late: Sequence[bool]
) -> tuple[list[int], list[set[int]]]:
    """The order in which vertices leave, and the neighbours that each has then; uses up the sets.

    Next is one of the least number of neighbours' components, `late` ones after all others. Least
    fill touched a few variables less on a published pose graph, but took longer to find than that
    saved.
    """
    alike = len(set(sizes)) == 1
    weigh = sizes.__getitem__
    degree = [len(near) if alike else sum(map(weigh, near)) for near in adjacent]
    heap = list(zip(late, degree, range(len(sizes)), strict=True))
    heapify(heap)
    left, order = [True] * len(sizes), []
    while heap:
        _, least, vertex = heappop(heap)
        if not left[vertex] or least != degree[vertex]:
            continue
        left[vertex] = False
        order.append(vertex)
        near = adjacent[vertex]
        count, same = len(near), []
        for other in near:
            around = adjacent[other]
            around |= near
            around.discard(vertex)
            if len(around) == count and late[other] == late[vertex]:
                same.append(other)
            around.discard(other)
        rest = near
        if same:  # those that have no other neighbours leave with it, and fill nothing
            rest = near.difference(same)
            for k, other in enumerate(same):
                left[other] = False
                adjacent[other] = rest.union(same[k + 1 :])
            order += same
        for other in rest:
            around = adjacent[other]
            if same:
                around.difference_update(same)
            found = len(around) if alike else sum(map(weigh, around))
            if found != degree[other]:
                degree[other] = found
                heappush(heap, (late[other], found, other))
    return order, adjacent


def _joined(
    order: Sequence[int],
    above: Sequence[int],
    later: Sequence[set[int]],
    sizes: Sequence[int],
    late: Sequence[bool],
) -> list[int]:
    """The last variable of those that each is eliminated with; see `fronts` of Gaussian trees.

    Those that are `late` stay by themselves, so that what comes next touches few.
    """
    pivots = list(sizes)
    shared = [sum(sizes[j] for j in later[k]) for k in range(len(order))]
    filled = [p * (p + 1) // 2 + p * s for p, s in zip(pivots, shared, strict=True)]
    top = list(range(len(order)))
    for k in order:
        to = above[k]
        if to < 0 or late[k] != late[to]:
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
) -> dict[int, range]:
    """The columns of each variable of a front."""
    found, column = {}, 0
    for part in (pivots, separators):
        for variable in part:
            end = column + size[variable]
            found[variable] = range(column, end)
            column = end
    return found


def spread(scope: Iterable[int], column: dict[int, range]) -> list[int]:
    """The columns of all components of some variables."""
    found: list[int] = []
    for variable in scope:
        found += column[variable]
    return found
