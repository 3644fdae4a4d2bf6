"""A robot with a laser in a known map: particles, and the likelihood field of its scans."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.killian import made_up
from models import motion
from models.networks import pose
from pgm.maps import LikelihoodField, OccupancyMap

Array = npt.NDArray[np.float64]

STEPS = 10
EVERY = 3  # of 180 rays
START_STD = (0.1, 0.1, 0.03)  # m, m, rad
MOTION_STD = (0.05, 0.05, 0.02)
# Of the field, with the shares of rays that end at obstacles and anywhere [m].
STD, HIT, RANDOM = 0.2, 0.95, 0.05
WEIGHT = 0.1  # as if one beam in ten were independent; it costs nothing
odometry = pgm.Variable("u", components=("ahead", "left", "turn"))
scan = pgm.Variable("z", components=tuple(f"ray {k}" for k in range(made_up.RAYS)))


@dataclass(frozen=True, eq=False)
class Scans:
    """A drive in a made-up building.

    Attributes
    ----------
    map : OccupancyMap
    poses : ndarray
        (T+1, 3): the odometry's too, which both libraries believe but for its noise.
    scans : ndarray
        (T+1, rays).
    angles : ndarray
        (rays,): of the rays [rad].
    count : int
        Of particles.
    """

    map: OccupancyMap
    poses: Array
    scans: Array
    angles: Array
    count: int

    @property
    def units(self) -> int:
        """Particles times beams times scans."""
        return self.count * self.beams * len(self.scans)

    @property
    def beams(self) -> int:
        """The number of rays in use."""
        return len(self.angles[::EVERY])

    @property
    def network(self) -> pgm.DynamicBayesianNetwork:
        """Odometry, and the scans by a likelihood field."""
        start, moved = (np.diag(np.square(std)) for std in (START_STD, MOTION_STD))
        given = (pose.previous, odometry)
        field = LikelihoodField(
            scan,
            pose,
            self.map,
            angles=self.angles,
            most=made_up.MOST,
            std=STD,
            hit=HIT,
            random=RANDOM,
            every=EVERY,
            weight=WEIGHT,
        )
        return pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(pose, self.poses[0], start)],
            [pgm.NonlinearGaussianCPD(pose, given, motion.increment, moved)],
            [field],
        )

    @property
    def evidence(self) -> dict[pgm.Variable, Any]:
        """Odometry, and scans from step 0 on: the peer weighs its first particles too."""
        moved = motion.relative(self.poses[:-1], self.poses[1:])
        return {odometry: moved, scan: pgm.sightings(self.scans, step=np.arange(len(self.scans)))}


def draw(count: int) -> Scans:
    """The first steps of the made-up drive, for so many particles."""
    log = made_up.drive(0)
    steps = slice(STEPS + 1)
    return Scans(made_up.building(), log.poses[steps], log.scans[steps], log.angles, count)
