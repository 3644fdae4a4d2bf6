"""The forward pass of a chain in moment form: predict a slice, and condition it on measurements.

A *slice* is the vector of all hidden variables of a step, states and controls, of n components; a
*pair* is the vector of the states of the step before, then the slice. The steps are 0..T. The
transition's CPDs write their children into the pair one after another. A *link* is a CPD with the
places of its parents and its child in a vector, the states for the prior and the pair for the
transition. Arrays have their components first and the runs last: a belief over a slice has the
moments (n, *batch) and (n, n, *batch), with `batch` () for one run and (runs,) for several. A
*sighting* is one measurement by a sensor, of which a step may have several.

Angles live on one unwrapped chart: where a CPD's function wraps an angle of its child, the angle is
moved by whole turns to within half a turn of the same angle a step before. `link.before` has the
places in the pair of these earlier angles; it is empty for an affine CPD, and where the child does
not depend on itself a step before.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from pgm.beliefs.moments.steps import gate, readings, refusals
from pgm.beliefs.moments.steps.iterated_update import MomentUpdate, iterated
from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.beliefs.moments.steps.readings import Certain, Moments, Reading
from pgm.beliefs.moments.steps.vector import Measured
from pgm.kernels import gaussian
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array, Mask, components_first, components_last, times, within
from pgm.kernels.step import nearest
from pgm.linearisation.failures import require_finite
from pgm.linearisation.rows import At
from pgm.linearisers import Line
from pgm.schedules.iteration import Anchor
from pgm.schedules.schedule import ONCE, Filtering

_HALF_TURN = 0.5 * TURN


class MomentChain:
    """A forward pass in moment form: predicts a slice, and takes in the measurements of its step.

    With a `schedule` each CPD is linearised at its incoming belief, and the sensors of a step again
    as the schedule says; new linearisations are stored in the plan if `keep` is set. The schedule's
    gate leaves out measurements too far from their prediction. With None for a schedule the
    linearisations stored in the plan are used, and `gated` has the probabilities of gates: one for
    all sensors, a mapping from sensors to theirs, or None for no gates.

    An `anchor` is an artificial measurement of all components at each step, which holds beliefs
    near a point and does not count as evidence; None for none.
    `check` linearises once at each step, and refuses what is not finite: linearisations with
    LinearisationError, predictions with NumericalError.

    With `certain`, runs are hypotheses, of which a step's measurements may contradict some: see
    `Certain`, which has the numbers of the last step.

    `residuals` has one array (runs,) for each relinearisation of a step's sensors: the largest
    distance, over all steps, of a mean from where it was linearised, in standard deviations.
    `square` (*batch) is νᵀS⁻¹ν of the last step's measurements, ν being their innovation together.
    """

    square: Array | float

    def __init__(
        self,
        plan: ChainPlan,
        schedule: Filtering | None,
        *,
        keep: bool = True,
        anchor: Anchor | None = None,
        check: bool = False,
        gated: gate.Asked | None = None,
        certain: Certain | None = None,
    ) -> None:
        layout = plan.layout
        self.certain = certain
        self.gate = gated if schedule is None else schedule.gate
        self.plan, self.schedule, self.anchor, self.check = plan, schedule, anchor, check
        self.linearises, self.keeps = schedule is not None, keep and schedule is not None
        self.states = layout.state_places if layout.control_places.size else None
        self.iterates = schedule is not None and schedule.iterations > 1 and not check
        self.residuals: list[Array] = []
        self._settled: Mask | None = None

    @property
    def converged(self) -> Mask:
        """Whether the updates of all steps so far settled, or had nothing to iterate, (runs,)."""
        if self._settled is not None:
            return self._settled
        return np.full(self.plan.runs, self.plan.linear)

    def start(self) -> Moments:
        """The belief over the slice at the plan's step 0, before the measurements of that step.

        Controls, which do not exist at step 0, have zero mean and covariance. If `plan.begin` takes
        the prior's place, the result is `plan.begin`, which knows the measurements of that step
        already.
        """
        plan = self.plan
        if plan.begin is not None:
            return Moments(*plan.begin)
        size, places = plan.layout.state_size, plan.layout.state_places
        mean, cov = np.zeros((size, *plan.batch)), np.zeros((size, size, *plan.batch))
        for link in plan.prior:
            at, parents = self._at(link, 0), mean[link.parents]
            line = link.family.line(at, parents, within(cov, link.parents))
            self._extend(link, at, 0, mean, cov, parents, line)
        if self.states is None:
            return Moments(mean, cov)
        width = plan.layout.slice_size
        whole, spread = np.zeros((width, *plan.batch)), np.zeros((width, width, *plan.batch))
        whole[places] = mean
        where = np.arange(width)[places]
        spread[where[:, None], where] = cov
        return Moments(whole, spread)

    def motion(self, step: int) -> list[At]:
        """The transition's CPDs with the evidence of a step bound, parents before children."""
        return [self._at(link, step - 1) for link in self.plan.transition]

    def readings(self, step: int) -> list[Reading]:
        """The sightings of a step by sensor, to be linearised; sensors without any are left out."""
        found = []
        for sensor in self.plan.sensors:
            due = sensor.at(step, stored=not self.linearises)
            if due is not None:
                found.append(Reading(sensor, *due, fixed=not self.linearises))
        return found

    def predict(self, step: int, belief: Moments, ats: Sequence[At] | None = None) -> Moments:
        """Moments of a step's slice, from those of the one before: m ← F m + b, P ← F P Fᵀ + Q.

        F, b and the noise covariance Q are those of the linearised transition. `step`, 1..T, is
        counted from the plan's first one, as in `take`, `motion` and `readings`. With `ats`, the
        transition's CPDs bound to other evidence than the plan's, `step` is the number that errors
        name.
        """
        if ats is None:
            ats, step = self.motion(step), self.plan.first + step
        layout, (mean, cov) = self.plan.layout, belief
        if self.states is not None:
            mean, cov = mean[self.states], within(cov, self.states)
        if layout.single:
            link, at = self.plan.transition[0], ats[0]
            line = link.family.line(at, mean, cov)
            matrix, value, noise, bare = self._with_noise(link, at, mean, mean, line)
            after = gaussian.predict(cov, matrix, noise, bare)
            if self.check or (noise is not at.noise and not link.family.semidefinite):
                refusals.prediction(link, step, after, finite=self.check)
            return Moments(value, after)
        front, batch = layout.state_size, self.plan.batch
        size = front + layout.slice_size
        pair, spread = np.zeros((size, *batch)), np.zeros((size, size, *batch))
        pair[:front] = mean
        spread[:front, :front] = cov
        for link, at in zip(self.plan.transition, ats, strict=True):
            parents = pair[link.parents]
            line = link.family.line(at, parents, within(spread, link.parents))
            self._extend(link, at, step, pair, spread, parents, line)
        return Moments(pair[front:], spread[front:, front:])

    def take(
        self, step: int, belief: Moments, parts: Sequence[Reading] | None = None
    ) -> tuple[Moments, Array | float]:
        """The belief given the measurements of a step, 0..T, and their log-density (*batch).

        `belief` is the predicted one. An anchor is taken in, too, but is not in the log-density.
        With `parts`, sightings by sensor as `readings` returns them, these are taken in place of
        the plan's, and `step` is the number that errors name.
        """
        if parts is None:
            parts, step = self.readings(step), self.plan.first + step
            if not parts and self.anchor is None:
                self.square = 0.0
                return belief, 0.0
        mean, cov = belief
        schedule = self.schedule
        robust = self.plan.robust
        if schedule is not None and robust and any(part.weights is not None for part in parts):
            after, density = self._reweighed(parts, step, mean, cov, schedule)
        elif schedule is None or not self.iterates or self.plan.linear:
            several = len(parts) > 1
            seen: list[Measured] = []
            for part in parts:
                point, spread = part.below(mean, cov)
                line = part.sensor.family.line(part.at, point, spread)
                seen.append(part.measured(line, point, several))
            if self.check:
                for part in parts:
                    part.require_finite()
            if self.gate is not None:
                seen = gate.decide(self.gate, parts, seen, mean, cov)
            after, density, self.square = readings.update(seen, step, belief, self.certain)
            if robust:
                density = density + sum(part.surplus for part in parts)
        else:
            after, density = self._iterated(parts, step, mean, cov, schedule)
        if self.keeps:
            for part in parts:
                part.keep()
        return (
            after if self.anchor is None else after.held(self.anchor, step - self.plan.first)
        ), density

    def _reweighed(
        self, parts: Sequence[Reading], step: int, mean: Array, cov: Array, schedule: Filtering
    ) -> tuple[Moments, Array | float]:
        """The belief given sightings of which some are robust, and their log-density (*batch).

        N(mean, cov) is the predicted belief. After each linearisation the robust sightings are
        weighed until their weights settle. There are as many linearisations as the schedule says;
        with `check` there is one, and LinearisationError refuses it if it is not finite.
        """
        if self.check:
            for part in parts:
                part.linearise(mean, cov)
                part.require_finite()
        return self._iterated(parts, step, mean, cov, schedule if self.iterates else ONCE)

    def _iterated(
        self, parts: Sequence[Reading], step: int, mean: Array, cov: Array, schedule: Filtering
    ) -> tuple[Moments, Array | float]:
        """The belief given sightings, and their log-density (*batch).

        The sensors are relinearised, as the schedule says, until the belief settles. Gates decide
        once, at the predicted belief N(mean, cov).
        """
        if self.gate is not None:
            seen = [part.linearise(mean, cov) for part in parts]
            gate.decide(self.gate, parts, seen, mean, cov)
        found = iterated(MomentUpdate(parts, step, mean, cov, self.certain), schedule)
        self.residuals = largest(self.residuals, found.residuals)
        self._settled = (
            found.converged if self._settled is None else self._settled & found.converged
        )
        last = found.solution
        self.square = last.square
        shown = found.mean.T if self.plan.batch else found.mean[0]
        return Moments(shown, last.known.cov), last.log_density

    def _at(self, link: Link, row: int) -> At:
        """A CPD with the evidence of a step: `row` is t − 1 of the transition to t, 0 of the prior.

        With a schedule it is yet to be linearised, else it has its stored linearisation.
        """
        if self.linearises:
            return link.family.at(row, row + 1)
        return link.family.stored_at(row, row + 1)

    def _extend(
        self, link: Link, at: At, step: int, mean: Array, cov: Array, parents: Array, line: Line
    ) -> None:
        """Write a CPD's child into the joint moments of what stands before it, in place.

        `mean` and `cov` are the moments of the vector in which `link` has its places. The parents'
        are there already; the child's mean, covariance, and covariances with all other components
        are added. `line` is the CPD's linearisation at the mean `parents`; `step` is the number
        that errors name.
        """
        matrix, value, noise, bare = self._with_noise(link, at, mean, parents, line)
        gaussian.extend(mean, cov, link.child, link.parents, matrix, value, noise, bare)
        if self.check or (noise is not at.noise and not link.family.semidefinite):
            own = cov[link.child, link.child]
            refusals.prediction(link, step, own, finite=self.check)

    def _with_noise(
        self, link: Link, at: At, before: Array, mean: Array, line: Line
    ) -> tuple[Array, Array, Array, tuple[int, ...]]:
        """A CPD as y = F x + b + noise, by its linearisation at a mean of its parents x.

        x has m components, the child y has d; `mean` is (m, *batch). `before` is the vector with
        the states of the step before: an angle that the function wraps is moved to within half a
        turn of its value there. Returns, in this order:

        - F (d, m, *batch);
        - the child's mean, F `mean` + b, (d, *batch);
        - the noise covariance with the approximation error, (d, d, *batch);
        - the numbers of the child's components that have no noise.
        """
        family, bare = link.family, link.family.bare
        matrix, value, error = line
        if self.check and at.function is not None:
            require_finite(family, at.function, mean, line)
        noise = at.noise
        if error is not None:
            noise = noise + error
            bare = tuple(k for k in bare if not noise[k, k].any())
        if at.function is not None:
            # A function may return an array that it uses again.
            if link.turning and turns_far(link, before, value):
                value = on_chart(link, at, before, value)
            if value is line.value:
                value = value.copy()
            if self.keeps:
                offset = value - times(matrix, mean)
                family.keep(at, matrix, offset, None if error is None else noise)
        return matrix, value, noise, bare


