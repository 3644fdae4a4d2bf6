r"""Sensitivity of a posterior probability to each entry of the tables of a Bayesian network.

Let θ be the entry of a column for the child's state x, and s the column's sum, one but for
rounding. As θ changes, the other entries of the column keep their proportions and the column its
sum (proportional co-variation). p(y, e) and p(e), the probabilities of the event and of the
evidence, are then linear in θ. Each of them is w + r, where w is what the entry alone would make
if it took the whole column, s ∂p/∂θ, or what the others would, and r is the sum over all other
columns. The *ends* are their values at θ = 0 and θ = s.

Source: Chan and Darwiche (2002), When do numbers really matter? Castillo, Gutiérrez and Hadi
(1997), Sensitivity analysis in discrete Bayesian networks. Kjærulff and van der Gaag (2000), Making
sensitivity analysis computationally efficient.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.beliefs.discrete.derivatives import Derivatives, derivatives
from pgm.beliefs.discrete.run import of_tree
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph, compile
from pgm.cpds import TableCPD
from pgm.display import titled
from pgm.errors import EvidenceError, GraphError, ModelError, NumericalError
from pgm.evidence import Evidence
from pgm.evidence.static import BoundStates, bind_discrete
from pgm.factors.axes import discrete
from pgm.inference.query.asked import require_mapping, require_whole_tables
from pgm.inference.query.elimination import NOTHING
from pgm.inference.query.sensitivities import Sensitivities, Sensitivity
from pgm.kernels.arrays import Array, frozen
from pgm.kernels.semirings import exp, log_sum
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork, MarkovNetwork
from pgm.schedules import limits
from pgm.variables import Discrete, Variable

# Arrays of the size of all clusters' tables that are kept: products, and numbers of zeros.
ARRAYS = 2


@public
def sensitivity(
    network: BayesianNetwork | ClusterGraph,
    event: Mapping[Discrete, str | int],
    evidence: Evidence = NOTHING,
) -> Sensitivities:
    r"""Find how the posterior probability of an event depends on each entry of the tables.

    .. math:: P(\theta) = p(\text{event} \mid \text{evidence}) = \frac{a\,\theta + b}{c\,\theta + d}

    Here θ is one entry of one table, and the others of its column change with it, in proportion;
    all other columns stay. Derivatives and functions of all entries are exact, and found together,
    from two passes of messages over the junction tree, one with the event and one without.

    Parameters
    ----------
    network : BayesianNetwork or ClusterGraph
        Of tables; or its compiled graph, which is used if it has no loops.
    event : mapping of Discrete
        States, by name or index, of variables without evidence: the event is that all have these.
    evidence : mapping of Discrete, optional
        As for `infer`; leading axes are runs.

    Returns
    -------
    Sensitivities
        ``found[x].derivative``, ``.probability(theta)``, ``.interval(lowest, highest)`` and
        ``.coefficients`` of the table of x, and ``found.ranked(count)``.

    Raises
    ------
    ModelError
        If `network` is no network without time.
    GraphError
        If it is not one of tables alone, each with a direction, or its junction tree is too large.
    EvidenceError
        If event or evidence do not fit the network, the event is observed, or the evidence has
        probability zero.
    NumericalError
        If a derivative is too large for a number.

    References
    ----------
    Chan & Darwiche, When do numbers really matter?, 2002; Kjærulff & van der Gaag, Making
    sensitivity analysis computationally efficient, 2000.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> found = pgm.sensitivity(rainy, {rain: "yes"}, {wet: "yes"})
    >>> round(float(found.probability), 6)
    0.75
    >>> lower, upper = found[rain].interval(lowest=0.9)  # of p(rain=yes), for P(yes | wet) ≥ 0.9
    >>> round(float(lower[1]), 6), float(upper[1])
    (0.75, 1.0)
    """
    graph = _tree(network)
    require_mapping(evidence)
    known = frozenset(graph.network.variables)
    bound = bind_discrete(known, evidence)
    happens = _event(event, known, bound)
    limits.require_runs(ARRAYS * sum(graph.sizes), bound.runs, "products of all clusters")
    of_tree(graph, bound, limits.Room.of(None, graph))  # impossible evidence is told here
    given = derivatives(graph, bound)
    states = {**bound.states, **happens}
    with_event = derivatives(graph, BoundStates(bound.lead, states, bound.weights))
    # Of a tree without the event both are the same number.
    shares = {k: with_event.log_evidence[k] - own for k, own in given.log_evidence.items()}
    own = {k: share for k, share in shares.items() if share.any()}
    found = dict[Discrete, Sensitivity]()
    for place, factor in enumerate(given.factors):
        assert isinstance(factor, TableCPD)
        elsewhere = sum((s for k, s in own.items() if k != given.trees[place]), np.zeros(1))
        found[factor.child] = _of_table(factor, place, given, with_event, elsewhere, bound.lead)
    probability = exp(sum(own.values(), np.zeros(bound.runs)))
    return Sensitivities(
        MappingProxyType({v: v.states[state] for v, state in happens.items()}),
        frozen(np.asarray(probability).reshape(bound.lead)),
        MappingProxyType({v: found[v] for v in discrete(graph.network.variables)}),
    )


def _of_table(
    cpd: TableCPD,
    place: int,
    given: Derivatives,
    with_event: Derivatives,
    elsewhere: Array,
    lead: tuple[int, ...],
) -> Sensitivity:
    """The sensitivity to a table, the factor at a place of both kinds of derivatives.

    `elsewhere`, (runs or 1,), is ln P(event | evidence) in all trees but the factor's.
    """
    size, runs = cpd.child.size, given.logs[place].shape[-1]
    table = cpd.table.reshape(-1, size)
    with np.errstate(divide="ignore"):
        logs = np.log(table)[..., None]
    sums = table.sum(axis=1, keepdims=True)[..., None]
    event, evidence = (
        _ends(own.logs[place].reshape(-1, size, runs) + more, logs, np.log(sums))
        for own, more in ((with_event, elsewhere), (given, 0.0))
    )
    # Of all four numbers a common factor is taken out, by which none is above one.
    top = np.maximum(*evidence)
    j0, j1, e0, e1 = (exp(own - top) for own in (*event, *evidence))
    # p(evidence) itself, for 1 − θ may have lost what others of the column add to.
    total = exp(given.log_evidence[given.trees[place]] - top)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        slope = (j1 * (e0 / total) - j0 * (e1 / total)) / total / sums
    if not np.isfinite(slope).all():
        raise NumericalError(
            f"a derivative by an entry of {cpd!r} is too large for a number: with the entry as it "
            "is, the evidence is next to impossible beside what another value makes of it",
            cpd=cpd,
        )

    def shaped(values: Array) -> Array:
        """Values (columns, states, runs or 1) as (*runs or (), sizes of the table...)."""
        by_run = np.moveaxis(np.broadcast_to(values, (*table.shape, runs)), -1, 0)
        return frozen(by_run.reshape(*lead, *cpd.table.shape))

    return Sensitivity(
        cpd,
        shaped(slope),
        (shaped(j0), shaped(e0)),
        (shaped(j1), shaped(e1)),
        frozen(np.broadcast_to(sums[..., 0], table.shape).reshape(cpd.table.shape)),
    )


def _ends(derivative: Array, logs: Array, log_sums: Array) -> tuple[Array, Array]:
    """The logarithms of a probability where each entry is zero, and where it is its column's sum.

    derivative: (columns, states, runs): ln ∂p/∂θ of each entry θ.
    logs: (columns, states, 1): ln θ.
    log_sums: (columns, 1, 1): of the columns' sums.
    """
    columns = log_sum(logs + derivative, 1)[:, None]
    rest = _others(columns, 0)
    if logs.shape[1] == 1:  # a single state, whose entry cannot change
        ends = np.logaddexp(log_sums + derivative, rest)
        return ends, ends
    # The others in their proportions; in equal parts where they are all zero.
    weights = _others(logs, 1)
    proportional = _others(logs + derivative, 1) - np.where(weights == -np.inf, 0.0, weights)
    equal = _others(derivative, 1) - np.log(logs.shape[1] - 1)
    mean = np.where(weights == -np.inf, equal, proportional)
    return np.logaddexp(log_sums + mean, rest), np.logaddexp(log_sums + derivative, rest)


def _others(logs: Array, axis: int) -> Array:
    """Of each entry along an axis, ln of the sum of all others, without any difference."""
    moved = np.moveaxis(logs, axis, 0)
    none = np.full((1, *moved.shape[1:]), -np.inf)
    before = np.concatenate([none, np.logaddexp.accumulate(moved[:-1], 0)])
    after = np.concatenate([none, np.logaddexp.accumulate(moved[:0:-1], 0)])[::-1]
    return np.moveaxis(np.logaddexp(before, after), 0, axis)


def _event(event: Any, known: frozenset[Variable], evidence: BoundStates) -> dict[Discrete, int]:
    """The states of an event, checked, as indices."""
    require_mapping(event, "the event")
    bound = bind_discrete(known, event)
    observed = next((v for v in bound.states if v in evidence.states), None)
    if observed is not None:
        raise EvidenceError(
            f"{observed!r} is observed: the event is of variables without evidence",
            variable=observed,
        )
    states = {v: state for v, state in bound.states.items() if isinstance(state, int)}
    if bound.lead or bound.weights or not event or len(states) < len(event):
        raise EvidenceError(
            "the event is one state, by name or index, of each of one or more variables, like "
            f"{{rain: 'yes'}}; found {dict(event)!r}"
        )
    return states


def _tree(network: Any) -> ClusterGraph:
    """The graph without loops of a network of tables, which the user gave, or its graph."""
    if isinstance(network, DynamicBayesianNetwork | DynamicGraph):
        raise GraphError(
            "sensitivity is for networks without time, and this one is dynamic; of tables, take "
            "model.unroll(steps)"
        )
    graph = network if isinstance(network, ClusterGraph) else None
    asked = graph.network if graph is not None else network
    if not isinstance(asked, BayesianNetwork):
        if isinstance(asked, MarkovNetwork):
            raise GraphError(
                f"sensitivity is of probabilities, the entries of CPDs, and {titled(asked)} has "
                "factors without direction"
            )
        raise ModelError(
            f"sensitivity takes a network of tables or its compiled graph, not {titled(network)}"
        )
    if not asked.discrete:
        raise GraphError(
            f"sensitivity is for networks of tables, and this one is {asked._kind}; of continuous "
            "variables, compare posteriors of networks with other numbers"
        )
    tree = graph if graph is not None and graph.is_tree else compile(asked)
    require_whole_tables(
        tree, "there is no sensitivity", "its table's entries stand in none of the tree's factors"
    )
    return tree
