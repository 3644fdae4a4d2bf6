"""filterpy's extended Kalman filter with functions of Python's numbers, which suit it best."""

from __future__ import annotations

from functools import partial
from math import atan2, cos, hypot, pi, sin

import numpy as np

from benchmarks.libraries import filterpy_taylor
from benchmarks.work.robots import DT, Array


class ScalarRobot(filterpy_taylor.Robot):
    """The same robot, its functions written for one state."""

    def predict_x(self, u: Array) -> None:
        """Move the mean, and set the F that moves the covariance."""
        turn = u[1] * DT
        half = 0.5 * turn
        chord = u[0] * DT * (sin(half) / half if half else 1.0)
        course = self.x[2] + half
        east, north = chord * cos(course), chord * sin(course)
        self.F = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])
        self.x = self.x + np.array([east, north, turn])

    def see(self, reading: Array, m: Array) -> None:
        """Update with one sighting."""
        self.update(reading, _jacobian, _expected, args=(m,), hx_args=(m,), residual=_residual)


def _expected(x: Array, m: Array) -> Array:
    east, north = m[0] - x[0], m[1] - x[1]
    return np.array([hypot(east, north), atan2(north, east) - x[2]])


def _jacobian(x: Array, m: Array) -> Array:
    east, north = m[0] - x[0], m[1] - x[1]
    square = east * east + north * north
    away = square**0.5
    return np.array([[-east / away, -north / away, 0.0], [north / square, -east / square, -1.0]])


def _residual(a: Array, b: Array) -> Array:
    return np.array([a[0] - b[0], (a[1] - b[1] + pi) % (2.0 * pi) - pi])


filtering = partial(filterpy_taylor.filtering, kind=ScalarRobot)
online = partial(filterpy_taylor.online, kind=ScalarRobot)
smoothing = partial(filterpy_taylor.smoothing, kind=ScalarRobot)
