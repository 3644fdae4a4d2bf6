"""Inference in a mixed network: parts in all configurations, then the tables."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.discrete.run import run as run_tables
from pgm.beliefs.mixed.configurations import fits, possible
from pgm.beliefs.mixed.outcome import MixedOutcome
from pgm.beliefs.mixed.parts import Part, fitting
from pgm.beliefs.mixed.tabled import Tabled
from pgm.beliefs.mixed.weighing import Asked, Weighed, weighed
from pgm.clustergraph import ClusterGraph
from pgm.compile.methods import JunctionTree
from pgm.cpds import CPD, ConditionalGaussian, SwitchingCPD
from pgm.cpds.caused import (
    FAR,
    caused,
    components,
    has_mixtures,
    in_scales,
    is_farthest,
    is_mixture,
    too_far,
)
from pgm.errors import EvidenceError, NumericalError
from pgm.evidence import Evidence
from pgm.evidence.rows import as_rows, no_evidence_for, require_finite
from pgm.evidence.static import BoundValues, bind_discrete, bind_values
from pgm.factors.arrays import common_runs, flat
from pgm.factors.axes import sizes
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Mask
from pgm.networks import BayesianNetwork
from pgm.schedules.argument_checks import require_gaussian
from pgm.schedules.options import Call
from pgm.schedules.starting_points import Start, require_hidden
from pgm.variables import Discrete, Variable


class _Split(NamedTuple):
    """The CPDs of a mixed network by kind, and the graph of its tables alone."""

    tables: Sequence[CPD]
    continuous: Sequence[CPD]
    graph: ClusterGraph
    needed: Scope


def run(graph: ClusterGraph, evidence: Evidence, call: Call) -> MixedOutcome:
    """The beliefs of a network of discrete and continuous variables, given its evidence."""
    graph = graph.derived(_with_causes)
    split: _Split = graph.derived(_split)
    variables = frozenset(graph.network.variables)
    for variable in evidence:
        if variable not in variables:
            raise no_evidence_for(variable, variables)
    discrete: dict[Variable, Any] = {v: e for v, e in evidence.items() if isinstance(v, Discrete)}
    others: dict[Variable, Any] = {
        v: value for v, value in evidence.items() if not isinstance(v, Discrete)
    }
    states = bind_discrete(frozenset(v for v in variables if isinstance(v, Discrete)), discrete)
    bound = bind_values(split.continuous, others, graph.network.lead, split.needed)
    owners = ("continuous variables", bound.lead), ("discrete variables", states.lead)
    lead = common_runs([(f"the evidence of {what}", shape) for what, shape in owners])
    if bound.lead != lead:
        bound = bind_values(split.continuous, others, lead, split.needed)
    fixed: dict[Variable, int] = {
        v: state for v, state in states.states.items() if isinstance(state, int)
    }
    tables = run_tables(split.graph, fixed, None)
    # What was measured nowhere is as barren as what was not observed.
    values = _with_gaps(bound)
    told = {v for v, value in values.items() if not np.isnan(value).all()}
    parts = [
        (part, possible(part.boundary, tables, fixed))
        for part in fitting(split.continuous, values, told, lambda part: fits(part, fixed))
    ]
    observed = frozenset(v for v, state in states.states.items() if np.all(np.asarray(state) >= 0))
    robust = _weighing([part for part, _ in parts], observed)
    if robust:
        return run(_in_scales(graph, robust), evidence, call)
    hidden = [v for part, _ in parts for v in part.hidden]
    start = None if call.start is None else _start(call.start, hidden, lead)
    asked = Asked(values, start, lead, call.lineariser, call.schedule)
    found = [weighed(part, configurations, asked) for part, configurations in parts]
    tabled = Tabled.of(split.tables, discrete, parts, lead)
    logs = [each.log for each in found]
    allowed = _allowed(tabled, found)
    beliefs, total = tabled.solved(logs, allowed)
    known = frozenset(asked.values)
    outcome = MixedOutcome(graph, beliefs, found, tabled.choices, known, lead, total)
    _require_near(outcome, found)
    outcome.status._warn()
    return outcome


def _with_causes(graph: ClusterGraph) -> ClusterGraph:
    """The graph of a network whose mixtures hidden discrete variables choose, if it has any."""
    network = graph.network
    if not has_mixtures(network.cpds):
        return graph
    names = {v.name for v in network.variables}
    cpds = list[CPD]()
    for cpd in network.cpds:
        cpds += caused(cpd, names) if is_mixture(cpd) else [cpd]
    return JunctionTree()(BayesianNetwork(cpds))


def _weighing(parts: Sequence[Part], observed: Collection[Variable]) -> set[CPD]:
    """The CPDs of robust noise by which states of unobserved variables are weighed.

    Where all that is continuous is observed, their densities weigh the states as they are.
    """
    return {
        cpd
        for part in parts
        if part.hidden and not set(part.boundary) <= set(observed)
        for cpd in part.cpds
        for case in components(cpd)
        if isinstance(case, ConditionalGaussian) and case.noise is not None
    }


def _require_near(outcome: MixedOutcome, parts: Sequence[Weighed]) -> None:
    """Refuse readings farther off than their robust noise is known: of its largest scale."""
    for k, each in enumerate(parts):
        for cpd in each.part.cpds:
            if not isinstance(cpd, SwitchingCPD):
                continue
            far = [n for n, case in enumerate(cpd.cases.values()) if is_farthest(case)]
            if not far:
                continue
            columns = [each.part.boundary.index(v) for v in cpd.switches]
            states = each.configurations[:, columns]
            number = np.ravel_multi_index(tuple(states.T), sizes(cpd.switches))
            share = outcome._weights([k])[:, np.isin(number, far)].sum(axis=1)
            if (share > FAR).any():
                raise NumericalError(too_far(cpd, ""), variable=cpd.child, cpd=cpd)


def _in_scales(graph: ClusterGraph, robust: set[CPD]) -> ClusterGraph:
    """The graph of a network in which some CPDs' robust noise is a mixture of several scales."""
    why = "by whose densities states of discrete variables are weighed"
    cpds = [in_scales(cpd, why) if cpd in robust else cpd for cpd in graph.network.cpds]
    return JunctionTree()(BayesianNetwork(cpds))


