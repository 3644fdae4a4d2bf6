"""The order in which the variables of a query are summed out, and the products that this takes.

A variable is *hidden* if it has several states and is not observed in all runs. The order has all
hidden variables, those asked for last, and a hidden variable is given by its place in the order.
The *scope* of a table is the ascending tuple of its variables' places. Tables are numbered: first
the CPDs' tables, then the evidence weights of variables with soft evidence or observed in some runs
alone, then the results of the plan's steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from pgm.compile.elimination import Adjacency, min_fill
from pgm.errors import GraphError
from pgm.factors.axes import States
from pgm.factors.scope import listed
from pgm.inference import limits
from pgm.inference.query.requisite import Requisite
from pgm.resources import gibibytes

# From this cost of a plan on, a second order is tried: that takes less time than it may save.
LARGE = 2**16


@dataclass(frozen=True)
class Step:
    """A product of tables over `scope`, summed over the first `summed` variables of it.

    `factors` are the numbers of the tables, the smallest table first. `summed` may be zero.
    """

    factors: tuple[int, ...]
    scope: tuple[int, ...]
    summed: int


@dataclass(frozen=True, eq=False)
class EliminationPlan:
    """The steps by which the joint of the variables asked for is computed, each making one table.

    The axes of all tables follow the plan's order: no table is ever transposed, and sums are over
    the first axes.

    requisite: The CPDs and the evidence that bear on the query.
    order: The hidden variables of `requisite`: those that are summed out, in this order, and then
        those asked for.
    scopes: The scopes of the CPDs' tables, then of the evidence weights of each of `weighted`.
    weighted: The hidden variables with soft evidence, or observed in some runs alone.
    steps: The products to make, in order; the last one multiplies the tables left to the joint.
    """

    requisite: Requisite
    order: States
    scopes: tuple[tuple[int, ...], ...]
    weighted: States
    steps: Sequence[Step]

    @classmethod
    def of(cls, requisite: Requisite, wanted: States) -> EliminationPlan:
        """The plan in the order of min-fill weighted by numbers of states, `wanted` variables last.

        If the tables of all its steps together have more than 2¹⁶ entries for one run, plain
        min-fill is tried too, and the plan of fewer entries is taken.
        """
        hidden = requisite.hidden
        place = {v: k for k, v in enumerate(hidden)}
        families = [tuple(place[v] for v in scope) for scope in requisite.open]
        adjacent: list[set[int]] = [set() for _ in hidden]
        for family in families:
            for vertex in family:
                adjacent[vertex].update(family)
        for vertex, near in enumerate(adjacent):
            near.discard(vertex)
        stages = [0] * len(hidden)
        for variable in wanted:
            if variable in place:  # one of a single state is not
                stages[place[variable]] = 1
        sizes = [v.size for v in hidden]
        best = cls._ordered(requisite, families, adjacent, sizes, stages)
        if best.cost > LARGE:
            other = cls._ordered(requisite, families, adjacent, [1] * len(hidden), stages)
            best = min(best, other, key=lambda plan: plan.cost)
        return best

    @classmethod
    def _ordered(
        cls,
        requisite: Requisite,
        families: Sequence[tuple[int, ...]],
        adjacent: Adjacency,
        weights: Sequence[int],
        stages: Sequence[int],
    ) -> EliminationPlan:
        """The plan in weighted min-fill order, with the variables asked for last.

        Here a variable is a number, its place in `requisite.hidden`. `families` has the variables
        of each CPD's table, and `adjacent` the neighbours of each variable, with which it shares a
        table. `weights` (numbers of states, or ones) and `stages` have an entry for each variable:
        the stage is 1 for a variable asked for, 0 for one that is summed out.
        """
        found = min_fill(adjacent, weights, stages)
        position = [0] * len(found)
        for k, vertex in enumerate(found):
            position[vertex] = k
        order = tuple(requisite.hidden[k] for k in found)
        scopes = [tuple(sorted(map(position.__getitem__, family))) for family in families]
        evidence = requisite.evidence
        soft = {v: None for v, s in evidence.states.items() if not isinstance(s, int)}
        places = {v: k for k, v in enumerate(order)}
        weighted = tuple(v for v in (soft | dict.fromkeys(evidence.weights)) if v in places)
        scopes += [(places[v],) for v in weighted]
        steps = _steps(scopes, [v.size for v in order], len(order) - sum(stages))
        return cls(requisite, order, tuple(scopes), weighted, steps)

    @cached_property
    def sizes(self) -> list[int]:
        """The number of entries of the table of each step, before its sum, for one run."""
        states = [v.size for v in self.order]
        return [math.prod([states[k] for k in step.scope]) for step in self.steps]

    @cached_property
    def cost(self) -> int:
        """The number of entries of the tables of all steps, before their sums, for one run."""
        return sum(self.sizes)

    @cached_property
    def peak(self) -> int:
        """The most entries, for one run, that the tables held at the same time have together.

        These tables are the product of one step, before its sum, and the results of earlier steps
        that no step before has used up.
        """
        first = len(self.scopes)
        states = [v.size for v in self.order]
        waiting: dict[int, int] = {}
        held = peak = 0
        for k, (step, entries) in enumerate(zip(self.steps, self.sizes, strict=True), first):
            peak = max(peak, held + entries)
            held -= sum(waiting.pop(factor, 0) for factor in step.factors)
            waiting[k] = math.prod([states[place] for place in step.scope[step.summed :]])
            held += waiting[k]
        return peak

    def require_size(self) -> None:
        """Raise a GraphError if the tables need more memory at a time than the limit allows.

        This is known from their sizes, before any table is made.
        """
        if self.peak <= limits.LIMIT:
            return
        sizes = self.sizes
        largest = max(range(len(sizes)), key=sizes.__getitem__)
        scope = [self.order[k] for k in self.steps[largest].scope]
        raise GraphError(
            f"the query needs tables that are too large: {gibibytes(self.peak)} at a time, "
            f"where {gibibytes(limits.LIMIT)} is the limit, the largest over "
            f"({listed(scope)}), {gibibytes(sizes[largest])}. Ask for fewer variables at "
            "once, or give evidence that parts the network; a loopy graph has small tables, "
            "pgm.infer(pgm.compile(network, method=pgm.Bethe()), evidence, "
            "schedule=pgm.Flooding()), but its beliefs are approximate",
            variable=scope[0],
        )


def _steps(scopes: Sequence[tuple[int, ...]], sizes: Sequence[int], hidden: int) -> list[Step]:
    """The steps of bucket elimination, which sums the first `hidden` variables out one by one.

    `hidden` is the number of variables that are summed out: all but those asked for. `scopes` are
    the scopes of the CPDs' tables and of the evidence weights, `sizes` the numbers of states of all
    variables in the plan's order. Each variable to be summed out has a bucket, and each table waits
    in the bucket of its first variable. A step multiplies the tables of a bucket and sums over the
    bucket's variable; its result goes to a later bucket. A result alone in its bucket is summed
    over one more variable by the step that makes it. The last step multiplies the tables that are
    left, over variables asked for alone, and sums over nothing.
    """
    buckets: list[list[int]] = [[] for _ in range(hidden + 1)]
    held = list(scopes)
    for factor, scope in enumerate(held):
        buckets[min(scope[0], hidden)].append(factor)
    first = len(held)
    made: list[Step] = []

    def entries(factor: int) -> int:
        """The number of entries, for one run, of the table with the number `factor`."""
        return math.prod([sizes[k] for k in held[factor]])

    for place in range(hidden):
        found = buckets[place]
        if len(found) == 1 and found[0] >= first:
            factor = found[0]
            old = made[factor - first]
            made[factor - first] = Step(old.factors, old.scope, old.summed + 1)
            held[factor] = held[factor][1:]
        else:
            scope = tuple(sorted({k for factor in found for k in held[factor]}))
            factor = len(held)
            made.append(Step(tuple(sorted(found, key=entries)), scope, 1))
            held.append(scope[1:])
        buckets[min(held[factor][0], hidden)].append(factor)
    rest = tuple(sorted(buckets[hidden], key=entries))
    made.append(Step(rest, tuple(range(hidden, len(sizes))), 0))
    return made
