"""The variables that a marginal MAP does not ask for, summed out.

Sums and maxima do not change places: all other variables leave first, however wide the tables that
this makes. The factors left are a Markov network of the variables asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pgm import elimination
from pgm.beliefs.discrete.run_pieces import pieces
from pgm.clustergraph import ClusterGraph
from pgm.compile import compile
from pgm.errors import GraphError, NumericalError
from pgm.evidence.static import BoundStates
from pgm.factors import Table
from pgm.factors.axes import States
from pgm.factors.scope import listed
from pgm.inference.query.elimination import tables
from pgm.inference.query.plan import QueryPlan
from pgm.inference.query.requisite import Requisite
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT
from pgm.networks import MarkovNetwork
from pgm.resources import gibibytes
from pgm.schedules import limits

# How far below the largest entry a logarithm may be for its number to be one of a `Table`.
DEEPEST = -690.0


def summed_out(
    network: MarkovNetwork, wanted: States, evidence: BoundStates
) -> Iterator[ClusterGraph]:
    """Of each run, the junction tree of the factors left over the variables wanted.

    Their product is p(wanted, evidence) but for a constant of the run; some run has evidence.
    """
    plan = QueryPlan.of(Requisite.of(network, wanted, evidence), wanted)
    last = plan.sums.steps[-1]
    # The last step would multiply what is left.
    plan = replace(plan, sums=replace(plan.sums, steps=plan.sums.steps[:-1]))
    _require_size(plan, wanted)
    scopes = [tuple([plan.order[k] for k in scope]) for scope in last.scopes]
    alone = [Table.vacuous(v) for v in wanted if not any(v in scope for scope in scopes)]
    tree: ClusterGraph | None = None
    for piece in pieces(evidence, limits.BATCH // max(plan.sums.peak, 1)):
        left = _left(plan, last.factors, piece)
        for run in range(piece.runs):
            pairs = zip(scopes, left, strict=True)
            factors = [_table(scope, logs[..., run % logs.shape[-1]]) for scope, logs in pairs]
            own = MarkovNetwork([*factors, *alone])
            # All runs have the same scopes, and trees of the same shape.
            if tree is None:
                tree = compile(own)
            yield tree._with(own, tree._members, tree._shared, tree._assigned)


def _left(plan: QueryPlan, factors: tuple[int, ...], evidence: BoundStates) -> list[Array]:
    """The factors of a plan of some numbers, as logarithms, (sizes..., runs or 1)."""
    given, algebra = tables(plan, evidence, LOG_SUM_PRODUCT)
    first = len(plan.sums.scopes)
    found = {}
    for number, made in enumerate(elimination.results(plan.sums, given, algebra), first):
        if number in factors:
            found[number] = made
    return [given(k) if k < first else found[k] for k in factors]


def _table(scope: States, logs: Array) -> Table:
    """A factor of logarithms."""
    top = logs.max()
    below = logs - top
    if ((below < DEEPEST) & (below > -np.inf)).any():
        raise NumericalError(
            f"what is left over ({listed(scope)}) when the other variables are summed out has "
            f"entries e^{below[below > -np.inf].min():.0f} times its largest, which numbers of "
            "float64 do not hold; ask for more variables, or for all"
        )
    return Table._make(scope, np.exp(below), top)


def _require_size(plan: QueryPlan, wanted: States) -> None:
    """Raise a GraphError if the tables need more memory at a time than the limit allows."""
    if plan.sums.peak > limits.LIMIT:
        raise GraphError(
            f"summing all variables but ({listed(wanted)}) out needs tables of "
            f"{gibibytes(plan.sums.peak)} at a time, where {gibibytes(limits.LIMIT)} is the limit. "
            "Ask for other variables too, or for all, or give evidence that parts the network",
            variable=wanted[0],
        )
