"""The order in which the variables of a query are summed out, and the plan of the products.

A variable is *hidden* if it has several states and is not observed in all runs. The order has all
hidden variables, those asked for last, and a hidden variable is given by its place in the order.
The *scope* of a table is the ascending tuple of its variables' places. Tables are numbered as in a
`Plan`: first the CPDs' tables, then the evidence weights of variables with soft evidence or
observed in some runs alone, then the results of the plan's steps.
"""

from __future__ import annotations

from dataclasses import dataclass

from pgm.elimination import Plan, Scope, by_fill
from pgm.errors import GraphError
from pgm.factors.axes import States
from pgm.factors.scope import listed
from pgm.inference.query.requisite import Requisite
from pgm.resources import gibibytes
from pgm.schedules import limits


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
        """The plan in the order of min-fill, `wanted` variables last."""
        hidden = requisite.hidden
        place = {v: k for k, v in enumerate(hidden)}
        weighted, scopes = scopes_of(requisite)
        asked = [place[v] for v in wanted if v in place]  # one of a single state is not
        order, sums = by_fill(scopes, [v.size for v in hidden], asked)
        return cls(requisite, tuple(hidden[k] for k in order), weighted, sums)

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


def scopes_of(requisite: Requisite) -> tuple[States, list[Scope]]:
    """The hidden variables with weights, and the scopes of a query's tables, then of the weights.

    A variable is told by its place in ``requisite.hidden``.
    """
    place = {v: k for k, v in enumerate(requisite.hidden)}
    evidence = requisite.evidence
    soft = {v: None for v, s in evidence.states.items() if not isinstance(s, int)}
    weighted = tuple(v for v in (soft | dict.fromkeys(evidence.weights)) if v in place)
    scopes = [tuple([place[v] for v in scope]) for scope in requisite.open]
    return weighted, [*scopes, *[(place[v],) for v in weighted]]
