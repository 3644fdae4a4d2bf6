"""A step's measurement update as an iterated problem: linearised at any point, and solved."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from pgm.errors import NumericalError
from pgm.inference.chain import cost, readings
from pgm.inference.chain.readings import Moments, Reading
from pgm.inference.chain.vector import Measured
from pgm.inference.chain.weights import SETTLED
from pgm.inference.iteration import Anchor, Point, Solution, iterate
from pgm.inference.schedule import TOLERANCE, Filtering
from pgm.kernels import roots, solving
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Kind, Mask, components_first, components_last, inner

# Reweighings of a step's measurements at the most.
_REWEIGHINGS = 200


@dataclass(frozen=True, eq=False)
class Updated:
    """The updated belief, in a sweep's axes, and ln p of its measurements, (*batch)."""

    known: Moments
    log_density: Array | float

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
    """The belief at a step given its measurements; as `Iterated`, with means (runs, n)."""

    solution: U
    mean: Array
    residuals: list[Array]
    converged: Mask


class UpdateProblem(ABC, Generic[U]):
    """The measurements of a step, linearised anywhere and taken into the predicted N(mean, cov)."""

    def __init__(self, parts: Sequence[Reading], step: int, mean: Array, cov: Array) -> None:
        self.parts, self.step, self.mean, self.cov = parts, step, mean, cov
        # Whether weights of robust noise have settled, (runs,).
        self._weighed: Mask | bool = True

    @property
    def predicted(self) -> Point:
        """The predicted belief, as a point of linearisation."""
        return Point(_as_point(self.mean, 1), _as_point(self.cov, 2))

    @property
    def measured(self) -> list[Measured]:
        """The measurements as they were linearised last."""
        return [part.seen for part in self.parts]

    def keep(self) -> None:
        """Keep how they were linearised, in the plan."""
        for part in self.parts:
            part.keep()

    def linearise(self, at: Point, active: Mask | None) -> None:
        """Linearise each sensor, for the runs that are active."""
        mean, cov = self._moments(at)
        some = None if active is None or active.all() else active
        for part in self.parts:
            self.move(part, mean, cov, some)

    def move(self, part: Reading, mean: Array, cov: Array, active: Mask | None) -> None:
        """Linearise a sensor's measurements."""
        part.linearise(mean, cov, active)

    def solve(self, anchor: Anchor | None = None) -> U:
        """The belief given the measurements.

        Robust ones are reweighted until the weights settle.
        """
        found = self._solved(anchor)
        if not any(part.sensor.robust for part in self.parts):
            return found
        robust = [part for part in self.parts if part.weights is not None]
        before = [(copy(part.weights), part.seen) for part in robust]
        active = np.full(found.means.shape[1], bool(robust))
        left = np.where(active, np.inf, 0.0)
        for _ in range(_REWEIGHINGS if robust else 0):
            point = found.point
            mean, cov = self._moments(point._replace(cov=point.known_cov))
            moved = [part.reweigh(mean, cov, active) for part in robust]
            found = self._solved(anchor)
            left = np.where(active, np.max(moved, axis=0), left)
            active = left > SETTLED
            if not active.any():
                break
        # As of means: by so little a weight still moves at its fixed point.
        self._weighed = left <= TOLERANCE
        surplus = sum((part.surplus for part in self.parts), 0.0)
        if anchor is not None:  # a try of a step control, which leaves no trace
            for part, (weights, seen) in zip(robust, before, strict=True):
                part.weights, part.seen = weights, seen
        return self.raised(found, surplus)

    def settled(self) -> Mask | bool:
        """Whether the weights of robust noise have settled."""
        return self._weighed

    def _solved(self, anchor: Anchor | None) -> U:
        """The update about an anchor. If it fails, a reading that is not finite is named first."""
        try:
            return self.taken_in(anchor)
        except NumericalError:
            for part in self.parts:
                part.require_finite()
            raise

    @abstractmethod
    def taken_in(self, anchor: Anchor | None) -> U:
        """The belief given the measurements, which may be refused."""

    @abstractmethod
    def raised(self, found: U, surplus: Array | float) -> U:
        """The same belief, with `surplus` added to the log-density of its measurements."""

    def cost(self, at: Point) -> Array:
        """The cost of means, (runs,)."""
        mean, cov = self._moments(at)
        spread = _as_point(self.cov, 2)[0]
        white = solving.whiten(roots.root(spread), at.mean[0] - _as_point(self.mean, 1)[0])
        total: Array = inner(white, white)
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
                left = np.where(taken, left, 0.0)
                both = taken[..., None] & taken[..., None, :]
                noise = np.where(both, noise, np.eye(noise.shape[-1]))
            total = total + cost.weighted(family, left, noise)
        return total

    def feasible(self, mean: Array, found: Point) -> Array:
        """The predicted means, given the exact measurements alone."""
        exact = [seen for seen in self.measured if seen.sensor.exact]
        first = self._moments(found._replace(mean=mean))[0]
        return _as_point(readings.update(exact, self.step, Moments(first, self.cov))[0].mean, 1)

    def _moments(self, at: Point) -> tuple[Array, Array]:
        """Mean (n, [runs]) and covariance (n, n, [runs]) at a point, in this belief's axes."""
        if self.mean.ndim == 1:
            return at.mean[0, 0], at.cov[0, 0]
        return components_first(at.mean[0], 1), components_first(at.cov[0], 2)


class MomentUpdate(UpdateProblem[Updated]):
    """Measurements taken in as one vector, in float64."""

    def taken_in(self, anchor: Anchor | None) -> Updated:
        """The belief given the measurements."""
        known, density = readings.update(self.measured, self.step, Moments(self.mean, self.cov))
        return Updated(known if anchor is None else known.held(anchor, 0), density)

    def raised(self, found: Updated, surplus: Array | float) -> Updated:
        """The same belief, with `surplus` added to the log-density of its measurements."""
        return replace(found, log_density=found.log_density + surplus)


def _as_point(array: npt.NDArray[Kind], own: int) -> npt.NDArray[Kind]:
    """An array with axes (1, runs, ...), as a point of linearisation has them."""
    if array.ndim == own:
        return array[None, None]
    return components_last(array, own)[None]


def iterated(reading: UpdateProblem[U], schedule: Filtering) -> IteratedUpdate[U]:
    """Take the measurements of a step, linearised as often as is due, into the predicted belief."""
    predicted = reading.predicted
    reading.linearise(predicted, None)
    once = reading.solve()
    linear = all(part.sensor.family.exact for part in reading.parts)
    nothing = np.full(predicted.mean.shape[1], linear) & reading.settled()
    if schedule.iterations == 1 or linear:
        return IteratedUpdate(once, once.means[0], [], nothing)
    result = iterate(reading, once, schedule, nothing, predicted)
    return IteratedUpdate(result.solution, result.mean[0], result.residuals, result.converged)
