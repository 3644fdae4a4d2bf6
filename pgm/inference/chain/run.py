"""Running a schedule on a chain of slices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pgm.compile import BalancedGraph, DynamicGraph, SliceLayout
from pgm.errors import EvidenceError, GraphError, ModelError, NumericalError
from pgm.evidence import BoundEvidence, Evidence, bind
from pgm.evidence.arrays import as_rows, require_finite
from pgm.factors.scope import positions
from pgm.inference.chain import careful, certificate, fixed_lag, forward, parallel, smoother
from pgm.inference.chain.balanced import BalancedPosterior
from pgm.inference.chain.fixed_lag import Lagged
from pgm.inference.chain.forward import Filtered, Forward
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.chain.readings import Room
from pgm.inference.kind import FILTERED, SMOOTHED, Kind
from pgm.inference.schedule import Calibration, Filtering, FixedLag, Loopy, Schedule, Smoothing
from pgm.inference.start import Start, over_runs, require_hidden
from pgm.inference.status import Status, digits
from pgm.kernels.arrays import Array, quiet
from pgm.linearisers import Lineariser
from pgm.networks import DynamicBayesianNetwork


def bind_chain(model: Any, evidence: Evidence, steps: int | None) -> BoundEvidence:
    """Check the evidence of a dynamic network."""
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a dynamic network was due, not {model!r}")
    if not isinstance(evidence, Mapping):
        raise EvidenceError(f"evidence maps variables to values; found {type(evidence).__name__}")
    return bind(model.transition, model.observation, evidence, steps, model.lead)


@quiet()
def run(
    graph: DynamicGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
    room: Room | None = None,
) -> ChainPosterior:
    """Send the messages of a filter or smoother; `room` has arrays for the moments of a filter.

    Numbers too large for float64 are refused where they end up, so that NumPy need not warn.
    """
    schedule = Smoothing() if schedule is None else schedule
    if isinstance(schedule, Loopy):
        raise ModelError(
            f"a chain of slices takes pgm.Filtering(), pgm.FixedLag(...) or pgm.Smoothing(), not "
            f"{schedule!r}"
        )
    if start is not None and isinstance(schedule, Filtering | FixedLag):
        raise EvidenceError(
            f"a start is for smoothing all at once, not {schedule!r}, which linearises at beliefs"
        )
    if isinstance(schedule, FixedLag):
        if isinstance(graph, BalancedGraph):
            raise GraphError(
                f"{schedule!r} goes along a chain of slices, step after step, which {graph!r} is "
                "not: compile without pgm.Balanced()"
            )
        if not schedule.lag:
            schedule = schedule.filtering
    given = None if start is None else _start(graph.layout, bound, start)
    plan = ChainPlan.make(graph, bound, lineariser)
    if isinstance(schedule, FixedLag) and fixed_lag.slides(plan, schedule):
        return _slid(graph, plan, schedule)
    if not certificate.is_flat(plan):
        try:
            found = _solve(graph, plan, schedule, given, room)
            _refuse_infinite(found)
            smoothed = None if found._smoothed is None else found._smoothed.cov
            if certificate.suffices(found._planned, found._swept, smoothed):
                return found
        except NumericalError:
            pass  # with twice the digits there may be an answer; if not, the same is refused
        plan = ChainPlan.make(graph, bound, lineariser, probe=False)
    return _carefully(graph, plan, schedule, given)


def _refuse_infinite(posterior: ChainPosterior) -> None:
    """Refuse what float64 cannot hold; only the variances of a flat prior are infinite.

    A variance that is negative, by more than rounding explains, is no better.
    """
    swept, smoothed = posterior._swept, posterior._smoothed
    if isinstance(swept, Filtered):  # whose numbers have been looked at
        return
    parts = [swept.log_density, swept.mean, swept.cov]
    parts += [] if smoothed is None else [smoothed.mean, smoothed.cov]
    flat = certificate.is_flat(posterior._planned)
    for part in parts:
        lost = np.zeros(0, dtype=bool)
        if not np.isfinite(part.sum()):
            lost = np.isnan(part) if flat and part.ndim == 4 else ~np.isfinite(part)
        elif part.ndim == 4 and (posterior._careful or posterior._windows) is not None:
            lost = np.diagonal(part, axis1=-2, axis2=-1) < 0.0
        if lost.any():
            step, run = (int(axis[0]) for axis in np.nonzero(lost)[:2])
            raise NumericalError(
                f"the belief at step {step}, run {run}, or the density of its readings is not "
                "finite, or a variance is negative: numbers of the model or the evidence are "
                "larger, or further apart, than float64 can hold; give them in other units",
                step=step,
                run=run,
            )


def _solve(
    graph: DynamicGraph,
    plan: ChainPlan,
    schedule: Filtering | FixedLag | Calibration,
    start: Array | None,
    room: Room | None,
) -> ChainPosterior:
    balanced = isinstance(graph, BalancedGraph)
    make = _posterior(graph)
    if isinstance(schedule, FixedLag):
        return _lagged(graph, plan, schedule, *fixed_lag.smooth(plan, schedule))
    if isinstance(schedule, Filtering):
        ahead: Forward | Filtered
        if balanced:
            ahead, status = _scan(graph, plan)
        elif plan.runs >= forward.MANY and not any(sensor.exact for sensor in plan.sensors):
            # Of many runs only the beliefs, as long as nothing else is asked for.
            ahead, status = forward.filtered(plan, schedule, room)
        else:
            ahead, status = forward.run(plan, schedule)
        return make(graph, status, FILTERED, plan, ahead, None, None)
    run_smoothing = smoother.scan if balanced else smoother.smooth
    result, status = run_smoothing(plan, _smoothing(schedule), start)
    ahead = parallel.whole(result.forward)
    return make(graph, status, SMOOTHED, plan, ahead, result.beliefs, result.reverse)


def _slid(graph: DynamicGraph, plan: ChainPlan, schedule: FixedLag) -> ChainPosterior:
    """A window that slides sees for itself to the digits that it has."""
    result, status = fixed_lag.slid(plan, schedule)
    if result.error is not None:
        status = status.with_digits(digits(result.error, plan.lead))
    found = _lagged(graph, plan, schedule, result, status)
    _refuse_infinite(found)
    return found


def _lagged(
    graph: DynamicGraph, plan: ChainPlan, schedule: FixedLag, found: Lagged, status: Status
) -> ChainPosterior:
    kind, parts = Kind(schedule.lag), (found.beliefs, found.reverse, found.careful, found.windows)
    return ChainPosterior(graph, status, kind, plan, found.forward, *parts)


def _carefully(
    graph: DynamicGraph,
    plan: ChainPlan,
    schedule: Filtering | FixedLag | Calibration,
    start: Array | None,
) -> ChainPosterior:
    """`_solve` in twice the digits, one step after another."""
    make = _posterior(graph)
    error: Array | None
    if isinstance(schedule, Filtering):
        if isinstance(graph, BalancedGraph):
            _refuse_nonlinear(graph, plan)
        swept, status = careful.sweep(plan, schedule)
        found = make(graph, status, FILTERED, plan, swept.forward, None, None, swept)
        error = swept.error
    elif isinstance(schedule, FixedLag):
        lagged, status = fixed_lag.carefully(plan, schedule)
        found, error = _lagged(graph, plan, schedule, lagged, status), lagged.error
    else:
        result, status = smoother.carefully(
            plan, _smoothing(schedule), start, reckoned=isinstance(graph, BalancedGraph)
        )
        ahead = result.careful
        found = make(graph, status, SMOOTHED, plan, ahead.forward, result.beliefs, None, ahead)
        error = result.error
    _refuse_infinite(found)
    assert error is not None
    return replace(found, status=status.with_digits(digits(error, plan.lead)))


def _posterior(graph: DynamicGraph) -> type[ChainPosterior]:
    return BalancedPosterior if isinstance(graph, BalancedGraph) else ChainPosterior


def _smoothing(schedule: Calibration) -> Smoothing:
    if isinstance(schedule, Smoothing):
        return schedule
    return Smoothing(schedule.iterations, schedule.tolerance)


def _scan(graph: DynamicGraph, plan: ChainPlan) -> tuple[Forward, Status]:
    """Filter on a balanced tree."""
    _refuse_nonlinear(graph, plan)
    return parallel.whole(parallel.run(plan)), Status.of(
        [], np.ones(plan.runs, dtype=bool), plan.lead
    )


def _refuse_nonlinear(graph: DynamicGraph, plan: ChainPlan) -> None:
    for family in plan.families:
        if not family.exact:
            raise GraphError(
                f"{family.cpd!r} is nonlinear, and {graph!r} solves for all steps at once, where a "
                "filter linearises at the belief before: compile without pgm.Balanced(), or smooth"
            )


def _start(layout: SliceLayout, bound: BoundEvidence, start: Start) -> Array:
    require_hidden(start, layout.slice)
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
        wide = over_runs(variable, rows, bound.lead, 2).swapaxes(0, 1)
        mean[first:][..., positions(layout.slice, [variable])] = wide
    return mean
