"""Running a schedule on a chain: all runs at once, or in parts, of which little may be kept.

A part is a slice of the runs with its evidence; a job is the work on it; its share is the portion
of its posterior that comes back. The room is a list of arrays for all runs, (steps, runs, ...),
into which the parts' results go; it is empty if posteriors come back whole.

Here `graph` is the compiled network, and `bound` the evidence in arrays over runs. A schedule
says whether to filter or to smooth, and how often to linearise; None smooths. `lineariser` is the
rule for nonlinear CPDs that have none of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.association.association import associated
from pgm.beliefs.moments.bound.binding import bound_to
from pgm.beliefs.moments.digits import last_places
from pgm.beliefs.moments.outcomes.doubts import is_held
from pgm.beliefs.moments.outcomes.kept_outcome import KeptOutcome
from pgm.beliefs.moments.outcomes.kept_sensor import KeptSensor
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.parts.join import joined, one_status, swept_once
from pgm.beliefs.moments.parts.split import Part, split
from pgm.beliefs.moments.solvers.run import run as run_chain
from pgm.compile import BalancedGraph, DynamicGraph, SliceLayout
from pgm.errors import EvidenceError, ExecutorError, GraphError, PgmError
from pgm.evidence import BoundEvidence
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, as_scope, listed, namesake
from pgm.kernels.arrays import Array, frozen
from pgm.linearisers import Lineariser
from pgm.posteriors.associations import is_open
from pgm.posteriors.belief_kind import Kind
from pgm.posteriors.status import LAST_PLACE, Status
from pgm.progress import counted
from pgm.resources import require_memory
from pgm.schedules.argument_checks import require_gaussian
from pgm.schedules.options import Call
from pgm.schedules.schedule import Calibration, Filtering, Schedule
from pgm.schedules.starting_points import Start
from pgm.variables import Variable
from pgm.workers.shared_memory import Shape, address
from pgm.workers.workers import Workers

Keep = Variable | Iterable[Variable]


def run(graph: DynamicGraph, bound: BoundEvidence, call: Call) -> ChainOutcome | KeptOutcome:
    """The posterior of a chain with Gaussian beliefs, given the evidence `bound`, as a call asks.

    Measurements of unknown things are first associated with candidates. If digits are lost, one
    warning is given for all runs together.

    Of its options `start` has the means by variable at which CPDs are linearised first. `keep` has
    the variables whose marginals alone are held, with the log-evidence, which bounds memory; and
    sensors, of which beliefs of measurements and innovations are held.
    Workers of `executor` share the runs. With an executor, or with `keep`, runs are worked through
    in parts.
    """
    schedule, lineariser, start, keep, executor, *_ = call
    if start is None and keep is None and executor is None:
        swept_before = bound_to(graph, bound, schedule, lineariser)
        if swept_before is not None:
            return _told(swept_before)
    model = graph.model
    require_gaussian((*model.prior, *model.transition, *model.observation), "Gaussian beliefs")
    if is_open(bound):
        gate = getattr(schedule, "gate", None)
        (bound, found), how = associated(graph, bound, lineariser, gate)
        posterior = run(graph, bound, call)
        status = posterior.status.with_compilation(_both(posterior.status.compilation, how))
        return posterior._changed(status=status, associations=found)
    kept, sensors = (None, ()) if keep is None else _kept(graph.layout, keep)
    _require_memory(graph.layout, bound, schedule, kept, sensors)
    workers = Workers(executor)
    whole = Part(slice(0, bound.runs), graph, bound, start)
    parts = [whole]
    if kept is not None or executor is not None:
        parts = list(split(whole, lineariser, workers.count))
    if len(parts) == 1:
        if kept is None:
            return _told(run_chain(graph, bound, schedule, lineariser, start, trial=call.trial))
        workers = Workers(None)
    share = Share.of(graph, schedule, start, kept, sensors)
    room = workers.room(share.shapes(graph, bound))
    results = _results(workers, whole, parts, schedule, lineariser, share, room)
    if kept is None and any(result.careful for result in results):
        # Its joints need all that the careful pass leaves.
        return _told(run_chain(graph, bound, schedule, lineariser, start))
    status = one_status((result.status for result in results), bound.lead)
    status = _with_places(status, share, room, parts, results)
    status._warn()
    held = all(result.held for result in results)
    if kept is not None:
        kinds = {result.log_evidence_kind for result in results}
        return KeptOutcome(
            graph,
            status,
            results[0].kind,
            _gaussians(kept, room, bound),
            frozen(room[-1].reshape(bound.lead).copy()),
            kinds.pop() if len(kinds) == 1 else "linearised",  # a fixed point is one of all runs
            {
                sensor: KeptSensor.joined(each, bound.lead)
                for sensor, *each in zip(
                    sensors, *(result.sensors for result in results), strict=True
                )
            },
            held,
        )
    if share.beliefs:
        return swept_once(graph, bound, lineariser, status, room, held=held)
    each = [result.found for result in results if result.found is not None]
    return joined(graph, bound, lineariser, status, each)


def _both(compilation: str, associations: str) -> str:
    """The account of a call's sweeps, and of the associations before them where that is another."""
    if associations in ("", compilation):
        return compilation
    return f"{compilation}; associations {associations}".removeprefix("; ")


