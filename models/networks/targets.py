"""Targets that are tracked: nobody tells their controls, their position is read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

import pgm
from models import tracking
from models.networks.covariances import diagonal
from models.networks.variables import fix, target, turning_target


def constant_velocity(
    dt: npt.ArrayLike,
    *,
    start: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    start_std: Sequence[float] = (1.0, 1.0, 1.0, 1.0),
    acceleration_density: float = 0.1,
    sensor_std: Sequence[float] = (0.5, 0.5),
) -> pgm.DynamicBayesianNetwork:
    """A target of nearly constant velocity: every CPD is linear.

    Parameters
    ----------
    dt : float or array, shape (T,)
        Seconds a step, of each of T steps where they differ.
    start, start_std : sequence of float
        Mean and standard deviations of the first state [m, m, m/s, m/s].
    acceleration_density : float
        Power spectral density of the white-noise acceleration [m²/s³].
    sensor_std : sequence of float
        Standard deviations of a position that is read [m, m].

    Notes
    -----
    Without controls the number of steps is not told by evidence of sightings: say ``steps=``, or
    give durations, which tell it.
    """
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(target, mean=start, cov=diagonal(start_std))],
        transition=[
            pgm.LinearGaussianCPD(
                target,
                given={target.previous: tracking.constant_velocity(dt)},
                cov=tracking.white_acceleration(dt, acceleration_density),
            )
        ],
        observation=[
            pgm.LinearGaussianCPD(fix, given={target: np.eye(2, 4)}, cov=diagonal(sensor_std))
        ],
    )


def coordinated_turn(
    dt: float,
    *,
    start: Sequence[float] = (0.0, 0.0, 1.0, 0.0, 0.0),
    start_std: Sequence[float] = (1.0, 1.0, 0.5, 0.5, 0.1),
    acceleration_std: float = 0.1,
    turn_acceleration_std: float = 0.02,
    sensor_std: Sequence[float] = (0.5, 0.5),
) -> pgm.DynamicBayesianNetwork:
    """A target that turns at an unknown rate, which changes slowly.

    Parameters
    ----------
    dt : float
        Seconds a step.
    start, start_std : sequence of float
        Mean and standard deviations of the first state [m, m, m/s, m/s, rad/s].
    acceleration_std : float
        Standard deviation of the acceleration that a step holds [m/s²].
    turn_acceleration_std : float
        Standard deviation of the change of the turn rate that a step holds [rad/s²].
    sensor_std : sequence of float
        Standard deviations of a position that is read [m, m].

    Notes
    -----
    The noise of a step is singular, of rank 3 of 5. Without controls the number of steps is not
    told by evidence of sightings: say ``steps=``.
    """
    turn = tracking.CoordinatedTurn(dt=dt)
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(turning_target, mean=start, cov=diagonal(start_std))],
        transition=[
            pgm.NonlinearGaussianCPD(
                turning_target,
                given=turning_target.previous,
                function=turn,
                cov=turn.noise(acceleration_std, turn_acceleration_std),
                jacobian={turning_target.previous: turn.by_state},
            )
        ],
        observation=[
            pgm.LinearGaussianCPD(
                fix, given={turning_target: np.eye(2, 5)}, cov=diagonal(sensor_std)
            )
        ],
    )
