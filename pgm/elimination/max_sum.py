"""Maxima over some variables of sums over the others: the order, and the algebra of tables.

Sums and maxima do not change places, and all that is summed out should leave first. Where that
makes tables too large, some variables that are maximised over leave *early*, before one that is
summed out and that they are joined to. The result is an upper bound of what is asked for then,
Σ max ≥ max Σ, and what is asked for itself where none is early.

Source: Park and Darwiche (2003), Solving MAP exactly using systematic search.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence, Set
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np

from pgm.compile.elimination import Adjacency, Filling, cheapest
from pgm.elimination.carry_out import eliminate
from pgm.elimination.orders import in_order
from pgm.elimination.plan import Label, Plan, Scope, Step
from pgm.elimination.tables import TableAlgebra
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import LOG_SUM_PRODUCT

# How large a table that a sum leaves may be, where a maximum could leave a smaller one: one after
# another is tried, until a plan is found with no more entries in all than these. A plan in which
# none is early may have more of them, since it is carried out once.
PREFERENCES = [2**k for k in (24, 20, 17, 14, 11, 8, 5)]
BOUND, EXACT = 2**18, 2**23
# Where no plan has so few entries, orders are drawn.
TRIES = 100

Given = Callable[[int], Array] | Sequence[Array]
Sizes = Mapping[Label, int] | Sequence[int]


@dataclass(frozen=True, eq=False)
class MaxSumPlan:
    """A plan that all variables leave, some by sums and others by maxima.

    order: The variables, as labels of the scopes that the plan was made of. The plan itself has
        places in this order as labels.
    plan: The steps. What leaves by sums goes first in each.
    maximised: The places of the variables that leave by maxima.
    early: Those of them, as places, that leave before a sum that they are joined to.
    """

    order: list[Label]
    plan: Plan
    maximised: Set[Label]
    early: list[Label]

    def arranged(self, table: Array, scope: Scope) -> Array:
        """A table (sizes..., runs or 1) over labels, with its axes in the plan's order."""
        place = {x: k for k, x in enumerate(self.order)}
        axes = sorted(range(len(scope)), key=lambda axis: place[scope[axis]])
        return table.transpose(*axes, len(scope))

    def maximum(self, given: Given) -> Array:
        """The maximum, (runs or 1,), of factors (sizes..., runs or 1); all are logarithms."""
        if not self.plan.scopes:
            return np.zeros(1)
        return eliminate(self.plan, given, _MaxSumAlgebra(self.plan, self.maximised))

    def attained(self, given: Given, runs: int) -> dict[Label, Integers]:
        """The states, (runs,) by label, that attain the maximum; the first of equals.

        None is early.
        """
        sizes, algebra = self.plan.sizes, _Traced(self.plan, self.maximised)
        if self.plan.scopes:
            eliminate(self.plan, given, algebra)
        states = dict[Label, Integers]()
        for own, left, table in reversed(algebra.kept):
            lengths = [sizes[x] for x in own]
            matrix = table.reshape(math.prod(lengths), *table.shape[len(own) :])
            which = np.arange(runs) if matrix.shape[-1] > 1 else np.zeros(runs, dtype=np.intp)
            columns: Array = matrix[(slice(None), *[states[x] for x in left], which)]  # type: ignore[arg-type]
            best = columns.argmax(axis=0)
            states |= zip(own, np.unravel_index(best, lengths), strict=True)
        return {self.order[x]: own for x, own in states.items()}


class _MaxSumAlgebra(TableAlgebra):
    """Tables of logarithms, whose variables leave by sums and then by maxima."""

    def __init__(self, plan: Plan, maximised: Set[Label]) -> None:
        super().__init__(LOG_SUM_PRODUCT, plan.sizes, aligned=1)
        self.maximised = maximised

    def total(self, product: Array, scope: Scope, left: Scope) -> Array:
        """A table without the variables that leave it, which are the first ones of its scope."""
        own = tuple([x for x in scope[: len(scope) - len(left)] if x in self.maximised])
        table = super().total(product, scope, (*own, *left))
        return self.without(table, own, left) if own else table

    def without(self, table: Array, own: Scope, left: Scope) -> Array:
        """The maxima of a table over its first variables, `own`."""
        found: Array = np.maximum.reduce(table, tuple(range(len(own))))
        return found


class _Traced(_MaxSumAlgebra):
    """An algebra that keeps the tables of which it takes maxima, with those they are over."""

    def __init__(self, plan: Plan, maximised: Set[Label]) -> None:
        super().__init__(plan, maximised)
        self.kept: list[tuple[Scope, Scope, Array]] = []

    def without(self, table: Array, own: Scope, left: Scope) -> Array:
        self.kept.append((own, left, table))
        return super().without(table, own, left)