def _told(posterior: ChainOutcome) -> ChainOutcome:
    """Return the posterior itself, after a `PrecisionWarning` if rounding leaves it few digits."""
    posterior.status._warn()
    return posterior


def _with_places(
    status: Status,
    share: Share,
    room: Sequence[Array],
    parts: Sequence[Part],
    results: Sequence[Result],
) -> Status:
    """The `status` of all runs, with fewer digits for parts that have not measured theirs.

    A status may tell how many digits of the means rounding leaves in each run. If no part or every
    part has measured them, the status stays as it is. If only some have, `status` gives the runs of
    the others all of float64's digits. From these runs digits are taken off here, by how coarse
    the last place of a mean in float64 is, in standard deviations of its component. Means and
    deviations are those that a part has sent: in the `room`, or, where its posterior came back
    whole, in its result.
    """
    if status.digits is None or all(result.status.digits is not None for result in results):
        return status
    lost = np.zeros(status.digits.size)
    for part, result in zip(parts, results, strict=True):
        if result.status.digits is None:
            for mean, cov in share.moments(_of(room, part), result.found):
                error = last_places.of_beliefs(mean, cov, np.zeros(1)).max(axis=0)
                lost[part.runs] = np.maximum(lost[part.runs], error)
    return status._losing(lost, LAST_PLACE)


def _results(
    workers: Workers,
    whole: Part,
    parts: Sequence[Part],
    schedule: Schedule | None,
    lineariser: Lineariser,
    share: Share,
    room: Sequence[Array],
) -> list[Result]:
    """The results of all parts, in order; their arrays have been written to the `room`.

    A part may turn out to need arithmetic of twice float64's digits. Unless the share is of kept
    variables, all runs have then to be solved together, and the list ends with that part. If a job
    fails by a `PgmError`, the runs are solved again in this process, which raises the error here.
    """
    jobs = [
        Job(part, schedule, lineariser, share, _of(room, part) if workers.shares else None)
        for part in parts
    ]
    model, results = whole.graph.model, list[Result]()
    named = (*model.prior, *model.transition, *model.observation, lineariser)
    work = workers.each(run_job, jobs, [part.runs for part in parts], large=not room, named=named)
    for part, done in counted(zip(parts, work, strict=True), "parts of the runs", len(parts)):
        if isinstance(done.error, PgmError) and not isinstance(done.error, ExecutorError):
            _fail_alone(whole, part, schedule, lineariser, share)
        result: Result = done.result()
        if result.arrays is not None:
            write(_of(room, part), result.arrays)
        results.append(result._replace(arrays=None))
        if share.kept is None and result.careful:
            break
    return results


def _fail_alone(
    whole: Part, failed: Part, schedule: Schedule | None, lineariser: Lineariser, share: Share
) -> None:
    """Solve again, in this process, where a worker has failed, so that the error is raised here.

    All runs are solved; or, if variables are kept, those parts, cut as for one worker, that have
    runs in common with the `failed` one. The first error may be of other runs than the worker's. If
    none is raised, the function returns.
    """
    for part in [whole] if share.kept is None else split(whole, lineariser, 1):
        if part.runs.stop > failed.runs.start and part.runs.start < failed.runs.stop:
            run_chain(part.graph, part.bound, schedule, lineariser, part.start)


def _of(room: Sequence[Array], part: Part) -> list[Array]:
    """Of each array (steps, runs, ...) of the room, a view of the part's runs."""
    return [array[:, part.runs] for array in room]


