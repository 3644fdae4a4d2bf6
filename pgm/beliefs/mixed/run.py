"""Inference in a mixed network: parts in all configurations, then the tables."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from pgm.beliefs.discrete.run import run as run_tables
from pgm.beliefs.mixed.configurations import fits, possible
from pgm.beliefs.mixed.outcome import MixedOutcome
from pgm.beliefs.mixed.parts import Part, fitting
from pgm.beliefs.mixed.split import Split, split_of
from pgm.beliefs.mixed.tabled import Tabled
from pgm.beliefs.mixed.weighing import Asked, Weighed, weighed
from pgm.clustergraph import ClusterGraph
from pgm.cpds import CPD, ConditionalGaussian, SwitchingCPD
from pgm.cpds.base import naming_factors
from pgm.cpds.caused import FAR, components, is_farthest, too_far
from pgm.errors import EvidenceError, NumericalError
from pgm.evidence import Evidence
from pgm.evidence.rows import as_rows, no_evidence_for, require_finite
from pgm.evidence.static import BoundStates, BoundValues, bind_discrete, bind_values
from pgm.evidence.values import Soft, soft
from pgm.factors.arrays import common_runs, flat
from pgm.factors.axes import sizes
from pgm.kernels.arrays import Array, Mask
from pgm.schedules.impossible import ImpossibleEvidence
from pgm.schedules.options import Call
from pgm.schedules.starting_points import Start, require_hidden
from pgm.variables import Discrete, Variable


def run(graph: ClusterGraph, evidence: Evidence, call: Call) -> MixedOutcome:
    """The beliefs of a network of discrete and continuous variables, given its evidence."""
    with naming_factors():
        return _inferred(graph, graph.derived(split_of), evidence, call)


def _inferred(graph: ClusterGraph, split: Split, evidence: Evidence, call: Call) -> MixedOutcome:
    variables = frozenset(split.variables)
    for variable in evidence:
        if variable not in variables:
            raise no_evidence_for(variable, variables)
    discrete: dict[Variable, Any] = {v: e for v, e in evidence.items() if isinstance(v, Discrete)}
    others: dict[Variable, Any] = {
        v: value for v, value in evidence.items() if not isinstance(v, Discrete)
    }
    others |= split.values
    states = bind_discrete(frozenset(v for v in variables if isinstance(v, Discrete)), discrete)
    bound = bind_values(split.continuous, others, graph.network.lead, split.needed)
    owners = ("continuous variables", bound.lead), ("discrete variables", states.lead)
    lead = common_runs([(f"the evidence of {what}", shape) for what, shape in owners])
    if bound.lead != lead:
        bound = bind_values(split.continuous, others, lead, split.needed)
    fixed: dict[Variable, int] = {
        v: state for v, state in states.states.items() if isinstance(state, int)
    }
    try:
        tables = run_tables(split.graph, {**_in_some_run(states), **fixed}, None)
    except ImpossibleEvidence:  # in all runs: the first is told below
        tables = run_tables(split.graph, fixed, None)
    # What was measured nowhere is as barren as what was not observed.
    values = _with_gaps(bound)
    told = {v for v, value in values.items() if not np.isnan(value).all()}
    continuous, level = split.inside(values.keys() - bound.taken.keys())
    parts = [
        (part, possible(part.boundary, tables, fixed))
        for part in fitting(continuous, values, told, lambda part: fits(part, fixed))
    ]
    observed = frozenset(v for v, state in states.states.items() if np.all(np.asarray(state) >= 0))
    robust = _weighing([part for part, _ in parts], observed)
    if robust:
        return _inferred(graph, split.in_scales(robust), evidence, call)
    hidden = [v for part, _ in parts for v in part.hidden]
    start = None if call.start is None else _start(call.start, hidden, lead)
    asked = Asked(values, start, lead, call.lineariser, call.schedule)
    found = [weighed(part, configurations, asked) for part, configurations in parts]
    tabled = Tabled.of(split.tables, discrete, parts, lead)
    logs = [each.log for each in found]
    allowed = _allowed(tabled, found)
    beliefs, total = tabled.solved(logs, allowed)
    outcome = MixedOutcome(
        graph,
        split.variables,
        beliefs,
        found,
        tabled.choices,
        frozenset(asked.values),
        lead,
        total + level,
        split.lost,
    )
    _require_near(outcome, found)
    if call.tells:
        outcome.status._warn()
    return outcome


def _in_some_run(states: BoundStates) -> dict[Variable, Soft]:
    """Of variables whose evidence has axes of runs the states that it leaves possible in some."""
    found = {v: (weights > -np.inf).any(axis=0) for v, weights in states.weights.items()}
    for variable, state in states.states.items():
        rows = np.asarray(state)
        if rows.ndim and (rows >= 0).all():
            found[variable] = np.isin(np.arange(variable.size), rows)
    return {v: soft(mask.astype(np.float64)) for v, mask in found.items() if not mask.all()}


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
