"""A step's measurement update as an iterated problem: linearised at any point, and solved.

A *slice* is the vector of all hidden variables of a step, of n components; a *sighting* is one
measurement by a sensor, of which a step may have several. The predicted belief N(m, P) of a slice
is conditioned on the sightings of its step, z = h(x) + noise. `iterate` linearises h at a point (a
`Point`, whose mean is (1, runs, n)), solves the linear problem, and goes on at the solution. In a
sweep arrays have their components first and the runs last, (n, *batch), `batch` being () for one
run and (runs,) for several. A *plan* has the CPDs with their evidence, and stores how they were
linearised. The *branch* of a measured angle is its value among those that differ by whole turns.

A sighting with robust noise counts as a Gaussian of covariance R / w, R being the noise covariance
and w the sighting's weight. Its *surplus* is the robust log-density less that of this Gaussian. An
*anchor* is an artificial measurement of all components, by which a step control
(Levenberg–Marquardt) holds a tried solution near a point; it does not count as evidence.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.steps import readings
from pgm.beliefs.moments.steps.readings import Certain, Moments, Reading
from pgm.beliefs.moments.steps.vector import Measured
from pgm.errors import NumericalError
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Kind, Mask, components_first, components_last, independent
from pgm.kernels.settling import REWEIGHINGS, SETTLED, TOLERANCE
from pgm.linearisation import costs
from pgm.schedules.iteration import Anchor, Point, Solution, iterate
from pgm.schedules.schedule import Filtering


@dataclass(frozen=True, eq=False)
class Updated:
    """The belief given a step's measurements: moments (n, *batch), (n, n, *batch) in `known`.

    `log_density` (*batch) is that of the measurements under the predicted belief, in nats, and
    `square` (*batch) is νᵀS⁻¹ν of their innovation ν.
    """

    known: Moments
    log_density: Array | float
    square: Array | float

    @property
    def means(self) -> Array:
        """The mean, (1, runs, n)."""
        return _as_point(self.known.mean, 1)

    @property
    def point(self) -> Point:
        """The belief's moments as a linearisation point."""
        return Point(self.means, _as_point(self.known.cov, 2))


U = TypeVar("U", bound=Solution)


@dataclass(frozen=True, eq=False)
class IteratedUpdate(Generic[U]):
    """The belief at a step after its last linearisation, and how the iteration went.

    `solution`, of a type `U` such as `Updated`, is the belief found with the last linearisation,
    with the measurements' log-density. `mean` (runs, n) is its mean, or the one that a step control
    kept instead. `residuals` has for each relinearisation the largest distance of a mean from where
    it was linearised, in standard deviations, (runs,). `converged` (runs,) marks runs that settled,
    or had nothing to iterate.
    """

    solution: U
    mean: Array
    residuals: list[Array]
    converged: Mask


