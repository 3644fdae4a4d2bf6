"""Running a schedule on a chain of slices, in float64 and in twice the digits.

A *slice* is the vector of all hidden variables of a step, of n components; the steps are 0..T. A
pass along the chain is done in float64 first. Where it fails, or the `certificate` finds that
rounding has left too few digits, it is done again in pairs of float64, which have twice the digits.
A *balanced tree* (`pgm.Balanced`) solves for all steps at once, by scans.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import replace
from typing import Any

import numpy as np

from pgm.beliefs.moments.bound.binding import bind
from pgm.beliefs.moments.digits import careful, certificate, close_points, last_places
from pgm.beliefs.moments.digits.careful_pass import Careful
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes import forward
from pgm.beliefs.moments.passes.backward import Beliefs, Reverse
from pgm.beliefs.moments.passes.forward import Filtered, Forward, Room
from pgm.beliefs.moments.smoothers import fixed_lag, parallel, smoother
from pgm.beliefs.moments.smoothers.fixed_lag import Lagged, Windows
from pgm.beliefs.moments.solvers.balanced import BalancedOutcome
from pgm.beliefs.moments.steps import gate
from pgm.beliefs.moments.steps.plan import Blank, ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile import BalancedGraph, DynamicGraph, SliceLayout
from pgm.display import titled
from pgm.errors import EvidenceError, GraphError, ModelError, NumericalError
from pgm.evidence import BoundEvidence
from pgm.evidence.rows import as_rows, require_finite
from pgm.factors.scope import positions
from pgm.kernels.arrays import Array, quiet
from pgm.linearisers import Lineariser
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED, Kind
from pgm.posteriors.status import CLOSE_POINTS, FAR_APART, LAST_PLACE, Status
from pgm.schedules import sweep
from pgm.schedules.schedule import (
    Calibration,
    Filtering,
    FixedLag,
    OnChains,
    Schedule,
    Smoothing,
    require_known,
)
from pgm.schedules.starting_points import Start, over_runs, require_hidden
from pgm.tracing import Judge, judged

# Linearisations in twice the digits, from where a trial has stopped in float64, at the most.
POLISHING = 5


class Solver(ABC):
    """A solver of chains by one kind of schedule.

    A solver is made for a graph and a schedule, whose options are those that both take.
    """

    def __init__(self, graph: DynamicGraph, schedule: Any) -> None:
        self.graph, self.schedule = graph, schedule
        self.balanced = isinstance(graph, BalancedGraph)

    @abstractmethod
    def solve(self, plan: ChainPlan, start: Array | None, room: Room | None) -> ChainOutcome:
        """The posterior computed in float64.

        `start` (T+1, runs, n) are means of the slices for the first linearisation, None if the user
        gave none. `room` is a pair of arrays (T+1, runs, ...) in which a filter may leave means and
        covariances; with None it makes its own.
        """

    def carefully(self, plan: ChainPlan, start: Array | None) -> ChainOutcome:
        """The posterior computed in pairs of float64; a solver that has none refuses.

        `start` (T+1, runs, n) are means of the slices for the first linearisation, None if the user
        gave none. Sliding windows of a fixed lag choose float64 or pairs each for itself, here as
        in `solve`.
        """
        raise NumericalError(
            f"{self.schedule!r} is computed in float64 alone, which has too few digits for these "
            "beliefs; pgm.Smoothing() has a pass in twice the digits"
        )

    def outcome(
        self,
        plan: ChainPlan,
        kind: Kind,
        swept: Forward | Filtered,
        status: Status,
        smoothed: Beliefs | None = None,
        reverse: Reverse | None = None,
        careful: Careful | None = None,
        windows: Windows | None = None,
        error: Array | None = None,
    ) -> ChainOutcome:
        """The answer to the call, made of these results, its status completed.

        `kind` tells which measurements its beliefs know, and `swept` is the forward pass. After
        smoothing `smoothed` are the beliefs, `reverse` is the reversed chain, if it has been made,
        and `windows` are the results of sliding windows; `careful` is the pass in twice the digits.
        The status gets the digits that rounding leaves, and whether machine code made the sweeps.
        `error` (runs,) is the rounding error of means, in standard deviations, which costs digits;
        None where it is not measured.
        """
        status = status.with_compilation(plan.account.words(plan.runs))
        if error is not None:
            status = status._losing(error, FAR_APART)
        parts = kind, plan, swept, smoothed, reverse, careful, windows
        if isinstance(self.graph, BalancedGraph):
            return BalancedOutcome(self.graph, status, *parts)
        return ChainOutcome(self.graph, status, *parts)


class FilterSolver(Solver):
    """The solver for filtering: forward messages only."""

    def solve(self, plan: ChainPlan, start: Array | None, room: Room | None) -> ChainOutcome:
        """The filtered posterior: step by step, or by a parallel scan on a balanced tree."""
        if self.balanced:
            self._refuse_nonlinear(plan)
            status = Status.of([], np.ones(plan.runs, dtype=bool), plan.lead)
            return self.outcome(plan, FILTERED, parallel.whole(parallel.run(plan)), status)
        ahead: forward.WholePass | forward.BarePass
        if plan.runs >= forward.MANY and not any(map(_needs_all, plan.sensors)):
            # Of many runs only the beliefs, as long as nothing else is asked for.
            ahead = forward.BarePass(plan, self.schedule, room)
        else:
            ahead = forward.WholePass(plan, self.schedule)
        for part in ahead:  # as `forward.sweep_all` does, of which a user's traceback need not tell
            with part.refusing():
                sweep.forward(part.chain, plan.steps, part.record)
        return self.outcome(plan, FILTERED, *ahead.result())

    def carefully(self, plan: ChainPlan, start: Array | None) -> ChainOutcome:
        """The filtered posterior step by step, each belief in pairs of float64."""
        if self.balanced:
            self._refuse_nonlinear(plan)
        swept, status = careful.sweep(plan, self.schedule)
        return self.outcome(plan, FILTERED, swept.forward, status, careful=swept, error=swept.error)

    def _refuse_nonlinear(self, plan: ChainPlan) -> None:
        """Refuse nonlinear CPDs, and robust noise, for a balanced tree, with GraphError."""
        for family in plan.families:
            if not family.settled:
                kind = "of robust noise" if family.exact else "nonlinear"
                raise GraphError(
                    f"{family.cpd!r} is {kind}, and {titled(self.graph)} solves for all steps "
                    "at once, where a filter linearises at the belief before: compile without "
                    "pgm.Balanced(), or smooth"
                )


def _needs_all(sensor: Sensor) -> bool:
    """Whether a pass is kept whole: if noise is singular, or its weights tell of outliers."""
    return sensor.exact or (sensor.robust and sensor.weights.noise.graduated)


class LagSolver(Solver):
    """The solver for fixed-lag smoothing: backward messages over a lag.

    Where CPDs are linearised again, a window, the last lag + 1 steps, slides along the chain, and
    each window is solved in float64 or in pairs of float64, as its digits need.
    """

    def solve(self, plan: ChainPlan, start: Array | None, room: Room | None) -> ChainOutcome:
        """The posterior by one forward pass and one pass back over the lag, or window by window."""
        return self._lagged(plan, fixed_lag.smooth)

    def carefully(self, plan: ChainPlan, start: Array | None) -> ChainOutcome:
        """The posterior in pairs of float64, except where windows slide.

        Each window then chooses float64 or pairs for itself.
        """
        return self._lagged(plan, fixed_lag.carefully)

    def _lagged(
        self, plan: ChainPlan, once: Callable[[ChainPlan, FixedLag], tuple[Lagged, Status]]
    ) -> ChainOutcome:
        """The posterior of a fixed lag: by sliding windows where there is anything to iterate.

        If not, `once(plan, schedule)` linearises once, and returns the beliefs with their status.
        """
        slides = fixed_lag.slides(plan, self.schedule)
        found, status = (fixed_lag.slide if slides else once)(plan, self.schedule)
        return self.outcome(
            plan,
            Kind(self.schedule.lag),
            found.forward,
            status,
            found.beliefs,
            found.reverse,
            found.careful,
            found.windows,
            found.error,
        )


class SmootherSolver(Solver):
    """The solver for smoothing: messages forward and back, iterated."""

    def __init__(self, graph: DynamicGraph, schedule: Calibration) -> None:
        if not isinstance(schedule, Smoothing):
            schedule = Smoothing(schedule.iterations, schedule.tolerance)
        super().__init__(graph, schedule)

    def solve(self, plan: ChainPlan, start: Array | None, room: Room | None) -> ChainOutcome:
        """The smoothed posterior: sweeps forward and back, or parallel scans if balanced."""
        smooth = smoother.scan if self.balanced else smoother.smooth
        found, status = smooth(plan, self.schedule, start)
        ahead = parallel.whole(found.forward)
        return self.outcome(plan, SMOOTHED, ahead, status, found.beliefs, found.reverse)

    def carefully(self, plan: ChainPlan, start: Array | None) -> ChainOutcome:
        """The smoothed posterior: sweeps in pairs of float64, iterated."""
        found, status = smoother.carefully(plan, self.schedule, start, reckoned=self.balanced)
        swept = found.careful
        return self.outcome(
            plan,
            SMOOTHED,
            swept.forward,
            status,
            found.beliefs,
            careful=swept,
            error=found.error,
        )


def run(
    graph: DynamicGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
    room: Room | None = None,
    *,
    trial: bool = False,
) -> ChainOutcome:
    """The posterior of a chain given its evidence, by a schedule, smoothing if that is None.

    `start` maps hidden variables to means for the first linearisation; `schedules/options.py` has
    refused it to schedules that have no use for one. `room` is a pair of arrays (T+1, runs, ...) in
    which a filter may leave means and covariances; with None it makes its own. A fixed lag of 0 is
    a filter. NumPy's warnings are silenced, since results that are not finite are refused at the
    end; the status tells how many digits are lost, of which the caller warns. Functions may be
    replaced by traces, programs recorded from a call; where one proves wrong, all is done again.

    A `trial` is one start among many, for which a whole pass in twice the digits is not worth its
    time: where float64 fails it raises NumericalError, and where it has lost too many digits the
    iterations go on in twice the digits from where they stopped, `POLISHING` times at the most.
    """
    schedule = Smoothing() if schedule is None else schedule
    if isinstance(schedule, FixedLag) and not schedule.lag and schedule.solver is None:
        require_known(schedule, "a filter, which a lag of 0 is")
        schedule = schedule.filtering
    plain = start is None and room is None and not trial
    blank = Blank.known(graph.layout, bound, lineariser) if plain else None
    solver = solver_of(graph, schedule)
    given = None if start is None else _start(graph.layout, bound, start)
    for judge in judged():
        found: ChainOutcome | None = None
        with quiet(), judge:
            plan = _plan(graph, bound, lineariser, schedule, judge)
            careful, begun = solver, given
            if not certificate.is_flat(plan):
                # With twice the digits there may be an answer.
                with nullcontext() if trial else suppress(NumericalError):
                    swept = _fitting(solver.solve(plan, given, room), schedule)
                    found = _told(swept) if _suffices(swept) else None
                    if trial and found is None:
                        careful, begun = _polishing(graph, schedule), swept._beliefs.mean
                if found is None:
                    account = plan.account
                    plan = _plan(graph, bound, lineariser, schedule, judge, probe=False)
                    plan.account.left.update(account.left)
            if found is None:
                found = _carefully(careful, plan, begun)
    assert found is not None
    bind(blank, schedule, found, bound)
    return found


def _polishing(graph: DynamicGraph, schedule: Schedule) -> Solver:
    """The solver that goes on from where a trial by the schedule stopped."""
    assert isinstance(schedule, Calibration)
    return solver_of(graph, replace(schedule, iterations=min(schedule.iterations, POLISHING)))


def _plan(
    graph: DynamicGraph,
    bound: BoundEvidence,
    lineariser: Lineariser,
    schedule: Schedule,
    judge: Judge,
    *,
    probe: bool = True,
) -> ChainPlan:
    """The plan of one pass over a chain, its gates prepared.

    The `judge` compares the values of traces, which stand in for functions in this call, with those
    of the functions. `probe` says whether functions are first called on trial.
    """
    plan = ChainPlan.make(graph, bound, lineariser, probe=probe, judge=judge)
    gate.prepare(plan, getattr(schedule, "gate", None))  # a plain calibration has none
    return plan


def _fitting(found: Any, schedule: Schedule) -> ChainOutcome:
    """The outcome of a solver, of the schedule's kind; a ModelError refuses that of one's own else.

    Comparisons go by the kind of the schedule.
    """
    kind = getattr(schedule, "kind", SMOOTHED)  # a plain calibration has none
    if not isinstance(found, ChainOutcome) or found.kind != kind:
        of = f"of the kind {found.kind}" if isinstance(found, ChainOutcome) else titled(found)
        raise ModelError(
            f"{schedule!r}: solve of its solver returned an outcome {of}, where one of the kind "
            f"{kind} was due; the schedule says by a property `kind` how many later steps its "
            "beliefs know"
        )
    return found


def _suffices(posterior: ChainOutcome) -> bool:
    """Whether float64 has left enough digits; NumericalError where it has left no numbers."""
    kept = _is_kept(posterior)
    if not kept:
        _refuse_infinite(posterior)
    smoothed = None if posterior._smoothed is None else posterior._smoothed.cov
    # Windows that slide have each been looked at.
    return bool(posterior._windows) or certificate.suffices(
        posterior._planned, posterior._swept, smoothed, kept=kept
    )


def _is_kept(posterior: ChainOutcome) -> bool:
    """Whether the sweep back has told that its beliefs have the digits that are promised."""
    return posterior._smoothed is not None and posterior._smoothed.kept


def _carefully(solver: Solver, plan: ChainPlan, given: Array | None) -> ChainOutcome:
    """The posterior in pairs of float64, where float64 fails or loses too many digits.

    `given` (T+1, runs, n) are the means of the slices at which to linearise first, None if the user
    gave none.
    """
    found = solver.carefully(plan, given)
    _refuse_infinite(found)
    return _told(found)


def _told(posterior: ChainOutcome) -> ChainOutcome:
    """The posterior, its status completed by two losses of digits, if there are any.

    They are the rounding of sigma points close together (`close_points`) and of the last places of
    means (`last_places`). No pass can avoid them: functions are evaluated in float64, and means are
    float64 in the end.
    """
    plan, swept, status = posterior._planned, posterior._swept, posterior.status
    lost = close_points.error(plan, swept)
    if lost is not None:
        status = status._losing(lost, CLOSE_POINTS)
    measured = status.digits is not None
    if not measured and not swept.far and _is_kept(posterior):
        return posterior  # no mean is so far from zero
    careful = posterior._careful is not None
    lost = last_places.error(plan, swept, posterior._smoothed, careful=careful, measured=measured)
    if lost is not None:
        status = status._losing(lost, LAST_PLACE)
    return posterior if status is posterior.status else posterior._changed(status=status)


def _refuse_infinite(posterior: ChainOutcome) -> None:
    """Raise NumericalError if moments or log-densities are not finite, or a variance is negative.

    A flat prior's infinite variances are allowed. Negative variances are looked for only in passes
    in twice the digits, or by windows.
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
    """The solver for a schedule, or for the nearest of its base classes that has one.

    One of a user's own names its solver. The solver is made for the `graph`. A ModelError refuses a
    schedule for which there is none, and one with options of its own that has only its base's.
    """
    if isinstance(schedule, OnChains):
        if schedule.solver is not None:
            if not (isinstance(schedule.solver, type) and issubclass(schedule.solver, Solver)):
                raise ModelError(
                    f"{schedule!r}: its solver is {titled(schedule.solver)}; a class derived from "
                    "Solver (pgm.beliefs.moments.solvers.run) was due"
                )
            return schedule.solver(graph, schedule)
        require_known(schedule, "the solver of its base")
    for each in type(schedule).__mro__:
        if each in SOLVERS:
            return SOLVERS[each](graph, schedule)
    raise ModelError(
        f"a chain of slices takes pgm.Filtering(), pgm.FixedLag(...) or pgm.Smoothing(), not "
        f"{schedule!r}"
    )


def _start(layout: SliceLayout, bound: BoundEvidence, start: Start) -> Array:
    """The user's starting means as an array (T+1, runs, n).

    EvidenceError unless each hidden variable has one row for each step at which it stands.
    """
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
