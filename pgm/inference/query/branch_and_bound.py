"""The states of a marginal MAP where tables that hold it are too large: branch and bound.

A *node* of the search is some states of the variables asked for that were *settled* so far, in one
order for all nodes. Its bound is the maximum over the other variables asked for of sums over the
rest, as far as sums leave first (`MaxSumPlan`): no assignment that agrees with the node has a
higher probability. From some level on none leaves early, the bounds are what is asked for, and the
nodes are *leaves*. The search goes down to a leaf first, and then divides the node of the highest
bound, until no bound is above the best leaf. Nodes of one level are bounded in one call.

Source: Park and Darwiche (2003), Solving MAP exactly using systematic search.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush
from itertools import count

import numpy as np

from pgm.elimination.max_sum import MaxSumPlan, max_sum
from pgm.elimination.plan import Label, Scope
from pgm.errors import GraphError
from pgm.kernels.arrays import Array, Integers
from pgm.resources import gibibytes
from pgm.schedules import limits

# How many table entries are computed, before the best leaf so far is told with its bound.
WORK = 2**33
# Bounds that agree to so much of their size are equal.
CLOSE = 1e-12
# How many nodes are divided at once, at the most.
TOGETHER = 16


@dataclass(frozen=True, eq=False)
class Problem:
    """Factors, whose maximum over some variables of sums over the others is looked for.

    scopes: Labels of variables, by factor.
    logs: The logarithms of the factors, (sizes...,).
    sizes: The number of states of each variable, by label.
    asked: The labels of the variables that are maximised over.
    """

    scopes: Sequence[Scope]
    logs: Sequence[Array]
    sizes: Mapping[Label, int] | Sequence[int]
    asked: Collection[Label]


@dataclass(frozen=True, eq=False)
class Found:
    """A leaf.

    states: By label, of all variables asked for.
    level: Its logarithm.
    bound: No other is above that; `level` itself where it is the best.
    """

    states: dict[Label, int]
    level: float
    bound: float


@dataclass(frozen=True, eq=False)
class _Level:
    """The nodes of one depth: the variables that are settled, and the plan for all others."""

    problem: Problem
    settled: tuple[Label, ...]

    @cached_property
    def open(self) -> list[tuple[int, Scope]]:
        """The factors, by number, that have variables that are not settled, with these."""
        found = []
        for number, scope in enumerate(self.problem.scopes):
            own = tuple([x for x in scope if x not in self.settled])
            if own:
                found.append((number, own))
        return found

    @cached_property
    def plan(self) -> MaxSumPlan:
        """The plan for the variables that are not settled."""
        scopes = [own for _, own in self.open]
        return max_sum(scopes, self.problem.sizes, self.problem.asked)

    @cached_property
    def next(self) -> Label | None:
        """The variable that the next level settles: the last that is early, if any is."""
        early = self.plan.early
        return self.plan.order[early[-1]] if early else None

    @cached_property
    def entries(self) -> int:
        """How many table entries a node takes."""
        return max(self.plan.plan.cost, 1)

    def require_size(self) -> None:
        """Raise a GraphError if the tables are too large, of a leaf those that are kept, too."""
        plan = self.plan.plan
        entries = plan.peak if self.plan.early else plan.cost
        if entries > limits.LIMIT:
            raise GraphError(
                f"the tables that a marginal MAP needs are too large: {gibibytes(entries)}, where "
                f"{gibibytes(limits.LIMIT)} is the limit, even where maxima are taken before sums "
                "for a bound; ask for other variables, or give evidence that parts the network"
            )

    def below(self) -> _Level:
        """The next level."""
        assert self.next is not None
        return _Level(self.problem, (*self.settled, self.next))

    def bounds(self, nodes: Integers) -> Array:
        """The bounds, (nodes,), of settled variables' states (nodes, settled)."""
        given, constant = self._given(nodes)
        return constant + self.plan.maximum(given) if given else constant

    def attained(self, node: Integers) -> dict[Label, int]:
        """The states of all variables asked for that attain a leaf's value, of its (settled,)."""
        given, _ = self._given(node[None])
        found = dict(zip(self.settled, node.tolist(), strict=True))
        if given:
            best = self.plan.attained(given, 1)
            found |= {x: int(own[0]) for x, own in best.items()}
        return found

    def _given(self, nodes: Integers) -> tuple[list[Array], Array]:
        """The factors of some nodes, (sizes..., nodes or 1), and the product of the others."""
        states = dict(zip(self.settled, nodes.T, strict=True))
        own = dict(self.open)
        given, constant = list[Array](), np.zeros(len(nodes))
        for number, (scope, logs) in enumerate(
            zip(self.problem.scopes, self.problem.logs, strict=True)
        ):
            left = own.get(number, ())
            known = [x for x in scope if x in states]
            table = logs.transpose([scope.index(x) for x in (*left, *known)])
            table = table[(..., *[states[x] for x in known])] if known else table[..., None]
            if left:
                given.append(self.plan.arranged(table, left))
            else:
                constant = constant + table
        return given, constant