def _split(graph: ClusterGraph) -> _Split:
    cpds = graph.network.cpds
    tables = [cpd for cpd in cpds if cpd.discrete]
    continuous = [cpd for cpd in cpds if not cpd.discrete]
    for cpd in continuous:
        own = cpd.cases.values() if isinstance(cpd, SwitchingCPD) else (cpd,)
        require_gaussian(own, "the Gaussian beliefs of a mixed network")
    noise = (v for cpd in continuous for v in cpd.noise_given)
    needed = tuple(dict.fromkeys([*graph.network.inputs, *noise]))
    return _Split(tables, continuous, JunctionTree()(BayesianNetwork(tables)), needed)


def _with_gaps(bound: BoundValues) -> dict[Variable, Array]:
    """The values of continuous variables, (runs or 1, d), NaN where a component is missing."""
    return {
        v: np.where(bound.taken[v], value, np.nan) if v in bound.taken else value
        for v, value in bound.values.items()
    }


def _start(
    start: Start, hidden: Sequence[Variable], lead: tuple[int, ...]
) -> dict[Variable, Array]:
    """The means to begin at, (runs or 1, d)."""
    require_hidden(start, dict.fromkeys(hidden))
    found = {}
    for variable, value in start.items():
        row = require_finite(variable, as_rows(variable, value, None)[..., None, :])[..., 0, :]
        owners = (f"the start of {variable!r}", row.shape[:-1]), ("the evidence", lead)
        if common_runs(owners) != lead:
            raise EvidenceError(
                f"start for {variable!r} has the axes of runs {row.shape[:-1]}, which do not "
                f"broadcast to those of the evidence, {lead}",
                variable=variable,
            )
        found[variable] = flat(row, lead, 1)
    return found


def _allowed(tabled: Tabled, parts: Sequence[Weighed]) -> list[Mask]:
    """By part the configurations that count, (configurations, runs).

    They are those that the evidence does not contradict, and, of these that all parts and tables
    leave possible, those that make the most of the evidence certain.
    """
    possible = [np.isfinite(each.log) for each in parts]
    if not any((each.certain != each.certain[:1]).any() for each in parts):
        return possible
    # A point mass outweighs a density, however little weight soft evidence gives its states.
    tabled = tabled.levelled()
    beliefs, _ = tabled.solved([np.where(mask, 0.0, -np.inf) for mask in possible], possible)
    found = []
    for choice, each, mask in zip(tabled.choices, parts, possible, strict=True):
        if choice is not None:
            share = beliefs[choice].probabilities.reshape(-1, choice.size).T
            certain = np.where(mask & (share > 0.0), each.certain, -1)
            mask = mask & (certain == certain.max(axis=0))
        found.append(mask)
    try:
        tabled.solved([np.where(mask, 0.0, -np.inf) for mask in found], found)
    except EvidenceError as error:
        raise NumericalError(
            "parts of the network make evidence certain in configurations that exclude one "
            "another; which of them outweighs the other is not known here: give their CPDs some "
            "noise"
        ) from error
    return found