def _require_memory(
    layout: SliceLayout,
    bound: BoundEvidence,
    schedule: Schedule | None,
    kept: Scope | None,
    sensors: Scope,
) -> None:
    """Refuse beliefs that would not fit in memory, by a `GraphError`.

    What is counted are means and covariances at all steps: of the `kept` variables alone and, as
    beliefs and as innovations, of the `sensors`; or, if `kept` is None, of the whole slices, once
    for a filter and four times for a smoother, which keeps the moments of its passes.
    """
    sizes = [layout.slice_size] if kept is None else [v.dimension for v in kept]
    sizes += [v.dimension for v in sensors] * 2
    sets = 4 if kept is None and not isinstance(schedule, Filtering) else 1
    require_memory(
        sets * (bound.steps + 1) * bound.runs * sum(size * (size + 1) for size in sizes),
        f"the beliefs at {bound.steps + 1} steps in {bound.runs} runs",
        "give fewer runs or steps to a call"
        + ("" if kept is not None else "; keep=[x] keeps the marginals of x alone"),
        error=GraphError,
    )


def _kept(layout: SliceLayout, keep: Keep) -> tuple[Scope, Scope]:
    """The hidden variables and the sensors that the user's `keep` names; an EvidenceError else."""
    kept, taken = as_scope(keep, "keep", ordered=False), (*layout.slice, *layout.model.sensors)
    for variable in kept:
        if variable not in taken:
            raise EvidenceError(
                f"keep has {variable!r}, which is neither hidden nor measured; it takes "
                f"{listed(taken)}{namesake(variable, taken)}",
                variable=variable,
            )
    hidden = tuple(variable for variable in kept if variable in layout.slice)
    return hidden, tuple(variable for variable in kept if variable not in layout.slice)


def _gaussians(
    kept: Scope, room: Sequence[Array], bound: BoundEvidence
) -> dict[Variable, Gaussian]:
    """Kept marginals from arrays (steps, runs, ...), as Gaussians (*lead, steps, ...).

    The arrays of the `room` are the mean and the covariance of each variable in turn, then the
    log-evidence, which is not used. A hidden control has no step 0, hence its step labels begin
    at 1.
    """
    found = {}
    for variable, mean, cov in zip(kept, room[::2], room[1::2], strict=False):
        found[variable] = Gaussian._make(
            (variable,),
            mean.swapaxes(0, 1).reshape(*bound.lead, len(mean), variable.dimension),
            cov.swapaxes(0, 1).reshape(*bound.lead, len(mean), *cov.shape[2:]),
            np.arange(bound.steps + 1 - len(mean), bound.steps + 1),
        )
    return found


@dataclass(frozen=True)
class Share:
    """The portion of a part's posterior that a worker sends back.

    kept: The variables whose marginals are sent, with the log-evidence; None if none were chosen.
    beliefs: Whether the filtered moments and log-densities of all steps are sent. If this is False,
        and `kept` is None, the posterior itself is sent.
    smoothed: Whether the smoothed moments are sent with these beliefs.
    sensors: Those of which beliefs of measurements and innovations are sent with kept marginals.
    """

    kept: Scope | None
    beliefs: bool
    smoothed: bool
    sensors: Scope

    @classmethod
    def of(
        cls,
        graph: DynamicGraph,
        schedule: Schedule | None,
        start: Start | None,
        kept: Scope | None,
        sensors: Scope,
    ) -> Share:
        """The share for a call: kept marginals, beliefs alone, or the whole posterior.

        Marginals are sent if there are `kept` variables, or `sensors`. Beliefs suffice if every CPD
        was linearised once, along the filter: the schedule has one iteration, is no fixed lag and
        none of a user's own, and there is no start, no balanced tree and no gate. Another sweep
        then finds everything else. A posterior of any other call is sent whole.
        """
        once = schedule is None or (
            isinstance(schedule, Filtering | Calibration)
            and schedule.iterations == 1
            and schedule.solver is None
        )
        plain = start is None and not isinstance(graph, BalancedGraph)
        # What gates have decided is in all of it.
        plain = plain and getattr(schedule, "gate", None) is None
        alone = kept is None and once and plain
        return cls(kept, alone, not isinstance(schedule, Filtering), sensors)

    def shapes(self, graph: DynamicGraph, bound: BoundEvidence) -> list[Shape]:
        """The shapes of the arrays sent back, for all runs: ((steps, runs), lengths of own axes).

        With kept variables the arrays are the mean and the covariance of each, then the
        log-evidence, for which steps is 1. With beliefs they are the mean, covariance and
        log-density of the filter, then the mean and covariance of a smoother. There are none if
        posteriors are sent whole.
        """
        layout, everywhere = graph.layout, (bound.steps + 1, bound.runs)
        found: list[Shape] = []
        if self.kept is not None:
            for variable in self.kept:
                lead = (bound.steps + (variable in layout.states), bound.runs)
                found += [(lead, (variable.dimension,)), (lead, (variable.dimension,) * 2)]
            return [*found, ((1, bound.runs), ())]
        if self.beliefs:
            moments = [(everywhere, (layout.slice_size,)), (everywhere, (layout.slice_size,) * 2)]
            return [*moments, (everywhere, ()), *(moments if self.smoothed else ())]
        return []

    def moments(
        self, arrays: Sequence[Array], found: ChainOutcome | None
    ) -> Iterable[tuple[Array, Array]]:
        """Pairs of a mean and a covariance, (steps, runs, ...), that a part has sent.

        They are those of its posterior `found`, if it was sent whole, and otherwise those in its
        `arrays`.
        """
        if found is not None:
            every = [found._swept, found._smoothed]
            return [(each.mean, each.cov) for each in every if each is not None]
        if self.kept is not None:
            return zip(arrays[:-1:2], arrays[1:-1:2], strict=True)
        return zip(arrays[::3], arrays[1::3], strict=True)  # with log-densities between

    def arrays(self, found: ChainOutcome, runs: int) -> list[Array]:
        """The arrays of a part's posterior that are sent back, in the order of `shapes`.

        They are of kept marginals or of beliefs; this is not called where the posterior is sent
        whole. `runs` is the number of the part's runs.
        """
        if self.kept is None:
            swept, smoothed = found._swept, found._smoothed
            last = [] if smoothed is None else [smoothed.mean, smoothed.cov]
            return [swept.mean, swept.cov, swept.log_density, *last]
        arrays: list[Array] = []
        for variable in self.kept:
            belief, size = found[variable], variable.dimension
            arrays += [
                belief.mean.reshape(runs, -1, size).swapaxes(0, 1),
                belief.cov.reshape(runs, -1, size, size).swapaxes(0, 1),
            ]
        return [*arrays, found.log_evidence.reshape(1, runs)]


