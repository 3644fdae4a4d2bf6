"""The readings of a step taken into a belief: linearised once, or again at what they say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.inference.chain import cost
from pgm.inference.chain.iteration import Anchor, Point, iterate
from pgm.inference.chain.plan import Sensor
from pgm.inference.chain.update import Due, linearise_sensor, sensors_due, update
from pgm.inference.schedule import Filtering
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Mask, inner


class Taken(NamedTuple):
    """What readings make of the belief at a step.

    Attributes
    ----------
    mean, cov : ndarray
        (runs, n), (runs, n, n).
    log_density : ndarray
        (runs,): of the readings.
    residuals : list of ndarray
        (runs,) for each relinearisation.
    converged : ndarray of bool
        (runs,).
    """

    mean: Array
    cov: Array
    log_density: Array
    residuals: list[Array]
    converged: Mask


def take(sensors: list[Sensor], step: int, mean: Array, cov: Array, schedule: Filtering) -> Taken:
    """Take the readings of a step into the predicted belief."""
    due = sensors_due(sensors, step)
    for sensor, _ in due:
        linearise_sensor(sensor, step, mean, cov)
    once = update(due, step, mean, cov)
    nothing = np.full(mean.shape[0], all(sensor.family.exact for sensor, _ in due))
    if schedule.iterations == 1 or nothing.all():
        return Taken(*once, [], nothing)
    reading = _Reading(due, step, mean, cov)
    predicted = Point(mean[None], cov[None])
    result = iterate(reading, _Updated(*once), schedule, nothing, predicted)
    last = result.solution
    return Taken(result.mean[0], last.cov, last.log_density, result.residuals, result.converged)


class _Updated(NamedTuple):
    """The belief that an update leaves, and the log-density of its readings."""

    mean: Array
    cov: Array
    log_density: Array

    @property
    def means(self) -> Array:
        return self.mean[None]

    @property
    def point(self) -> Point:
        return Point(self.mean[None], self.cov[None])


@dataclass(frozen=True, eq=False)
class _Reading:
    """The readings of a step, to be linearised anywhere and taken into the predicted belief."""

    due: Due
    step: int
    mean: Array
    cov: Array

    def linearise(self, at: Point, active: Mask) -> None:
        for sensor, _ in self.due:
            linearise_sensor(sensor, self.step, at.mean[0], at.cov[0], active)

    def solve(self, anchor: Anchor | None = None) -> _Updated:
        mean, cov, log_density = update(self.due, self.step, self.mean, self.cov)
        if anchor is not None:
            mean, cov = anchor.hold(0, mean, cov)
        return _Updated(mean, cov, log_density)

    def cost(self, at: Point) -> Array:
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
