"""The order in which the variables of a query are summed out, and the plan of the products.

A variable is *hidden* if it has several states and is not observed in all runs. The order has all
hidden variables, those asked for last, and a hidden variable is given by its place in the order.
The *scope* of a table is the ascending tuple of its variables' places. Tables are numbered as in a
`Plan`: first the CPDs' tables, then the evidence weights of variables with soft evidence or
observed in some runs alone, then the results of the plan's steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pgm.compile.elimination import Adjacency, min_fill
from pgm.errors import GraphError
from pgm.factors.axes import States
from pgm.factors.scope import listed
from pgm.inference import limits
from pgm.inference.elimination import Plan, in_order
from pgm.inference.query.requisite import Requisite
from pgm.resources import gibibytes

# From this cost of a plan on, a second order is tried: that takes less time than it may save.
LARGE = 2**16


@dataclass(frozen=True, eq=False)
class QueryPlan:
    """The plan by which the joint of the variables asked for is computed.

    requisite: The CPDs and the evidence that bear on the query.
    order: The hidden variables of `requisite`: those that are summed out, in this order, and then
        those asked for.
    weighted: The hidden variables with soft evidence, or observed in some runs alone.
    sums: The products to make, of the CPDs' tables and then the weights of each of `weighted`;
        variables are places in `order`.
    """

    requisite: Requisite
    order: States
    weighted: States
    sums: Plan

    @classmethod
    def of(cls, requisite: Requisite, wanted: States) -> QueryPlan:
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
        if best.sums.cost > LARGE:
            other = cls._ordered(requisite, families, adjacent, [1] * len(hidden), stages)
            best = min(best, other, key=lambda each: each.sums.cost)
        return best

    @classmethod
    def _ordered(
        cls,
        requisite: Requisite,
        families: Sequence[tuple[int, ...]],
        adjacent: Adjacency,
        weights: Sequence[int],
        stages: Sequence[int],
    ) -> QueryPlan:
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
        sums = in_order(scopes, [v.size for v in order], len(order) - sum(stages))
        return cls(requisite, order, weighted, sums)

    def require_size(self) -> None:
        """Raise a GraphError if the tables need more memory at a time than the limit allows.

        This is known from their sizes, before any table is made.
        """
        peak, products = self.sums.peak, self.sums.products
        if peak <= limits.LIMIT:
            return
        largest = max(range(len(products)), key=products.__getitem__)
        scope = [self.order[k] for k in self.sums.steps[largest].scope]
        raise GraphError(
            f"the query needs tables that are too large: {gibibytes(peak)} at a time, "
            f"where {gibibytes(limits.LIMIT)} is the limit, the largest over "
            f"({listed(scope)}), {gibibytes(products[largest])}. Ask for fewer variables at "
            "once, or give evidence that parts the network; a loopy graph has small tables, "
            "pgm.infer(pgm.compile(network, method=pgm.Bethe()), evidence, "
            "schedule=pgm.Flooding()), but its beliefs are approximate",
            variable=scope[0],
        )