def turns_far(link: Link, before: Array, value: Array) -> bool:
    """Whether some angle of a child is more than half a turn from where it was a step before.

    `value` (d, *batch) is the child's. `before` is the pair, or the states of the step before
    alone: at the places `link.before` it has the same angles a step before.
    """
    if value.ndim == 1:
        for new, old in link.turning:
            if abs(value.item(new) - before.item(old)) > _HALF_TURN:
                return True
        return False
    return any(
        bool((np.abs(value[new] - before[old]) > _HALF_TURN).any()) for new, old in link.turning
    )


def on_chart(link: Link, at: At, before: Array, value: Array) -> Array:
    """The value of a CPD's function, `value` (d, *batch), with wrapped angles moved to the chart.

    `at` has the function. `before` is the pair, or the states of the step before alone: at the
    places `link.before` it has the same angles a step before. The function wraps an angle if the
    angle's value stays the same when all angles at these places are moved by a whole turn. In the
    result a wrapped angle is within half a turn of itself a step before; other components stay.
    """
    assert at.function is not None
    # A function that wraps gives the same for an angle a whole turn on; another turns too.
    further = before.copy()
    further[link.before] += TURN
    ends = [at.function(components_last(x[link.parents], 1)) for x in (further, before)]
    gained = components_first(ends[0] - ends[1], 1)
    wraps = np.abs(gained[link.angles]) < 0.5 * TURN
    moved = value.copy()
    near = nearest(value[link.angles], before[link.before])
    moved[link.angles] = np.where(wraps, near, value[link.angles])
    return moved


def largest(record: list[Array], residuals: Iterable[Array]) -> list[Array]:
    """The larger ones of two lists of residuals, entry by entry.

    A step's residuals are the distances of its means from where they were linearised, an array
    (runs,) for each relinearisation. `record` has the largest ones of the steps so far, `residuals`
    those of one more step. The shorter list, whose steps settled earlier, is continued with its
    last residual; an empty one does not count.
    """
    residuals = list(residuals)
    if not record or not residuals:
        return record or residuals
    length = max(len(record), len(residuals))
    ours, others = (each + each[-1:] * (length - len(each)) for each in (record, residuals))
    return [np.maximum(a, b) for a, b in zip(ours, others, strict=True)]
