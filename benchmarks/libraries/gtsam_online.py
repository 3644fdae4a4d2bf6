"""gtsam's extended Kalman filter of a pose.

The one sensor of a known landmark that it has reads it as a point in the robot's frame: each range
and bearing is turned into one, with its linearised noise. So it finds nearly what the others find.
"""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam import KnownLandmarkFactorPose2  # new in gtsam 4.3

from benchmarks.timing import Contender
from benchmarks.work.robots import DRIVE, Array, Robots


def online(work: Robots) -> Contender:
    """One robot in its loop: means (T, 3)."""
    gaussian = gtsam.noiseModel.Gaussian.Covariance
    start, motion = gaussian(work.start[1]), gaussian(work.motion_cov)
    changes = [gtsam.Pose2(*each) for each in DRIVE(np.zeros((work.steps, 3)), work.controls)]
    points, covs = _points(work.readings[0, :, 0], work.sensor_cov)
    sights = [gaussian(cov) for cov in covs]

    def call() -> tuple[Array, None]:
        means = np.empty((work.steps, 3))
        robot = gtsam.ExtendedKalmanFilterPose2(0, gtsam.Pose2(), start)
        for k in range(work.steps):
            robot.predict(gtsam.BetweenFactorPose2(k, k + 1, changes[k], motion))
            seen = KnownLandmarkFactorPose2(k + 1, work.landmarks[k, 0], points[k], sights[k])
            here = robot.update(seen)
            means[k] = here.x(), here.y(), here.theta()
        return means, None

    return Contender(call, work.steps)


def _points(readings: Array, cov: Array) -> tuple[Array, Array]:
    """Ranges and bearings as points in the robot's frame, (..., 2), with their covariances."""
    away, cos, sin = readings[..., 0], np.cos(readings[..., 1]), np.sin(readings[..., 1])
    slope = np.empty((*readings.shape, 2))
    slope[..., 0, 0], slope[..., 0, 1] = cos, -away * sin
    slope[..., 1, 0], slope[..., 1, 1] = sin, away * cos
    return slope[..., 0] * away[..., None], slope @ cov @ slope.swapaxes(-1, -2)
