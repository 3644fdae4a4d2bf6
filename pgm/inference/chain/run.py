"""Running a schedule on a chain of slices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pgm.compile import BalancedGraph, DynamicGraph, SliceLayout
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError, NumericalError
from pgm.evidence import BoundEvidence, Evidence, bind
from pgm.evidence.rows import as_rows, require_finite
from pgm.factors.scope import positions
from pgm.inference.chain import certificate, gate
from pgm.inference.chain.forward import Filtered
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.chain.readings import Room
from pgm.inference.chain.solvers import FilterSolver, LagSolver, SmootherSolver, Solver
from pgm.inference.options import Start, over_runs, require_hidden
from pgm.inference.schedule import Calibration, Filtering, FixedLag, Schedule, Smoothing
from pgm.kernels.arrays import Array, quiet
from pgm.linearisers import Lineariser
from pgm.networks import DynamicBayesianNetwork


def bind_chain(
    model: Any, evidence: Evidence, steps: int | None, *, identities: bool = False
) -> BoundEvidence:
    """Check the evidence of a dynamic network; sightings may leave open what was seen, or not."""
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a dynamic network was due, not {titled(model)}")
    if not isinstance(evidence, Mapping):
        raise EvidenceError(f"evidence maps variables to values; found {type(evidence).__name__}")
    cpds = model.transition, model.observation
    return bind(*cpds, evidence, steps, model.lead, identities=identities)


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

    Too large numbers are refused where they end up: NumPy need not warn.
    """
    schedule = Smoothing() if schedule is None else schedule
    if isinstance(schedule, FixedLag) and not schedule.lag and not isinstance(graph, BalancedGraph):
        schedule = schedule.filtering
    solver = solver_of(graph, schedule)
    if start is not None and not solver.starts:
        raise EvidenceError(
            f"a start is for smoothing all at once, not {schedule!r}, which linearises at beliefs"
        )
    given = None if start is None else _start(graph.layout, bound, start)
    plan = ChainPlan.make(graph, bound, lineariser)
    gates = getattr(schedule, "gate", None)  # a plain calibration has none
    gate.prepare(plan, gates)
    if not certificate.is_flat(plan):
        try:
            found = solver.solve(plan, given, room)
            _refuse_infinite(found)
            smoothed = None if found._smoothed is None else found._smoothed.cov
            # Windows that slide have each been looked at.
            if found._windows or certificate.suffices(found._planned, found._swept, smoothed):
                return found
        except NumericalError:
            pass  # with twice the digits there may be an answer; if not, the same is refused
        plan = ChainPlan.make(graph, bound, lineariser, probe=False)
        gate.prepare(plan, gates)
    found = solver.carefully(plan, given)
    _refuse_infinite(found)
    return found


def _refuse_infinite(posterior: ChainPosterior) -> None:
    """Refuse moments not finite, but a flat prior's, and variances negative beyond rounding."""
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
                f"the belief at step {step}, run {run}, or the density of its measurements is not "
                "finite, or a variance is negative: numbers of the model or the evidence are "
                "larger, or further apart, than float64 can hold; give them in other units",
                step=step,
                run=run,
            )


# Every schedule for chains, with its solver.
SOLVERS: dict[type[Any], type[Solver]] = {
    Filtering: FilterSolver,
    FixedLag: LagSolver,
    Calibration: SmootherSolver,
    Smoothing: SmootherSolver,
}


def solver_of(graph: DynamicGraph, schedule: Schedule) -> Solver:
    """The solver for a schedule, or for the nearest of its base classes that has one."""
    for each in type(schedule).__mro__:
        if each in SOLVERS:
            return SOLVERS[each](graph, schedule)
    raise ModelError(
        f"a chain of slices takes pgm.Filtering(), pgm.FixedLag(...) or pgm.Smoothing(), not "
        f"{schedule!r}"
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
