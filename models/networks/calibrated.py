"""Robots that find out, while they drive, how their own sensors are off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy.typing as npt

import pgm
from models.networks.covariances import diagonal
from models.networks.observations import sees_range
from models.networks.uneven import drifts, rolls, stays, walks
from models.networks.variables import calibration, gyro_bias, pose, travelled


def calibrated_range(
    *,
    start: npt.ArrayLike,
    start_std: Sequence[float],
    position_rate: float,
    heading_rate: float,
    sensor_std: float,
    guess: Sequence[float] = (1.0, 0.0),
    guess_std: Sequence[float] = (0.2, 2.0),
    walk: Sequence[float] = (0.0, 0.0),
    mount: Sequence[float] | pgm.Variable | None = None,
) -> pgm.DynamicBayesianNetwork:
    """A robot of `range_only` whose ranges have an unknown scale and offset, a state c.

        z = s · distance + o + e,    c = (s, o),    p(c[t] | c[t−1]) exact, or a random walk

    Parameters
    ----------
    start, start_std, position_rate, heading_rate, sensor_std
        As of `range_only`.
    guess, guess_std : sequence of float
        Prior mean and standard deviations of scale and offset [1, m].
    walk : sequence of float
        Standard deviations of the changes of scale and offset after one second; 0 stays.
    mount : sequence of float or Variable, optional
        As of `sees_range`.
    """
    return pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(pose, mean=start, cov=diagonal(start_std)),
            pgm.GaussianCPD(calibration, mean=guess, cov=diagonal(guess_std)),
        ],
        transition=[
            rolls((position_rate, position_rate, heading_rate)),
            walks(calibration, walk, travelled) if any(walk) else stays(calibration),
        ],
        observation=[sees_range(sensor_std, mount=mount, calibration=calibration)],
    )


def drifting_gyro(
    *,
    start: npt.ArrayLike,
    start_std: Sequence[float],
    position_rate: float,
    heading_rate: float,
    sensor_std: float,
    bias_std: float,
    bias_walk: float,
) -> pgm.DynamicBayesianNetwork:
    """A robot of `range_only` whose gyro has a bias that walks, a state b.

        θ' = θ + φ − b Δt + n,    b' = b + w √Δt

    Parameters
    ----------
    start, start_std, position_rate, heading_rate, sensor_std
        As of `range_only`.
    bias_std : float
        Standard deviation of the first bias, about 0 [rad/s].
    bias_walk : float
        Standard deviation of its change after one second [rad/s]; 0 stays.
    """
    return pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(pose, mean=start, cov=diagonal(start_std)),
            pgm.GaussianCPD(gyro_bias, mean=0.0, cov=diagonal([bias_std])),
        ],
        transition=[
            drifts((position_rate, position_rate, heading_rate)),
            walks(gyro_bias, bias_walk, travelled),
        ],
        observation=[sees_range(sensor_std)],
    )
