"""The package amcl, Nav2's Monte Carlo localisation in C++ with bindings: whole steps of it.

Its sensor cannot be called alone. Its model is another one: it has shares of short and of largest
ranges too, which are none here, rejects outliers, and its noise is in proportion to the motion; so
it finds nearly the same pose only.
"""

from __future__ import annotations

import amcl
import numpy as np

from benchmarks.timing import Contender
from benchmarks.work.scans import EVERY, HIT, RANDOM, START_STD, STD, Array, Scans
from experiments.killian.made_up import MOST

OCCUPIED = 100
ALPHAS = (0.01,) * 5
LAMBDA, OUTLIER = 0.1, 0.05


def filtering(work: Scans) -> Contender:
    """The mean at the last step, of as many particles at each."""
    rays = len(work.angles)
    assert work.beams == 1 + (rays - 1) // EVERY
    robot = amcl.AMCL(
        work.count,
        work.count,
        0.0,
        0.0,
        amcl.MotionParameters(*ALPHAS),
        amcl.LaserParameters(HIT, 0.0, 0.0, RANDOM, STD, LAMBDA, OUTLIER, work.beams),
        "differential",
    )
    cells = np.where(work.map.obstacles, OCCUPIED, 0).tolist()
    east, north, _ = work.map.origin.tolist()
    robot.set_map(amcl.create_occupancy_grid_from_list(cells, work.map.resolution, east, north))
    robot.set_laser_pose(amcl.Vector3D(0.0, 0.0, 0.0))
    start = amcl.create_diagonal_covariance(*np.square(START_STD).tolist())
    poses = [amcl.Vector3D(*each) for each in work.poses.tolist()]
    scans = [
        amcl.create_laser_scan_from_list(np.stack([each, work.angles], axis=1).tolist(), MOST)
        for each in work.scans
    ]

    def call() -> Array:
        robot.set_initial_pose(poses[0], start)
        for scan, pose in zip(scans, poses, strict=True):
            robot.update(scan, pose)
        found = robot.get_pose_mean()
        return np.array([found.x, found.y, found.theta])

    return Contender(call, work.units)
