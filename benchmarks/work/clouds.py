"""A robot whose pose is known to particles: one sighting of a landmark a step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pgm
from benchmarks.work import robots
from benchmarks.work.robots import Array, Robots
from models.networks import landmark, pose, sighting, velocity

STEPS = 8
# Whose functions of motion and sensor: those of `models`, or ones that a reader would write.
FUNCTIONS = ("own", "plain")
# A start so wide, and sightings so precise, that particles are drawn anew at most steps.
START_STD = (1.0, 1.0, 0.1)
MOTION_STD = (0.1, 0.1, 0.05)
SENSOR_STD = (0.5, 0.1)


@dataclass(frozen=True, eq=False)
class Clouds:
    """A drive, and how many particles are to follow it.

    Attributes
    ----------
    robots : Robots
        One run.
    count : int
    """

    robots: Robots
    count: int

    @property
    def units(self) -> int:
        """Particles times steps."""
        return self.count * self.robots.steps

    def plain(self) -> pgm.DynamicBayesianNetwork:
        """The network of functions that a reader of the README would write."""
        network = self.robots.network
        return pgm.DynamicBayesianNetwork(
            network.prior,
            [
                pgm.NonlinearGaussianCPD(
                    pose, (pose.previous, velocity), plain_drive, self.robots.motion_cov
                )
            ],
            [
                pgm.NonlinearGaussianCPD(
                    sighting, (pose, landmark), plain_range_bearing, self.robots.sensor_cov
                )
            ],
        )


def draw(count: int, steps: int = STEPS) -> Clouds:
    """A drive of some steps, for so many particles."""
    run = robots.draw(1, steps, start_std=START_STD, motion_std=MOTION_STD, sensor_std=SENSOR_STD)
    return Clouds(run, count)


def plain_drive(x: Array, u: Array) -> Array:
    """A drive along the chord of an arc."""
    course = x[..., 2] + 0.5 * robots.DT * u[..., 1]
    ahead = robots.DT * u[..., 0]
    moved = [ahead * np.cos(course), ahead * np.sin(course), robots.DT * u[..., 1]]
    after: Array = x + np.stack(np.broadcast_arrays(*moved), axis=-1)
    return after


def plain_range_bearing(x: Array, m: Array) -> Array:
    """Range and bearing of a landmark."""
    away = m - x[..., :2]
    bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
    return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)
