"""Running a schedule of messages on a cluster graph."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.compile import SliceGraph, SliceLayout, compile
from pgm.errors import EvidenceError, GraphError, ModelError
from pgm.evidence import BoundEvidence, Evidence, bind
from pgm.evidence.arrays import as_rows, require_finite
from pgm.factors.scope import positions
from pgm.inference import forward
from pgm.inference.backward import Beliefs
from pgm.inference.plan import ChainPlan
from pgm.inference.posterior import Posterior
from pgm.inference.schedule import Filtering, Schedule, Smoothing, Status
from pgm.inference.smoother import smooth as run_smoothing
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable

Start = Mapping[Variable, npt.ArrayLike]


def infer(
    graph: SliceGraph,
    evidence: Evidence,
    *,
    schedule: Schedule | None = None,
    lineariser: Lineariser = TAYLOR,
    start: Start | None = None,
) -> Posterior:
    """Send the messages of a schedule on a cluster graph.

    Parameters
    ----------
    graph : SliceGraph
        From `compile`.
    evidence : mapping of Variable
        Arrays (..., T, d), `constant` or `sightings`, by variable; leading axes are runs.
    schedule : Filtering or Smoothing, optional
        `Smoothing()` without.
    lineariser : Lineariser, optional
        For every CPD that has none of its own; `Taylor()` if not given.
    start : mapping of Variable to array_like, optional
        Means (..., T+1, d) of the states, (..., T, d) of hidden controls, at which everything is
        linearised first, in place of the filter's beliefs.

    Returns
    -------
    Posterior

    Raises
    ------
    EvidenceError
        If the evidence does not fit the model or the graph.
    ModelError
        If a function returns a wrong shape.
    LinearisationError, NumericalError
        If a number that is needed does not exist, with the step.
    """
    if not isinstance(graph, SliceGraph):
        raise GraphError(f"infer takes a compiled graph (pgm.compile(model, ...)), not {graph!r}")
    bound = _bind(graph.model, evidence, graph.steps)
    return _run(graph, bound, schedule, lineariser, start)


def filter(
    model: DynamicBayesianNetwork,
    evidence: Evidence,
    *,
    lineariser: Lineariser = TAYLOR,
    steps: int | None = None,
) -> Posterior:
    """Compile a network and filter: `infer` with `Filtering()`.

    Parameters
    ----------
    model : DynamicBayesianNetwork
    evidence : mapping of Variable
        As for `infer`.
    lineariser : Lineariser, optional
        `Taylor()` if not given.
    steps : int, optional
        T, where no plain array of the evidence tells.
    """
    bound = _bind(model, evidence, steps)
    return _run(compile(model, bound.steps), bound, Filtering(), lineariser, None)


def smooth(
    model: DynamicBayesianNetwork,
    evidence: Evidence,
    *,
    lineariser: Lineariser = TAYLOR,
    steps: int | None = None,
    start: Start | None = None,
    iterations: int = 1,
    tolerance: float = 1e-9,
) -> Posterior:
    """Compile a network and smooth: `infer` with `Smoothing(iterations, tolerance)`.

    Parameters
    ----------
    model : DynamicBayesianNetwork
    evidence : mapping of Variable
        As for `infer`.
    lineariser : Lineariser, optional
        `Taylor()` if not given.
    steps : int, optional
        T, where no plain array of the evidence tells.
    start : mapping of Variable to array_like, optional
        As for `infer`.
    iterations, tolerance
        Of `Smoothing`.
    """
    schedule = Smoothing(iterations, tolerance)
    bound = _bind(model, evidence, steps)
    return _run(compile(model, bound.steps), bound, schedule, lineariser, start)


def _bind(model: Any, evidence: Evidence, steps: int | None) -> BoundEvidence:
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a dynamic network was due, not {model!r}")
    if not isinstance(evidence, Mapping):
        raise EvidenceError(f"evidence maps variables to values; found {type(evidence).__name__}")
    return bind(model.transition, model.observation, evidence, steps, model.lead)


def _run(
    graph: SliceGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
) -> Posterior:
    schedule = Smoothing() if schedule is None else schedule
    if not isinstance(schedule, (Filtering, Smoothing)):
        raise ModelError(f"{schedule!r} is no schedule; give pgm.Filtering() or pgm.Smoothing()")
    if not callable(lineariser) or isinstance(lineariser, type):
        raise ModelError(f"{lineariser!r} is no lineariser; give one like pgm.Taylor()")
    if start is not None and isinstance(schedule, Filtering):
        raise EvidenceError("a start is for smoothing; a filter linearises at its own beliefs")
    given = None if start is None else _start(graph.layout, bound, start)
    plan = ChainPlan.make(graph, bound, lineariser)
    if isinstance(schedule, Filtering):
        ahead = forward.sweep(plan, linearise=True)
        status = Status(1, np.empty((0, *plan.lead)), np.full(plan.lead, plan.exact))
        return Posterior(graph, status, plan, ahead, None, None)
    result = run_smoothing(plan, schedule, given)
    return Posterior(graph, result.status, plan, result.forward, result.beliefs, result.reverse)


def _start(layout: SliceLayout, bound: BoundEvidence, start: Start) -> Beliefs:
    if not isinstance(start, Mapping):
        raise EvidenceError(f"start maps variables to means; found {type(start).__name__}")
    for variable in start:
        if variable not in layout.slice:
            raise EvidenceError(
                f"start has {variable!r}, which is not hidden; it takes {list(layout.slice)}",
                variable=variable,
            )
    mean = np.zeros((bound.steps + 1, bound.runs, layout.slice_size))
    for variable in layout.slice:
        if variable not in start:
            raise EvidenceError(
                f"start lacks {variable!r}; it takes means of all of {list(layout.slice)}",
                variable=variable,
            )
        first = 0 if variable in layout.states else 1
        rows = require_finite(variable, as_rows(variable, start[variable], "T+1"))
        if rows.shape[-2] != bound.steps + 1 - first:
            raise EvidenceError(
                f"start for {variable!r} has {rows.shape[-2]} steps; it stands at steps "
                f"{first}..{bound.steps}",
                variable=variable,
            )
        try:
            wide = np.broadcast_to(rows, (*bound.lead, *rows.shape[-2:]))
        except ValueError:
            raise EvidenceError(
                f"start for {variable!r} has the axes of runs {rows.shape[:-2]}, which do not "
                f"broadcast to those of the evidence, {bound.lead}",
                variable=variable,
            ) from None
        wide = wide.reshape(bound.runs, *rows.shape[-2:]).swapaxes(0, 1)
        mean[first:][..., positions(layout.slice, [variable])] = wide
    return Beliefs(mean, np.zeros((*mean.shape, mean.shape[-1])))
