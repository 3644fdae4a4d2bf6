"""filterpy's extended Kalman filter, given the array functions that pgm is given."""

from __future__ import annotations

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from benchmarks.timing import Contender
from benchmarks.work.robots import DRIVE, Array, Robots
from models import sensors


class Robot(ExtendedKalmanFilter):  # type: ignore[misc]
    """Linearises its motion where it is, as `predict_x` is there for."""

    def __init__(self, work: Robots) -> None:
        super().__init__(dim_x=3, dim_z=2)
        self.x, self.P = work.start
        self.Q, self.R = work.motion_cov, work.sensor_cov

    def predict_x(self, u: Array) -> None:
        """Move the mean, and set the F that moves the covariance."""
        self.F = DRIVE.by_state(self.x, u)
        self.x = DRIVE(self.x, u)

    def see(self, reading: Array, m: Array) -> None:
        """Update with one sighting."""
        self.update(
            reading,
            sensors.range_bearing_by_state,
            sensors.range_bearing,
            args=(m,),
            hx_args=(m,),
            residual=residual,
        )


def residual(a: Array, b: Array) -> Array:
    """Difference of readings, the bearing's wrapped."""
    change = a - b
    change[1] = (change[1] + np.pi) % (2.0 * np.pi) - np.pi
    return change


def filtering(work: Robots, kind: type[Robot] = Robot) -> Contender:
    """Run by run: means (runs, T, 3) and covariances."""

    def call() -> tuple[Array, Array]:
        means = np.empty((work.runs, work.steps, 3))
        covs = np.empty((work.runs, work.steps, 3, 3))
        for run in range(work.runs):
            robot, controls = kind(work), work.of(run)
            for k in range(work.steps):
                robot.predict(controls[k])
                robot.see(work.readings[run, k, 0], work.landmarks[k, 0])
                means[run, k], covs[run, k] = robot.x, robot.P
        return means, covs

    return Contender(call, work.runs * work.steps)


def online(work: Robots, kind: type[Robot] = Robot) -> Contender:
    """One robot in its loop: means (T, 3) and covariances."""
    whole = filtering(work, kind)

    def call() -> tuple[Array, Array]:
        means, covs = whole.call()
        return means[0], covs[0]

    return Contender(call, work.steps)


def smoothing(work: Robots, kind: type[Robot] = Robot) -> Contender:
    """One run, forward and back; filterpy has no extended smoother: this is its linear one's loop.

    What the filter predicted is kept, so that no function is called again.
    """

    def call() -> tuple[Array, Array]:
        robot, steps = kind(work), work.steps
        means, covs = np.empty((steps, 3)), np.empty((steps, 3, 3))
        predicted, predicted_covs = np.empty((steps, 3)), np.empty((steps, 3, 3))
        slopes = np.empty((steps, 3, 3))
        for k in range(steps):
            robot.predict(work.controls[k])
            predicted[k], predicted_covs[k], slopes[k] = robot.x, robot.P, robot.F
            robot.see(work.readings[0, k, 0], work.landmarks[k, 0])
            means[k], covs[k] = robot.x, robot.P
        for k in range(steps - 2, -1, -1):
            gain = covs[k] @ slopes[k + 1].T @ np.linalg.inv(predicted_covs[k + 1])
            means[k] += gain @ (means[k + 1] - predicted[k + 1])
            covs[k] += gain @ (covs[k + 1] - predicted_covs[k + 1]) @ gain.T
        return means, covs

    return Contender(call, work.steps)