def max_sum(scopes: Sequence[Scope], sizes: Sizes, maximised: Collection[Label]) -> MaxSumPlan:
    """The plan of maxima over some variables of sums over all others.

    scopes: The scopes of the factors, of one variable or more each.
    sizes: The number of states of each variable; their labels are its indices.
    maximised: Some labels; those that no factor has are passed over.
    """
    held = sorted({x for scope in scopes for x in scope})
    place = {x: k for k, x in enumerate(held)}
    adjacent: list[set[int]] = [set() for _ in held]
    for scope in scopes:
        near = {place[x] for x in scope}
        for k in near:
            adjacent[k] |= near
    for k, near in enumerate(adjacent):
        near.discard(k)
    lengths = [sizes[x] for x in held]
    asked = [x in maximised for x in held]
    best: MaxSumPlan | None = None
    for size in PREFERENCES:
        order = _sums_first(adjacent, lengths, asked, size)
        found = _planned(scopes, sizes, [held[k] for k in order], maximised)
        if found.plan.cost <= (BOUND if found.early else EXACT):
            return found
        if best is None or found.plan.cost < best.plan.cost:
            best = found
    assert best is not None
    if best.plan.cost > EXACT:
        order = cheapest(adjacent, lengths, TRIES, 0)
        drawn = _planned(scopes, sizes, [held[k] for k in order], maximised)
        best = min(best, drawn, key=lambda each: each.plan.cost)
    return best


def _sums_first(
    adjacent: Adjacency, sizes: Sequence[int], asked: Sequence[bool], size: int
) -> list[int]:
    """An order of least fill, where a sum comes before any maximum if its table has that size."""
    graph = Filling(adjacent, sizes)
    # By whether they are maximised over: (fill, vertex). Entries that a change made out of date
    # stay until they come up.
    heaps: tuple[list[tuple[int, int]], list[tuple[int, int]]] = [], []
    left = set(range(len(sizes)))
    for each in left:
        heappush(heaps[asked[each]], (graph.fill[each], each))
    wide, order = set[int](), list[int]()

    def least(heap: list[tuple[int, int]]) -> int | None:
        """The vertex of least fill."""
        while heap:
            fill, vertex = heappop(heap)
            if vertex in left and vertex not in wide and fill == graph.fill[vertex]:
                return vertex
        return None

    while left:
        vertex: int | None = least(heaps[False])
        while vertex is not None and _entries(graph, sizes, vertex) > size:
            wide.add(vertex)
            vertex = least(heaps[False])
        if vertex is None:
            vertex = least(heaps[True])
        if vertex is None:
            vertex = min(wide, key=lambda x: (graph.fill[x], x))
        left.remove(vertex)
        wide.discard(vertex)
        order.append(vertex)
        near = graph.adjacent[vertex]
        for other in graph.eliminate(vertex) | near:
            wide.discard(other)
            heappush(heaps[asked[other]], (graph.fill[other], other))
    return order


def _entries(graph: Filling, sizes: Sequence[int], vertex: int) -> int:
    """The entries of the table that a vertex leaves."""
    return sizes[vertex] * math.prod([sizes[other] for other in graph.adjacent[vertex]])


def _planned(
    scopes: Sequence[Scope],
    sizes: Sizes,
    order: list[Label],
    maximised: Collection[Label],
) -> MaxSumPlan:
    """The plan of an order."""
    place = {x: k for k, x in enumerate(order)}
    turned = [tuple(sorted([place[x] for x in scope])) for scope in scopes]
    plan = in_order(turned, [sizes[x] for x in order], len(order))
    maxima = {place[x] for x in maximised if x in place}
    return MaxSumPlan(order, plan, maxima, _early(plan.steps, maxima))


def _early(steps: Sequence[Step], maximised: Set[Label]) -> list[Label]:
    """The variables that leave by a maximum before a sum that they are joined to.

    A step's result is taken by that which its first variable leaves, and all later steps that it
    bears on are above that.
    """
    gone = [step.scope[: len(step.scope) - len(step.left)] for step in steps]
    leaves = {x: number for number, own in enumerate(gone) for x in own}
    # Of each step, whether a sum leaves by it or above it.
    summed = [False] * len(steps)
    early = list[Label]()
    for number in range(len(steps) - 1, -1, -1):
        left = steps[number].left
        above = bool(left) and summed[leaves[left[0]]]
        summed[number] = above or any(x not in maximised for x in gone[number])
        if above:
            early += [x for x in gone[number] if x in maximised]
    return early[::-1]
