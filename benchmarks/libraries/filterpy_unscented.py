"""filterpy's unscented Kalman filter; it calls functions point by point."""

from __future__ import annotations

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from benchmarks.libraries.filterpy_taylor import residual
from benchmarks.timing import Contender
from benchmarks.work.robots import DRIVE, Array, Robots
from models import sensors

# λ = n − 1, pgm's own rule: α² (n + κ) = 2n − 1, for n = 3 components.
ALPHA, BETA, KAPPA = (5.0 / 3.0) ** 0.5, 2.0, 0.0


def _robot(work: Robots) -> UnscentedKalmanFilter:
    robot = UnscentedKalmanFilter(
        dim_x=3,
        dim_z=2,
        dt=None,
        fx=DRIVE,  # called with the "duration" of a step: its control
        hx=sensors.range_bearing,
        points=MerweScaledSigmaPoints(3, ALPHA, BETA, KAPPA),
        z_mean_fn=_mean,
        residual_z=residual,
    )
    robot.x, robot.P = work.start
    robot.Q, robot.R = work.motion_cov, work.sensor_cov
    return robot


def _mean(readings: Array, weights: Array) -> Array:
    """Mean of readings, bearings about the first one's."""
    offsets = readings - readings[0]
    offsets[:, 1] = (offsets[:, 1] + np.pi) % (2.0 * np.pi) - np.pi
    mean: Array = readings[0] + weights @ offsets
    return mean


def filtering(work: Robots) -> Contender:
    """Run by run: means (runs, T, 3) and covariances."""

    def call() -> tuple[Array, Array]:
        passes = [_forward(work, run) for run in range(work.runs)]
        means, covs = zip(*(each[1:] for each in passes), strict=True)
        return np.stack(means), np.stack(covs)

    return Contender(call, work.runs * work.steps)


def online(work: Robots) -> Contender:
    """One robot in its loop: means (T, 3) and covariances."""

    def call() -> tuple[Array, Array]:
        _, means, covs = _forward(work, 0)
        return means, covs

    return Contender(call, work.steps)


def smoothing(work: Robots) -> Contender:
    """One run, forward and back: means (T, 3) and covariances."""
    onwards = np.concatenate([work.controls[1:], work.controls[:1]])  # from k to k + 1; one spare

    def call() -> tuple[Array, Array]:
        robot, means, covs = _forward(work, 0)
        smoothed, smoothed_covs, _ = robot.rts_smoother(means, covs, dts=onwards)
        return smoothed, smoothed_covs

    return Contender(call, work.steps)


def _forward(work: Robots, run: int) -> tuple[UnscentedKalmanFilter, Array, Array]:
    robot, controls = _robot(work), work.of(run)
    means, covs = np.empty((work.steps, 3)), np.empty((work.steps, 3, 3))
    for k in range(work.steps):
        robot.predict(dt=controls[k])
        robot.update(work.readings[run, k, 0], m=work.landmarks[k, 0])
        means[k], covs[k] = robot.x, robot.P
    return robot, means, covs