class Search:
    """A search for the best leaf.

    waiting: By level, its nodes that may be divided: (−bound, a number each, states).
    leaf: The best one so far, by its level, its states of settled variables, and its value.
    """

    def __init__(self, problem: Problem) -> None:
        root = _Level(problem, ())
        root.require_size()
        self.levels = [root]
        self.waiting: list[list[tuple[float, int, Integers]]] = [[]]
        self.leaf: tuple[_Level, Integers, float] | None = None
        self._numbers = count()
        self._enter(0, np.zeros((1, 0), dtype=np.intp))

    def found(self) -> Found | None:
        """The best leaf, or the best so far when the work is spent; None if all are impossible."""
        work = 0
        while self.leaf is None or work < WORK:
            depth = self._deepest() if self.leaf is None else self._highest()
            if depth is None:
                break
            work += self._divide(depth)
        if self.leaf is None:
            return None
        level, node, value = self.leaf
        depth = self._highest()
        bound = value if depth is None else -self.waiting[depth][0][0]
        return Found(level.attained(node), value, bound)

    def _deepest(self) -> int | None:
        """The deepest level that has nodes to divide."""
        return max((k for k, own in enumerate(self.waiting) if own), default=None)

    def _highest(self) -> int | None:
        """The level of the node with the highest bound, if that is above the best leaf."""
        filled = [k for k, own in enumerate(self.waiting) if own]
        best = max(filled, key=lambda k: (-self.waiting[k][0][0], k), default=None)
        return best if best is not None and self._may(-self.waiting[best][0][0]) else None

    def _may(self, bound: float) -> bool:
        """Whether a node with this bound may have a better leaf than the best so far."""
        if self.leaf is None:
            return bound > -np.inf
        value = self.leaf[2]
        return bound > value + CLOSE * abs(value)

    def _divide(self, depth: int) -> int:
        """Divide nodes of one level, those of the highest bounds: how many entries that took."""
        level = self.levels[depth]
        assert level.next is not None
        if len(self.levels) == depth + 1:
            self.levels.append(level.below())
            self.waiting.append([])
        size = level.problem.sizes[level.next]
        below = self.levels[depth + 1]
        most = 1 if self.leaf is None else max(1, limits.BATCH // (below.entries * size))
        waiting, nodes = self.waiting[depth], list[Integers]()
        while waiting and len(nodes) < min(most, TOGETHER):
            bound, _, node = heappop(waiting)
            if self._may(-bound):
                nodes.append(node)
        if not nodes:
            return 0
        states = np.tile(np.arange(size), len(nodes))[:, None]
        children = np.concatenate([np.repeat(nodes, size, axis=0), states], axis=1)
        self._enter(depth + 1, children)
        return below.entries * len(children)

    def _enter(self, depth: int, nodes: Integers) -> None:
        """Bound nodes of a level, and have them wait; or see whether leaves are the best."""
        level = self.levels[depth]
        bounds = np.broadcast_to(level.bounds(nodes), len(nodes))
        if level.next is None:
            level.require_size()
            top = int(bounds.argmax())
            if self._may(float(bounds[top])):
                self.leaf = level, nodes[top], float(bounds[top])
            return
        for node, bound in zip(nodes, bounds.tolist(), strict=True):
            if self._may(bound):
                heappush(self.waiting[depth], (-bound, next(self._numbers), node))
