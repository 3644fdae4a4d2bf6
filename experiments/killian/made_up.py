"""A small drive that was never made: twice around a block of corridors, recorded as the real one.

For tests, and where the recording is not installed.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from experiments.killian.graph import fitted
from experiments.killian.log import Log
from models import motion
from pgm.maps import OccupancyMap
from pgm.recordings import Edges

Array = npt.NDArray[np.float64]

RAYS, MOST = 180, 50.0
RANGE_STD = 0.03  # m
MOTION_STD = (0.02, 0.02, 0.005)  # m, m, rad
STRIDE, LAP = 0.5, 68  # m, poses a lap
WIDE, HIGH = 12.0, 6.0  # of the rectangle that is driven [m]


def drive(seed: int) -> Log:
    """Two laps, of which the second meets the places of the first.

    Parameters
    ----------
    seed : int
    """
    rng = np.random.default_rng(seed)
    truth = _path(2 * LAP)
    angles = np.radians(np.arange(RAYS) - 90.0)
    scans = building().cast(truth, angles, MOST)
    scans = np.clip(scans + rng.normal(scale=RANGE_STD, size=scans.shape), 0.0, MOST)
    first = np.concatenate([np.arange(2 * LAP - 1), np.arange(0, LAP, 4)])
    second = np.concatenate([np.arange(1, 2 * LAP), np.arange(LAP, 2 * LAP, 4)])
    motions = motion.relative(truth[first], truth[second])
    motions[:, 2] = (motions[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    motions += rng.normal(scale=MOTION_STD, size=motions.shape)
    information = np.tile(np.diag(1.0 / np.square(MOTION_STD)), (len(first), 1, 1))
    edges = Edges(first, second, motions, information)
    poses = fitted(Log(truth, scans, angles, MOST, edges)).poses
    poses[:, 2] = (poses[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    return Log(poses, scans, angles, MOST, edges)


def building() -> OccupancyMap:
    """Corridors around a block, with niches that no two places have alike."""
    walls = np.zeros((100, 160))
    walls[[0, 1, -2, -1]] = walls[:, [0, 1, -2, -1]] = 1.0
    walls[30:70, 30:130] = 1.0
    walls[50:70, 40:52] = walls[30:40, 100:112] = walls[44:60, 120:130] = 0.0
    walls[2:8, 70:74] = walls[-12:-2, 110:113] = walls[20:30, 2:7] = walls[80:83, 2:10] = 1.0
    return OccupancyMap(walls, resolution=0.1, origin=(-2.0, -2.0, 0.0))


def _path(count: int) -> Array:
    """Poses along a rectangle with round corners, anticlockwise."""
    radius = 1.0
    straight = (WIDE - 2.0 * radius, HIGH - 2.0 * radius)
    bend = 0.5 * np.pi * radius
    lap = 2.0 * (sum(straight) + 2.0 * bend)
    found = []
    for along in np.arange(count) * lap / LAP:
        place, heading, left = np.array([radius, 0.0]), 0.0, along % lap
        for side in (*straight, *straight):
            ahead = np.array([np.cos(heading), np.sin(heading)])
            place = place + min(left, side) * ahead
            left -= side
            if left <= 0.0:
                break
            turn = min(left, bend) / radius
            aside = np.array([-ahead[1], ahead[0]])
            place = place + radius * (np.sin(turn) * ahead + (1.0 - np.cos(turn)) * aside)
            heading += turn
            left -= bend
            if left <= 0.0:
                break
        found.append([*place, heading])
    return np.array(found)
