"""Every second scan makes a map, and the others are to be found in it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.killian.graph import reckoned
from experiments.killian.log import Log
from models import motion
from models.networks import pose
from pgm.cpds import CPD
from pgm.errors import FileError
from pgm.maps import LikelihoodField, OccupancyMap, log_odds_map

Array = npt.NDArray[np.float64]

LEAST = 20  # poses
RESOLUTION = 0.1  # m
START_STD = (0.05, 0.05, 0.02)  # m, m, rad
# Of the scans' likelihood: the deviation of rays' ends from the map [m], twice as wide where cells
# of a quarter or half a metre are searched; one ray in so many is used, and of these a tenth count
# as independent.
STD, STRAY_STD, EVERY, WEIGHT = 0.1, 0.2, 3, 0.1
# A motion from scan to scan.
step_made = pgm.Variable("u", components=("ahead", "left", "turn"))


@dataclass(frozen=True, eq=False)
class Drive:
    """A recording as a map and a drive through it.

    Attributes
    ----------
    log : Log
    map : OccupancyMap
        Of the scans 0, 2, 4 ... at their poses.
    seconds : float
        What the map took.
    poses : ndarray
        (T+1, 3): those of the scans 1, 3, 5 ..., which are to be found.
    scans : ndarray
        (T+1, rays): ranges [m].
    motions : ndarray
        (T, 3): between these, of the two edges each, ahead [m], to the left [m], turned [rad].
    cov : ndarray
        (3, 3): of such a motion, as the edges tell it.
    """

    log: Log
    map: OccupancyMap
    seconds: float
    poses: Array
    scans: Array
    motions: Array
    cov: Array

    @cached_property
    def scan(self) -> pgm.Variable:
        """The scan, one component a ray."""
        rays = len(self.log.angles)
        return pgm.Variable("z", components=tuple(f"ray {k}" for k in range(rays)))

    @cached_property
    def within(self) -> npt.NDArray[np.bool_]:
        """The mask of the map's free cells that a robot can get to, from where the drive began."""
        return self.map.connected(self.log.poses[0, :2])

    @cached_property
    def dead_reckoning(self) -> Array:
        """The path (T+1, 3) that the motions alone make."""
        return reckoned(self.poses[0], self.motions)

    @cached_property
    def distance(self) -> Array:
        """How far the robot had driven, (T+1,) [m]."""
        steps = np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    def field(self, std: float) -> LikelihoodField:
        """The sensor: a scan by where its rays end in the map."""
        return LikelihoodField(
            self.scan,
            pose,
            self.map,
            angles=self.log.angles,
            most=self.log.most,
            std=std,
            every=EVERY,
            weight=WEIGHT,
        )

    def network(self, prior: CPD | None = None) -> pgm.DynamicBayesianNetwork:
        """Motions and scans, from the first pose, or from a prior of it."""
        known = pgm.GaussianCPD(pose, self.poses[0], np.diag(np.square(START_STD)))
        moved = pgm.NonlinearGaussianCPD(
            pose, (pose.previous, step_made), motion.increment, cov=self.cov
        )
        field = self.field(STD if prior is None else STRAY_STD)
        return pgm.DynamicBayesianNetwork([prior or known], [moved], [field])

    def evidence(self, first: int = 0, last: int | None = None) -> dict[pgm.Variable, Any]:
        """Motions and scans of the steps from one to another, which become 0, 1, 2 ..."""
        scans = self.scans[first : None if last is None else last + 1]
        return {
            step_made: self.motions[first:last],
            self.scan: pgm.sightings(scans, step=np.arange(len(scans))),
        }


def driven(log: Log) -> Drive:
    """Halve a recording.

    Parameters
    ----------
    log : Log

    Raises
    ------
    FileError
        If there are fewer than twenty poses, or not one edge from each to the next.
    """
    motions, cov = _between(log)
    began = time.perf_counter()
    found = log_odds_map(
        log.poses[::2], log.scans[::2], log.angles, resolution=RESOLUTION, most=log.most
    )
    seconds = time.perf_counter() - began
    poses = log.poses[1::2]
    steps = len(poses) - 1
    # The second motion's error is that of its own frame, turned by up to half a turn: deviations
    # ahead and to the left are alike, and a turn's error moves the next half metre by millimetres.
    pairs = motion.increment(motions[1::2][:steps], motions[2::2][:steps])
    return Drive(log, found, seconds, poses, log.scans[1::2], pairs, 2.0 * cov)


def _between(log: Log) -> tuple[Array, Array]:
    """The motions (N − 1, 3) from each pose to the next, and the covariance of one."""
    edges, steps = log.edges, len(log.poses) - 1
    chosen = np.flatnonzero(edges.second - edges.first == 1)
    chosen = chosen[np.argsort(edges.first[chosen], kind="stable")]
    if steps < LEAST - 1 or edges.first[chosen].tolist() != list(range(steps)):
        raise FileError(
            f"the recording has {steps + 1} poses and {len(chosen)} edges from one to the next; "
            f"{LEAST} poses or more, and one edge between each two, were due"
        )
    covs = np.linalg.inv(edges.information[chosen])
    return edges.motions[chosen], covs.mean(axis=0)