@dataclass(frozen=True, eq=False)
class Job:
    """The work on a part of the runs.

    `share` says which portion of the part's posterior is sent back. Its arrays go into `room`, the
    part's views of the arrays of all runs; if `room` is None, they go into the result.
    """

    part: Part
    schedule: Schedule | None
    lineariser: Lineariser
    share: Share
    room: Sequence[Array] | None


class Result(NamedTuple):
    """The result of a part of the runs.

    status: How the inference of these runs went: convergence, and digits that rounding leaves.
    kind: Whether beliefs are filtered, of a fixed lag or smoothed.
    log_evidence_kind: A word for how true the log-evidence is, such as "exact" or "linearised".
    held: Whether beliefs were lost in no run, as of `Forward`.
    careful: Whether the part had to be computed with twice float64's digits; then, unless variables
        are kept, there are neither arrays nor a posterior, since all runs are solved again
        together.
    arrays: The arrays of the share; None where they have been written to the room.
    found: The posterior, where it is sent whole.
    sensors: What is kept of each sensor of the share.
    """

    status: Status
    kind: Kind
    log_evidence_kind: str
    held: bool
    careful: bool
    arrays: Sequence[Array] | None = None
    found: ChainOutcome | None = None
    sensors: Sequence[KeptSensor] = ()


def run_job(job: Job) -> Result:
    """Do a job: solve its part of the runs, and return the share of the posterior."""
    part, share = job.part, job.share
    slice_, room = part.graph.layout.slice, None
    if job.room and (share.kept is None or share.kept == slice_):
        room = job.room[0], job.room[1]
    found = run_chain(part.graph, part.bound, job.schedule, job.lineariser, part.start, room)
    careful = found._careful is not None
    held = is_held(found)
    result = Result(found.status, found.kind, found.log_evidence_kind, held, careful)
    if share.kept is None and careful:
        return result
    if share.kept is None and not share.beliefs:
        return result._replace(found=found)
    arrays = share.arrays(found, part.bound.runs)
    result = result._replace(sensors=[KeptSensor.of(found, v) for v in share.sensors])
    if job.room is None:
        return result._replace(arrays=arrays)
    write(job.room, arrays)
    return result


def write(room: Sequence[Array], arrays: Sequence[Array]) -> None:
    """Copy arrays, one by one, to those of a room, but for arrays that already lie there."""
    for place, array in zip(room, arrays, strict=True):
        if address(place) != address(array):  # it has not been made there
            np.copyto(place, array)
