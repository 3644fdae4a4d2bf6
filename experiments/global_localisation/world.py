"""A robot in a house: its map, its motion, its scans, and drives through the rooms."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
import pgm.maps
from experiments.global_localisation.paths import Paths, along
from experiments.house import House
from models import motion
from models.networks import pose

Array = npt.NDArray[np.float64]

# What the odometer says: forward and left [m], turned [rad].
moved = pgm.Variable("u", components=("forward", "left", "turn"))
BEAMS, MOST = 36, 10.0  # all round, and how far they see [m]
ANGLES = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
scan = pgm.Variable("z", components=tuple(f"beam {k}" for k in range(BEAMS)))
STEP = 0.4  # m
# Of the odometer, a step [m, m, rad]: half a cell of the grid, which then adds no variance.
MOTION_STD = (0.1, 0.1, np.deg2rad(3.75))
# The laser as it is: deviation [m], and the shares of ranges. With 5 m, and a tenth of the beams
# on what is not on the map, a likelihood field is misled: of 40 drives the grid found a quarter to
# a third, particles a tenth.
LASER: dict[str, Any] = {"std": 0.05, "hit": 0.95, "short": 0.02, "maximum": 0.01, "random": 0.02}


@dataclass(frozen=True, eq=False)
class Drives:
    """Drives, and what was measured on them.

    Attributes
    ----------
    truth : ndarray
        (runs, T+1, 3): poses [m, m, rad].
    odometry : ndarray
        (runs, T, 3).
    scans : ndarray
        (runs, T+1, beams): ranges [m].
    """

    truth: Array
    odometry: Array
    scans: Array

    @property
    def steps(self) -> int:
        """T."""
        return int(self.odometry.shape[1])

    def some(self, runs: slice, first: int = 0) -> Drives:
        """Some of the drives, from a step on."""
        return Drives(
            self.truth[runs, first:], self.odometry[runs, first:], self.scans[runs, first:]
        )


class World:
    """The house as the robot's map.

    Parameters
    ----------
    house : House
    """

    def __init__(self, house: House) -> None:
        self.indoors = house.indoors
        self.map = pgm.maps.OccupancyMap(house.occupied, house.resolution, (*house.origin, 0.0))

    @cached_property
    def paths(self) -> Paths:
        """Where the robot may drive."""
        return Paths(self.map, self.indoors)

    @cached_property
    def laser(self) -> pgm.maps.BeamModel:
        """The laser that scans are drawn of."""
        return pgm.maps.BeamModel(scan, pose, self.map, angles=ANGLES, most=MOST, **LASER)

    def network(
        self, sensor: pgm.maps.LikelihoodField | pgm.maps.BeamModel
    ) -> pgm.DynamicBayesianNetwork:
        """The robot, which may be anywhere in the house, with a model of its laser."""
        return pgm.DynamicBayesianNetwork(
            prior=[self.map.uniform(pose, self.indoors)],
            transition=[
                pgm.NonlinearGaussianCPD(
                    pose,
                    given=(pose.previous, moved),
                    function=motion.increment,
                    cov=np.diag(np.square(MOTION_STD)),
                    jacobian={
                        pose.previous: motion.increment_by_state,
                        moved: motion.increment_by_control,
                    },
                )
            ],
            observation=[sensor],
        )

    def drives(self, runs: int, steps: int, rng: np.random.Generator) -> Drives:
        """Drives between random places, and what odometer and laser say of them."""
        truth = np.stack(
            [along(self.paths.draw(STEP * steps, rng), STEP, steps) for _ in range(runs)]
        )
        return self.measured(truth, odometry(truth, rng), rng)

    def measured(self, truth: Array, steps: Array, rng: np.random.Generator) -> Drives:
        """Drives with the scans on them."""
        return Drives(truth, steps, self.laser.sample({pose: truth}, rng=rng))


def odometry(truth: Array, rng: np.random.Generator) -> Array:
    """Steps (runs, T, 3) from each pose, seen from there, as the model has them.

    The motion's noise is what the odometer did not tell: the steps lead from each pose to the next
    less the noise.
    """
    before, after = truth[:, :-1], truth[:, 1:]
    away = after - before - rng.normal(size=after.shape) * MOTION_STD
    cos, sin = np.cos(before[..., 2]), np.sin(before[..., 2])
    forward = cos * away[..., 0] + sin * away[..., 1]
    left = cos * away[..., 1] - sin * away[..., 0]
    return np.stack([forward, left, away[..., 2]], axis=-1)
