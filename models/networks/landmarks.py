"""Robots that localise themselves by known landmarks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy.typing as npt

import pgm
from models import motion
from models.networks.covariances import diagonal
from models.networks.observations import sees_landmark, sees_range
from models.networks.poses import driven
from models.networks.variables import odometry, pose, travelled


def range_bearing(
    dt: float,
    *,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    start_std: Sequence[float] = (0.1, 0.1, 0.05),
    motion_std: Sequence[float] = (0.03, 0.03, 0.02),
    sensor_std: Sequence[float] = (0.2, 0.05),
) -> pgm.DynamicBayesianNetwork:
    """A robot driven by velocities that sees ranges and bearings of landmarks.

    Parameters
    ----------
    dt : float
        Seconds a step.
    start, start_std : sequence of float
        Mean and standard deviations of the first pose [m, m, rad].
    motion_std : sequence of float
        Standard deviations of the motion's noise a step [m, m, rad].
    sensor_std : sequence of float
        Standard deviations of a sighting [m, rad].
    """
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, mean=start, cov=diagonal(start_std))],
        transition=[driven(dt, motion_std)],
        observation=[sees_landmark(sensor_std)],
    )


def range_only(
    *,
    start: npt.ArrayLike,
    start_std: Sequence[float],
    position_rate: float,
    heading_rate: float,
    sensor_std: float,
) -> pgm.DynamicBayesianNetwork:
    """A robot with odometry, unevenly stamped, that hears its distance to beacons.

    Parameters
    ----------
    start, start_std : array_like
        Mean and standard deviations of the first pose [m, m, rad].
    position_rate, heading_rate : float
        Standard deviations of the motion's noise after one second [m, rad]; they grow with √dt.
    sensor_std : float
        Standard deviation of a range [m].
    """
    rates = diagonal((position_rate, position_rate, heading_rate))
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, mean=start, cov=diagonal(start_std))],
        transition=[
            pgm.NonlinearGaussianCPD(
                pose,
                given=(pose.previous, travelled),
                function=motion.travelled,
                cov=pgm.noise(lambda u: rates * u[..., 2, None, None], given=travelled),
                jacobian={
                    pose.previous: motion.travelled_by_state,
                    travelled: motion.travelled_by_control,
                },
            )
        ],
        observation=[sees_range(sensor_std)],
    )


def odometry_ranges(
    *,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    start_std: Sequence[float],
    motion_std: Sequence[float],
    sensor_std: float,
    grouped: bool = False,
) -> pgm.DynamicBayesianNetwork:
    """A robot whose odometry turns, goes straight and turns again, and that hears ranges.

    Parameters
    ----------
    start, start_std : sequence of float
        Mean and standard deviations of the first pose [m, m, rad].
    motion_std : sequence of float
        Standard deviations of the motion's noise a step [m, m, rad].
    sensor_std : float
        Standard deviation of a range [m].
    grouped : bool
        Whether sigma points see the ranges of a step as one vector.
    """
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, mean=start, cov=diagonal(start_std))],
        transition=[
            pgm.NonlinearGaussianCPD(
                pose,
                given=(pose.previous, odometry),
                function=motion.odometry,
                cov=diagonal(motion_std),
                jacobian={
                    pose.previous: motion.odometry_by_state,
                    odometry: motion.odometry_by_control,
                },
            )
        ],
        observation=[sees_range(sensor_std, grouped=grouped)],
    )
