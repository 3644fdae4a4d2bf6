"""A point robot in the plane: every CPD is linear, so that the Kalman filter is exact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import pgm
from models.networks.covariances import diagonal, variances
from models.networks.variables import fix, point, shift, speed


def linear(
    *,
    start_std: float = 1.0,
    motion_std: float = 0.3,
    sensor_std: float = 0.5,
) -> pgm.DynamicBayesianNetwork:
    """A point moved by known displacements whose position is read: every CPD is linear [m]."""
    plane = np.eye(2)
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(point, mean=np.zeros(2), cov=variances(start_std) * plane)],
        transition=[
            pgm.LinearGaussianCPD(
                point, given={point.previous: 1.0, shift: 1.0}, cov=variances(motion_std) * plane
            )
        ],
        observation=[
            pgm.LinearGaussianCPD(fix, given={point: 1.0}, cov=variances(sensor_std) * plane)
        ],
    )


def linear_velocity(
    dt: float,
    *,
    start: Sequence[float] = (0.0, 0.0),
    start_std: Sequence[float] = (0.1, 0.1),
    motion_std: Sequence[float] = (0.1, 0.1),
    sensor_std: Sequence[float] = (0.2, 0.2),
) -> pgm.DynamicBayesianNetwork:
    """A point driven by velocities whose position is read.

        x' = x + Δt u + n,    z = x + e

    Parameters
    ----------
    dt : float
        Seconds a step.
    start, start_std : sequence of float
        Mean and standard deviations of the first position [m, m].
    motion_std, sensor_std : sequence of float
        Standard deviations of the motion's noise a step, and of a reading [m, m].

    Notes
    -----
    The linear motion model of the 2018 report (section 3.1, equation 3.4), which it filters in
    section 4.3.2.
    """
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(point, mean=start, cov=diagonal(start_std))],
        transition=[
            pgm.LinearGaussianCPD(
                point, given={point.previous: 1.0, speed: dt}, cov=diagonal(motion_std)
            )
        ],
        observation=[pgm.LinearGaussianCPD(fix, given={point: 1.0}, cov=diagonal(sensor_std))],
    )