class UpdateProblem(ABC, Generic[U]):
    """The update of a predicted belief with the measurements of its step, for `iterate`.

    `parts` has the step's sightings, one `Reading` for each sensor that has any; `step` is the
    step's number, which errors name; `mean` (n, *batch) and `cov` (n, n, *batch) are the predicted
    moments. A solution, of type `U`, is a belief with the measurements' log-density. `certain` is
    as of `readings.update`.
    """

    def __init__(
        self,
        parts: Sequence[Reading],
        step: int,
        mean: Array,
        cov: Array,
        certain: Certain | None = None,
    ) -> None:
        self.parts, self.step, self.mean, self.cov = parts, step, mean, cov
        self.certain = certain
        # Whether the weights of robust noise have settled, (runs,).
        self._weighed: Mask | bool = True

    @property
    def predicted(self) -> Point:
        """The predicted belief, as a point of linearisation."""
        return Point(_as_point(self.mean, 1), _as_point(self.cov, 2))

    @property
    def measured(self) -> list[Measured]:
        """The sightings of each of `parts`, in their order, as they were linearised last."""
        return [part.seen for part in self.parts]

    def keep(self) -> None:
        """Store the linearisations, robust weights and branches of measured angles in the plan."""
        for part in self.parts:
            part.keep()

    def linearise(self, at: Point, active: Mask | None) -> None:
        """Linearise each sensor at a point, in the `active` runs (runs,); None means all."""
        mean, cov = self._moments(at)
        some = None if active is None or active.all() else active
        for part in self.parts:
            self.move(part, mean, cov, some)

    def move(self, part: Reading, mean: Array, cov: Array, active: Mask | None) -> None:
        """Linearise the sightings of one sensor, `part`; the result is stored as `part.seen`.

        They are linearised at the belief over the slice that has the moments `mean` (n, *batch) and
        `cov` (n, n, *batch). Runs that are not `active` (runs,) keep their linearisations; None
        means all are active. Subclasses whose covariances may be infinite override this method.
        """
        part.linearise(mean, cov, active)

    def solve(self, anchor: Anchor | None = None) -> U:
        """The belief given the measurements as linearised, and the anchor's if there is one.

        Robust sightings are weighed anew at each belief found, at most 200 times, until no weight
        moves by more than 10⁻¹⁰. The log-density then includes their surplus. An anchor is given
        when a step control tries a step, and a try is to leave no trace: the weights are afterwards
        those from before the call.
        """
        found = self._solved(anchor)
        if not any(part.sensor.robust for part in self.parts):
            return found
        robust = [part for part in self.parts if part.weights is not None]
        before = [(copy(part.weights), part.seen) for part in robust]
        active = np.full(found.means.shape[1], bool(robust))
        left = np.where(active, np.inf, 0.0)
        for _ in range(REWEIGHINGS if robust else 0):
            point = found.point
            mean, cov = self._moments(point._replace(cov=point.known_cov))
            moved = [part.reweigh(mean, cov, active) for part in robust]
            found = self._solved(anchor)
            left = np.where(active, np.max(moved, axis=0), left)
            active = left > SETTLED
            if not active.any():
                break
        # The schedules' default tolerance: by so much a weight may still move at its fixed point.
        self._weighed = left <= TOLERANCE
        surplus = sum((part.surplus for part in self.parts), 0.0)
        if anchor is not None:  # a try of a step control, which leaves no trace
            for part, (weights, seen) in zip(robust, before, strict=True):
                part.weights, part.seen = weights, seen
        return self.raised(found, surplus)

    def settled(self) -> Mask | bool:
        """Whether no robust weight moved by more than 10⁻⁶ when `solve` last stopped, (runs,).

        True where no noise is robust, and before the first call of `solve`.
        """
        return self._weighed

    def _solved(self, anchor: Anchor | None) -> U:
        """The belief given the measurements as linearised, and the anchor's, if it is not None.

        Robust weights stay as they are. If the update (`taken_in`) raises NumericalError, and some
        sensor's linearisation has NaN or infinity, the LinearisationError for that sensor is raised
        instead.
        """
        try:
            return self.taken_in(anchor)
        except NumericalError:
            for part in self.parts:
                part.require_finite()
            raise

    @abstractmethod
    def taken_in(self, anchor: Anchor | None) -> U:
        """The belief given the measurements as linearised, and the anchor's, if it is not None.

        The weights of robust sightings stay as they are. Raises NumericalError if the predictive
        covariance is indefinite or not finite, or if a measurement contradicts an exact model.
        """

    @abstractmethod
    def raised(self, found: U, surplus: Array | float) -> U:
        """The same belief, with `surplus` (*batch) added to the measurements' log-density."""

    def cost(self, at: Point) -> Array:
        """The cost of a point's means x: −2 ln p(x, measurements) but for constants, (runs,).

        The predicted belief N(m, P) costs (x − m)ᵀ P⁺ (x − m), ⁺ being the pseudo-inverse; each
        sensor adds rᵀ R⁺ r, or twice its losses, 2 ρ, if its noise is robust. The residual is
        r = z − E[h(X)], angles wrapped, with X ~ N(x, the point's covariance). R is the covariance
        of the noise with the last linearisation's error. Missing components and those of infinite
        variance in P do not count. The cost is NaN where h is not defined, and where P is
        indefinite.
        """
        mean, cov = self._moments(at)
        total = costs.squares(at.mean - _as_point(self.mean, 1), _as_point(self.cov, 2))
        if total is None:
            total = np.full(at.mean.shape[1], np.nan)
        for part in self.parts:
            seen = part.seen
            family = seen.sensor.family
            expected = part.expected(mean, cov)
            left = _as_point(part.values - expected, 1)
            angles = np.tile(family.cpd.child.angle_mask, len(expected) // family.shape[2])
            left = difference(left, np.zeros_like(left), angles)
            if part.weights is not None:
                total = total + part.loss(left[0], at.known_cov[0])
                continue
            noise = _as_point(seen.noise, 2)
            if seen.taken is not None:
                taken = _as_point(seen.taken, 1)
                left, noise = np.where(taken, left, 0.0), independent(noise, taken)
            total = total + costs.weighted(family, left, noise)
        return total

    def feasible(self, mean: Array, found: Point) -> Array:
        """The means `mean` (1, runs, n), moved to where the exact measurements hold.

        There their cost is finite. The result is the mean of N(`mean`, P), with the predicted
        covariance P, conditioned on the sightings of those sensors alone whose noise is singular.
        `found`, the solution as a point, is an argument of every problem for `iterate`; here its
        values do not count.
        """
        exact = [seen for seen in self.measured if seen.sensor.exact]
        first = self._moments(found._replace(mean=mean))[0]
        tried = None if self.certain is None else Certain()
        known = readings.update(exact, self.step, Moments(first, self.cov), tried).moments
        return _as_point(known.mean, 1)

    def _moments(self, at: Point) -> tuple[Array, Array]:
        """A point's mean (n, *batch) and covariance (n, n, *batch), in the axes of a sweep."""
        if self.mean.ndim == 1:
            return at.mean[0, 0], at.cov[0, 0]
        return components_first(at.mean[0], 1), components_first(at.cov[0], 2)


class MomentUpdate(UpdateProblem[Updated]):
    """The update of a predicted belief, given as mean and covariance, in float64.

    The measurements of the step are stacked to one vector and taken in together, or, where their
    joint predictive covariance is nearly singular, one after another.
    """

    def taken_in(self, anchor: Anchor | None) -> Updated:
        """The belief given the measurements as linearised, and the anchor's, if it is not None.

        The anchor's measurement is not in the log-density.
        """
        belief = Moments(self.mean, self.cov)
        found = readings.update(self.measured, self.step, belief, self.certain)
        known = found.moments if anchor is None else found.moments.held(anchor, 0)
        return Updated(known, found.log_density, found.square)

    def raised(self, found: Updated, surplus: Array | float) -> Updated:
        """The same belief, with `surplus` (*batch) added to the measurements' log-density."""
        return replace(found, log_density=found.log_density + surplus)


def _as_point(array: npt.NDArray[Kind], own: int) -> npt.NDArray[Kind]:
    """An array with the runs last, (..., *batch), turned into (1, runs, ...), as in a `Point`.

    `own` is the number of the axes "...", such as 2 for a covariance. The first axis of a `Point`
    is that of steps, of which there is one here.
    """
    if array.ndim == own:
        return array[None, None]
    return components_last(array, own)[None]


def iterated(reading: UpdateProblem[U], schedule: Filtering) -> IteratedUpdate[U]:
    """Solve an update problem, `reading`, and relinearise its sensors until the solution settles.

    The sensors are linearised at the predicted belief first, and each further time at the solution
    before, or where the schedule's damping puts the next point. Each solution conditions the
    predicted belief anew, so that no measurement counts twice. A run ends when no mean is more than
    `schedule.tolerance` standard deviations from where it was linearised and its robust weights
    have settled; all end after `schedule.iterations` linearisations. Where all sensors are affine
    there is one linearisation.
    """
    predicted = reading.predicted
    reading.linearise(predicted, None)
    once = reading.solve()
    linear = all(part.sensor.family.exact for part in reading.parts)
    nothing = np.full(predicted.mean.shape[1], linear) & reading.settled()
    if schedule.iterations == 1 or linear:
        return IteratedUpdate(once, once.means[0], [], nothing)
    result = iterate(reading, once, schedule, nothing, predicted)
    return IteratedUpdate(result.solution, result.mean[0], result.residuals, result.converged)
