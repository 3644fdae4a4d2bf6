"""filterpy's extended Kalman filter, run robot by robot with scalar functions."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from benchmarks.work import Work


def run(work: Work, robots: int) -> tuple[np.ndarray, np.ndarray]:
    """Means (robots, T, 3) and covariances (robots, T, 3, 3) of the first robots."""
    steps = work.controls.shape[0]
    means, covs = np.empty((robots, steps, 3)), np.empty((robots, steps, 3, 3))
    for robot in range(robots):
        ekf = ExtendedKalmanFilter(dim_x=3, dim_z=2)
        ekf.x = work.start.copy()
        ekf.P = work.start_cov.copy()
        ekf.Q = work.motion_cov
        ekf.R = work.sensor_cov
        for k in range(steps):
            _predict(ekf, work.controls[k, 0], work.controls[k, 1], work.dt)
            ekf.update(
                work.readings[robot, k],
                _jacobian,
                _expected,
                args=(work.landmarks[k],),
                hx_args=(work.landmarks[k],),
                residual=_residual,
            )
            means[robot, k], covs[robot, k] = ekf.x, ekf.P
    return means, covs


def _predict(ekf: ExtendedKalmanFilter, v: float, omega: float, dt: float) -> None:
    turn = omega * dt
    half = 0.5 * turn
    chord = v * dt * (sin(half) / half if half else 1.0)
    heading = ekf.x[2] + half
    east, north = chord * cos(heading), chord * sin(heading)
    ekf.F = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])
    ekf.x = ekf.x + np.array([east, north, turn])
    ekf.P = ekf.F @ ekf.P @ ekf.F.T + ekf.Q


def _expected(x: np.ndarray, m: np.ndarray) -> np.ndarray:
    east, north = m[0] - x[0], m[1] - x[1]
    return np.array([hypot(east, north), atan2(north, east) - x[2]])


def _jacobian(x: np.ndarray, m: np.ndarray) -> np.ndarray:
    east, north = m[0] - x[0], m[1] - x[1]
    square = east * east + north * north
    away = square**0.5
    return np.array([[-east / away, -north / away, 0.0], [north / square, -east / square, -1.0]])


def _residual(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([a[0] - b[0], (a[1] - b[1] + pi) % (2.0 * pi) - pi])
