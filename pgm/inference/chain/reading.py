"""The readings of a step taken into a belief: linearised once, or again at what they say."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from pgm.inference.chain import cost
from pgm.inference.chain.iteration import Anchor, Point, iterate
from pgm.inference.chain.update import Due, linearise_sensor, update
from pgm.inference.schedule import Filtering
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Mask, inner


@dataclass(frozen=True, eq=False)
class Updated:
    """The belief that an update leaves, and the log-density of its readings.

    Attributes
    ----------
    mean, cov : ndarray
        (runs, n), (runs, n, n).
    log_density : ndarray
        (runs,).
    """

    mean: Array
    cov: Array
    log_density: Array

    @property
    def means(self) -> Array:
        """With an axis of steps."""
        return self.mean[None]

    @property
    def point(self) -> Point:
        """Its moments."""
        return Point(self.mean[None], self.cov[None])


U = TypeVar("U", bound=Updated, covariant=True)


@dataclass(frozen=True, eq=False)
class Taken(Generic[U]):
    """The belief at a step given its readings.

    Attributes
    ----------
    solution : Updated
        Of the last linearisation.
    mean : ndarray
        (runs, n): its mean, or that which the step control kept.
    residuals : list of ndarray
        (runs,) for each relinearisation.
    converged : ndarray of bool
        (runs,).
    """

    solution: U
    mean: Array
    residuals: list[Array]
    converged: Mask


@dataclass(frozen=True, eq=False)
class Reading(ABC, Generic[U]):
    """The readings of a step, to be linearised anywhere and taken into the predicted belief.

    Attributes
    ----------
    due : list
        The sensors that read at the step, with the rows of their readings.
    step : int
    mean, cov : ndarray
        (runs, n), (runs, n, n): the predicted belief.
    """

    due: Due
    step: int
    mean: Array
    cov: Array

    def linearise(self, at: Point, active: Mask | None) -> None:
        """Linearise each sensor, for the runs that are active."""
        for sensor, _ in self.due:
            linearise_sensor(sensor, self.step, at.mean[0], at.cov[0], active)

    @abstractmethod
    def solve(self, anchor: Anchor | None = None) -> U:
        """The belief given the readings as they are linearised."""

    def cost(self, at: Point) -> Array:
        """The cost of means, (runs,)."""
        white = roots.whiten(roots.root(self.cov), at.mean[0] - self.mean)
        total = inner(white, white)
        for sensor, rows in self.due:
            count = rows.stop - rows.start
            mean = np.broadcast_to(at.mean, (count, *at.mean.shape[1:]))
            cov = np.broadcast_to(at.cov, (count, *at.cov.shape[1:]))
            total = total + cost.readings(sensor, rows, mean, cov)
        return total

    def feasible(self, mean: Array, found: Point) -> Array:
        """The predicted means, given the exact readings alone."""
        exact = [(sensor, rows) for sensor, rows in self.due if sensor.exact]
        return update(exact, self.step, mean[0], self.cov)[0][None]


@dataclass(frozen=True, eq=False)
class MomentReading(Reading[Updated]):
    """Readings taken in as one vector, in float64."""

    def solve(self, anchor: Anchor | None = None) -> Updated:
        """The belief given the readings as they are linearised."""
        mean, cov, log_density = update(self.due, self.step, self.mean, self.cov)
        if anchor is not None:
            mean, cov = anchor.hold(0, mean, cov)
        return Updated(mean, cov, log_density)


def take(reading: Reading[U], schedule: Filtering) -> Taken[U]:
    """Take the readings of a step into the predicted belief, as often linearised as is due."""
    due, predicted = reading.due, Point(reading.mean[None], reading.cov[None])
    reading.linearise(predicted, None)
    once = reading.solve()
    nothing = np.full(once.mean.shape[0], all(sensor.family.exact for sensor, _ in due))
    if schedule.iterations == 1 or nothing.all():
        return Taken(once, once.mean, [], nothing)
    result = iterate(reading, once, schedule, nothing, predicted)
    return Taken(result.solution, result.mean[0], result.residuals, result.converged)
