"""Robots with a heading whose controls are not velocities: wheel speeds, moves and turns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

import pgm
from models import motion
from models.networks.covariances import diagonal
from models.networks.observations import reads_heading, sees_landmark
from models.networks.variables import move, pose, wheels

Array = npt.NDArray[np.float64]


def differential_drive(
    dt: float,
    *,
    radius: float,
    wheelbase: float,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    start_std: Sequence[float] = (0.0, 0.0, 0.0),
    velocity_std: Sequence[float] = (0.1, 0.1, 0.05),
    sensor_std: Sequence[float] = (0.2, 0.05),
) -> pgm.DynamicBayesianNetwork:
    """A robot on two driven wheels that sees ranges and bearings of landmarks.

    Parameters
    ----------
    dt : float
        Seconds a step.
    radius, wheelbase : float
        Of the wheels, and between them [m].
    start, start_std : sequence of float
        Mean and standard deviations of the first pose [m, m, rad].
    velocity_std : sequence of float
        What white noise in the velocities does to the pose in one second [m, m, rad]; its
        standard deviation grows with √dt.
    sensor_std : sequence of float
        Standard deviations of a sighting [m, rad].

    Notes
    -----
    ``replace(observation=[reads_position(...)])`` gives it another sensor.
    """
    drive = motion.DifferentialDrive(radius=radius, wheelbase=wheelbase, dt=dt)
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, mean=start, cov=diagonal(start_std))],
        transition=[
            pgm.NonlinearGaussianCPD(
                pose,
                given=(pose.previous, wheels),
                function=drive,
                cov=dt * diagonal(velocity_std),
                jacobian={pose.previous: drive.by_state, wheels: drive.by_control},
            )
        ],
        observation=[sees_landmark(sensor_std)],
    )


def turn_after_move(
    *,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    start_std: Sequence[float] = (0.0, 0.0, 0.0),
    position_rate: float = 0.01,
    heading_rate: float = 0.01,
    sensor_std: float = 0.1,
) -> pgm.DynamicBayesianNetwork:
    """A robot that moves, then turns, and reads its heading.

    The noise grows with the control, variances (a |d|, a |d|, b |φ|), and is singular where the
    robot only turns, or only moves.

    Parameters
    ----------
    start, start_std : sequence of float
        Mean and standard deviations of the first pose [m, m, rad].
    position_rate : float
        a, the variance of each coordinate by distance [m²/m].
    heading_rate : float
        b, the variance of the heading by turn [rad²/rad].
    sensor_std : float
        Standard deviation of a heading that is read [rad].
    """
    rates = np.array([position_rate, position_rate, heading_rate])

    def noise(u: Array) -> Array:
        variances = rates * np.abs(u)[..., [0, 0, 1]]
        return variances[..., None] * np.eye(3)

    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, mean=start, cov=diagonal(start_std))],
        transition=[
            pgm.NonlinearGaussianCPD(
                pose,
                given=(pose.previous, move),
                function=motion.turn_after_move,
                cov=pgm.noise(noise, given=move),
                jacobian={
                    pose.previous: motion.turn_after_move_by_state,
                    move: motion.turn_after_move_by_control,
                },
            )
        ],
        observation=[reads_heading(sensor_std)],
    )
