"""Queries: the joint of some variables of a discrete network given evidence.

The *requisite* part of a network is the CPDs and the evidence on which the answer depends. An
*elimination plan* says in which order the other variables of this part are summed out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.beliefs.discrete.run import of_tree
from pgm.beliefs.discrete.run_pieces import pieces
from pgm.boundary import as_tuple
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.display import titled
from pgm.errors import EvidenceError, GraphError, ModelError
from pgm.evidence import Evidence
from pgm.evidence.static import BoundStates, bind_discrete
from pgm.factors import Table
from pgm.factors.axes import States, as_states, discrete, sizes
from pgm.factors.scope import as_scope, listed, require_order, unknown_name
from pgm.inference.query.asked import require_mapping
from pgm.inference.query.elimination import NOTHING, eliminate, require_possible
from pgm.inference.query.implied import with_implied
from pgm.inference.query.left_out import Contradiction, contradictions
from pgm.inference.query.plan import QueryPlan
from pgm.inference.query.requisite import Requisite, certain
from pgm.kernels.arrays import Array
from pgm.networks import DynamicBayesianNetwork, MarkovNetwork
from pgm.schedules import limits
from pgm.schedules.impossible import RAISE, ImpossibleEvidence, allows
from pgm.variables import Variable

# Times, in units of that for an entry of an elimination's tables: for each entry of a tree's tables
# in a pass up and down (ENTRY), for such a pass at the least (PASS), and for planning and summing
# out a variable at the least (VARIABLE). Measured, to a factor of two.
ENTRY, PASS, VARIABLE = 3, 10_000, 2_000


@public
def query(
    network: MarkovNetwork | ClusterGraph,
    variables: Variable | Iterable[Variable],
    evidence: Evidence = NOTHING,
    *,
    impossible: str = RAISE,
) -> Table:
    r"""Find the joint probabilities of some variables of a discrete network given evidence.

    .. math:: p(\text{variables} \mid \text{evidence})
              \propto \sum_{\text{others}} \prod_{\text{CPDs}} p(\text{child} \mid \text{parents})

    The answer is exact, and equal to ``infer(compile(network), evidence).joint(*variables)`` if all
    columns of the CPDs sum to one exactly; otherwise the two may differ by as much as the sums
    differ from one. CPDs that do not bear on the variables are left out: those of variables that
    are neither asked for nor observed and have no such descendant, and those that the evidence
    separates from the variables asked for. A query may therefore be possible in a network whose
    junction tree is too large. One query costs less than all marginals; for many at the same
    evidence, call `infer` once.

    Parameters
    ----------
    network : BayesianNetwork, MarkovNetwork or ClusterGraph
        Discrete. If it is a compiled tree, the answer is read from the tree's posterior where that
        takes less time: for many queries of a small network, compile it once and pass the graph. Of
        a compiled graph with loops, the network that it was compiled from is used.
    variables : Discrete or iterable of Discrete
        Not observed in all runs. The axes of the result are in this order.
    evidence : mapping of Discrete, optional
        As for `infer`; leading axes are runs. Evidence that other evidence separates from the
        variables is only checked for being possible: by elimination, among the CPDs whose tables
        have zeros, except where this would need tables above the limit of memory.
    impossible : str
        What is done where evidence has probability zero: ``"raise"`` raises an EvidenceError; with
        ``"allow"`` the probabilities of runs with such evidence are NaN, and those of other runs
        are found.

    Returns
    -------
    Table
        Probabilities (..., size of each variable...), with the log-scale zero.

    Raises
    ------
    EvidenceError
        If the evidence does not fit the network or has probability zero, or one of the variables
        is observed or unknown.
    GraphError
        If the network is dynamic or continuous, or if a table on the way, or the answer over all
        runs, is too large.
    ModelError
        If `network` is no network, one of the variables is asked for twice, or several as a set,
        which has no order, or `impossible` is neither ``"raise"`` nor ``"allow"``.

    References
    ----------
    Zhang and Poole (1996), Exploiting causal independence in Bayesian network inference, section 3.
    Koller and Friedman (2009), Probabilistic Graphical Models, chapter 9.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> query(rainy, rain, {wet: "yes"})
    Table(rain: no 0.25, yes 0.75)
    """
    asked, graph = _discrete(network)
    require_mapping(evidence)
    known = frozenset(asked.variables)
    bound = bind_discrete(known, evidence)
    scope = as_states(wanted(variables, known, bound, "query"))
    if bound.runs > 1:
        entries = math.prod(sizes(scope))
        limits.require_runs(entries, bound.runs, f"the joint over ({listed(scope)})")
    allow = allows(impossible)
    inside = asked._factorised if graph is None else graph._factorised
    bound = with_implied(inside, bound)
    requisite = Requisite.of(inside, scope, bound)
    elsewhere = contradictions(requisite.left_out, bound)
    try:
        values = _answer(graph, requisite, scope, allow=allow)
    except ImpossibleEvidence as error:
        _require_possible_elsewhere(elsewhere, bound, int(error.lost.argmax()))
        raise
    if not allow:
        _require_possible_elsewhere(elsewhere, bound, bound.runs)
    lead, shape = requisite.evidence.lead, sizes(scope)
    values = np.moveaxis(values, -1, 0).reshape(lead + shape)
    values = np.broadcast_to(values, bound.lead + shape)
    for each in elsewhere:
        lost = each.lost.reshape((*bound.lead, *(1,) * len(shape)))
        values = np.where(lost, np.nan, values)
    return Table._make(scope, values)


def _require_possible_elsewhere(
    elsewhere: Sequence[Contradiction], evidence: BoundStates, before: int
) -> None:
    """Raise the error of the first contradiction, if its first run is before run `before`.

    `elsewhere` are the contradictions among the CPDs that the query leaves out, each with a mask of
    runs; the first is the one of the earliest run. `evidence` is that of the whole network.
    `before` is the first run that the query's own part finds impossible, or the number of runs.
    """
    first = min(elsewhere, key=lambda each: int(each.lost.argmax()), default=None)
    if first is not None and int(first.lost.argmax()) < before:
        raise first.error(evidence) from None


def _discrete(network: Any) -> tuple[MarkovNetwork, ClusterGraph | None]:
    """The network asked about and its compiled graph, either of which the user gave as `network`.

    The graph is None if the user gave a network. Raises a GraphError for a network or graph that is
    dynamic or continuous, a ModelError for anything that is neither network nor graph.
    """
    if isinstance(network, DynamicBayesianNetwork | DynamicGraph):
        raise GraphError(
            "query is for discrete networks, and this one is dynamic; its beliefs are "
            "pgm.smooth(model, evidence)[x], or pgm.infer(graph, evidence).joint(...)"
        )
    graph = network if isinstance(network, ClusterGraph) else None
    asked = graph.network if graph is not None else network
    if not isinstance(asked, MarkovNetwork):
        raise ModelError(
            f"query takes a network without time or its compiled graph, not {titled(network)}"
        )
    if not asked.discrete:
        raise GraphError(
            f"query is for discrete networks, and this one is {asked._kind}; its joints are "
            "pgm.infer(pgm.compile(network), evidence).joint(...)"
        )
    return asked, graph


def wanted(variables: Any, known: frozenset[Variable], evidence: BoundStates, what: str) -> States:
    """The variables that the user asks for, in a call of `what`, as a tuple.

    `variables` is what the user gave, one variable or several; `known` are the network's variables.
    Raises an EvidenceError if no variable is asked for, or one that is not in the network or is
    observed in all runs; a ModelError if one is asked for twice, or several as a set.
    """
    require_order(variables, "what is asked for")
    several = as_tuple(variables)
    found = (variables,) if several is None else several
    for variable in found:
        if not isinstance(variable, Variable) or variable not in known:
            raise EvidenceError(
                f"{what} of {variable!r}, {unknown_name(variable, known)}",
                variable=variable if isinstance(variable, Variable) else None,
            )
    scope = discrete(as_scope(found))
    if not scope:
        raise EvidenceError(f"{what} takes one or more variables")
    observed = certain(evidence)
    for variable in scope:
        if variable in observed:
            raise EvidenceError(
                f"{variable!r} is observed: its value is its evidence", variable=variable
            )
    return scope


def _answer(
    graph: ClusterGraph | None, requisite: Requisite, scope: States, *, allow: bool
) -> Array:
    """The joint of the variables `scope`, (sizes..., runs or 1), in whichever way takes less time.

    The two ways are reading it from the posterior of `graph`, if that is a tree, and elimination
    in the part `requisite` of the network. `graph` is None if the network was not compiled. With
    `allow`, runs of impossible evidence have NaN; else they raise ImpossibleEvidence.
    """
    if not requisite.hidden:
        return np.ones((*sizes(scope), 1))
    runs, least = requisite.evidence.runs, VARIABLE * len(requisite.hidden)
    tree = math.inf
    if graph is not None and graph.is_tree and sum(graph.sizes) <= limits.LIMIT:
        tree = PASS + ENTRY * graph.cost * runs
    plan = QueryPlan.of(requisite, scope) if tree > least else None
    if graph is not None and (plan is None or tree <= least + plan.sums.cost * runs):
        # Variables that are far apart in the tree may need larger tables there.
        with suppress(GraphError):
            return _read(graph, requisite.evidence, scope, allow=allow)
    return _eliminated(plan or QueryPlan.of(requisite, scope), scope, allow=allow)


def _eliminated(plan: QueryPlan, scope: States, *, allow: bool) -> Array:
    """The joint of the variables `scope`, (sizes..., runs or 1), by summing the others out.

    With `allow`, runs of impossible evidence have NaN; else they raise ImpossibleEvidence.
    """
    plan.require_size()
    some = pieces(plan.requisite.evidence, limits.BATCH // plan.sums.peak)
    parts = [eliminate(plan, piece) for piece in some]
    values = np.concatenate(parts, axis=-1)
    if not allow:
        require_possible(plan, values)
    asked = plan.order[len(plan.order) - values.ndim + 1 :]
    axes = [asked.index(v) for v in scope if v in asked]
    return values.transpose(*axes, -1).reshape((*sizes(scope), -1))


def _read(graph: ClusterGraph, evidence: BoundStates, scope: States, *, allow: bool) -> Array:
    """The joint of the variables `scope`, (sizes..., runs or 1), from the posterior of a tree.

    `evidence` is the evidence that bears on the query. With `allow`, runs of impossible evidence
    have NaN; else they raise ImpossibleEvidence.
    """
    values = of_tree(graph, evidence, limits.Room.of(None, graph), allow=allow).joint(*scope).values
    return np.moveaxis(values.reshape(-1, *sizes(scope)), 0, -1)
