"""The forward sweep: messages in moment form, from cluster 0 to cluster T."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pgm.errors import NumericalError
from pgm.inference.chain.cost import require_cost
from pgm.inference.chain.iteration import Anchor
from pgm.inference.chain.plan import ChainPlan, Link
from pgm.inference.chain.reading import MomentReading, take
from pgm.inference.chain.update import sensors_due, update
from pgm.inference.family import Family
from pgm.inference.schedule import Filtering
from pgm.inference.status import Status
from pgm.kernels import moments, roots
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array, Index, block, stacked
from pgm.linearisers import ArrayLineariser


@dataclass(frozen=True, eq=False)
class Forward:
    """What a forward sweep leaves, time first: over the slices, before and after their readings.

    Attributes
    ----------
    predicted_mean, mean : ndarray
        (T+1, runs, slice size); controls at step 0 are zero.
    predicted_cov, cov : ndarray
        (T+1, runs, slice size, slice size).
    log_density : ndarray
        (T+1, runs): of each step's readings given those before.
    gentle : bool
        Whether segments have been composed to it, which takes variances that keep their digits.
    """

    predicted_mean: Array
    predicted_cov: Array
    mean: Array
    cov: Array
    log_density: Array
    gentle: bool = False

    @classmethod
    def empty(cls, plan: ChainPlan) -> Forward:
        """Room for a sweep."""
        size, shape = plan.layout.slice_size, (plan.steps + 1, plan.runs)

        def moments() -> tuple[Array, Array]:
            return stacked(shape, (size,)), stacked(shape, (size, size))

        return cls(*moments(), *moments(), np.zeros(shape))


def sweep(plan: ChainPlan, anchor: Anchor | None = None) -> Forward:
    """Run the forward sweep with every CPD as it is laid out."""
    out = Forward.empty(plan)
    for step in _predictions(plan, out, linearise=False):
        mean, cov, out.log_density[step] = update(
            sensors_due(plan.sensors, step),
            step,
            out.predicted_mean[step],
            out.predicted_cov[step],
        )
        if anchor is not None:
            mean, cov = anchor.hold(step, mean, cov)
        out.mean[step], out.cov[step] = mean, cov
    return out


def run(plan: ChainPlan, schedule: Filtering) -> tuple[Forward, Status]:
    """Run the forward sweep, linearising each CPD at its incoming belief."""
    require_cost(schedule, (sensor.family for sensor in plan.sensors))
    once = is_single_pass(plan, schedule)
    from pgm.inference.chain import many

    if plan.lean and once:
        from pgm.inference.chain import single  # here, since LAPACK is slow to import

        done = single.run(plan)
        if done is not None:
            return done[0], Status.of([], done[1], plan.lead)
    if once and many.suits(plan):
        found = many.run(plan)
        if found is not None:
            return found, once_status(plan)
    out = Forward.empty(plan)
    record: list[Array] = []
    converged = np.ones(plan.runs, dtype=bool)
    for step in _predictions(plan, out, linearise=True):
        mean, cov = out.predicted_mean[step], out.predicted_cov[step]
        taken = take(MomentReading(sensors_due(plan.sensors, step), step, mean, cov), schedule)
        last = taken.solution
        out.mean[step], out.cov[step], out.log_density[step] = (
            taken.mean,
            last.cov,
            last.log_density,
        )
        record = largest(record, taken.residuals)
        converged &= taken.converged
    return out, Status.of(record, converged, plan.lead)


def is_single_pass(plan: ChainPlan, schedule: Filtering) -> bool:
    """Whether each CPD is linearised once."""
    return schedule.iterations == 1 or all(sensor.family.exact for sensor in plan.sensors)


def once_status(plan: ChainPlan) -> Status:
    """How it went with one linearisation of each CPD."""
    linear = all(s.family.exact for s in plan.sensors if s.family.step.size)
    return Status.of([], np.full(plan.runs, linear), plan.lead)


def _predictions(plan: ChainPlan, out: Forward, *, linearise: bool) -> Iterator[int]:
    """Predict each step in turn, once the step before has taken its readings."""
    states = plan.layout.state_places
    mean, cov = start(plan, linearise=linearise)
    out.predicted_mean[0][:, states] = mean
    put(out.predicted_cov[0], states, cov)
    yield 0
    for step in range(1, plan.steps + 1):
        mean = out.mean[step - 1][:, states]
        cov = block(out.cov[step - 1], states, states)
        out.predicted_mean[step], out.predicted_cov[step] = predict(
            plan, step - 1, mean, cov, linearise=linearise
        )
        yield step


def largest(record: list[Array], residuals: list[Array]) -> list[Array]:
    """The largest residuals of all steps; a step that was done earlier keeps its last one."""
    if not record or not residuals:
        return record or residuals
    length = max(len(record), len(residuals))
    ours, others = (each + each[-1:] * (length - len(each)) for each in (record, residuals))
    return [np.maximum(a, b) for a, b in zip(ours, others, strict=True)]


def put(cov: Array, places: Index, value: Array) -> None:
    """Write the block of some components."""
    if isinstance(places, slice):
        cov[:, places, places] = value
    else:
        cov[:, places[:, None], places] = value


def start(plan: ChainPlan, *, linearise: bool) -> tuple[Array, Array]:
    """Moments of the states at step 0; read-only where they are one for all runs."""
    size, runs = plan.layout.state_size, plan.runs
    once = 1 if all(_shared(link.family) for link in plan.prior) else runs
    mean, cov = stacked((once,), (size,)), stacked((once,), (size, size))
    for link in plan.prior:
        _extend(link, 0, 0, mean, cov, linearise)
    return np.broadcast_to(mean, (runs, size)), np.broadcast_to(cov, (runs, size, size))


def _shared(family: Family) -> bool:
    """Whether an affine CPD is the same for all runs."""
    parts = family.matrix, family.offset, family.noise
    return family.exact and all(part.strides[1] == 0 or part.size == 0 for part in parts)


def predict(
    plan: ChainPlan, row: int, mean: Array, cov: Array, *, linearise: bool
) -> tuple[Array, Array]:
    """Moments of the slice from those of the states before it."""
    if plan.layout.single:
        link = plan.transition[0]
        family = link.family
        if linearise and not family.exact:
            family.linearise(row, mean, cov)
        conditional = moments.Conditional(family.matrix[row], family.offset[row], family.noise[row])
        slice_mean, slice_cov = moments.predict(mean, cov, conditional)
        keep_chart(link, row, mean, slice_mean)
        _check_predicted(link, row, slice_cov)
        return slice_mean, slice_cov
    front = plan.layout.state_size
    size = front + plan.layout.slice_size
    pair_mean, pair_cov = stacked((plan.runs,), (size,)), stacked((plan.runs,), (size, size))
    pair_mean[:, :front] = mean
    pair_cov[:, :front, :front] = cov
    for link in plan.transition:
        _extend(link, row, row + 1, pair_mean, pair_cov, linearise)
    return pair_mean[:, front:], pair_cov[:, front:, front:]


def _extend(link: Link, row: int, step: int, mean: Array, cov: Array, linearise: bool) -> None:
    family, parents = link.family, link.parents
    if linearise and not family.exact:
        family.linearise(row, mean[:, parents], block(cov, parents, parents))
    moments.extend(
        mean,
        cov,
        link.child,
        parents,
        family.matrix[row][: len(mean)],
        family.offset[row][: len(mean)],
        family.noise[row][: len(mean)],
    )
    keep_chart(link, row, mean, mean[:, link.child])
    _check_predicted(link, row, block(cov, link.child, link.child))


def keep_chart(link: Link, row: int, before: Array, child: Array) -> None:
    """Undo, in place, whole turns that a function which wraps its angles has made in a step.

    Beliefs live on one unwrapped chart.
    """
    if not link.before.size:
        return
    places = zip(link.angles, link.before, strict=True)
    if any(np.abs(child[:, new] - before[:, old]).max() > np.pi for new, old in places):
        turned = child[:, link.angles] - before[:, link.before]
        # A function that wraps gives the same for an angle a whole turn on; another turns too.
        further = before.copy()
        further[:, link.before] += TURN
        function = link.family.bound(row, 1, before.shape[:1])
        gained = function(further[:, link.parents]) - function(before[:, link.parents])
        wraps = np.abs(gained[:, link.angles]) < 0.5 * TURN
        turns = np.where(wraps, TURN * np.round(turned / TURN), 0.0)
        child[:, link.angles] -= turns
        link.family.offset[row][:, link.angles] -= turns


def is_semidefinite(family: Family) -> bool:
    """Whether the lineariser's error is never indefinite."""
    lineariser, width = family.lineariser, family.shape[-1]
    if not width:  # no hidden parent, and no error
        return True
    return isinstance(lineariser, ArrayLineariser) and lineariser.is_semidefinite(width)


def rough(plan: ChainPlan) -> list[Family]:
    """The CPDs whose linearisation may make a belief indefinite."""
    return [f for f in plan.families if not (f.taylor or is_semidefinite(f))]


def _check_predicted(link: Link, row: int, cov: Array) -> None:
    """Refuse what is too large, or indefinite, which only a lineariser's error can make it."""
    family = link.family
    if not np.isfinite(cov).all():
        fault = (
            "not finite; are the belief before it, its inputs and its noise of a size that float64 "
            "can hold?"
        )
    elif not family.approximate or is_semidefinite(family) or roots.is_proper(roots.root(cov)):
        return
    else:
        fault = (
            f"indefinite with {family.lineariser!r}; use a rule with positive weights or more "
            "samples"
        )
    step = int(family.step[row])
    raise NumericalError(
        f"{family.cpd!r}: the predicted covariance at step {step} is {fault}",
        variable=family.cpd.child,
        cpd=family.cpd,
        step=step,
    )
