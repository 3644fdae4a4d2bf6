"""Robots with a heading whose own position, pose or heading is read."""

from __future__ import annotations

from collections.abc import Sequence

import pgm
from models import motion
from models.networks.covariances import diagonal
from models.networks.observations import reads_pose, reads_position
from models.networks.variables import pose, velocity


def driven(dt: float, std: Sequence[float]) -> pgm.NonlinearGaussianCPD:
    """The motion of a robot that drives arcs under commanded velocities.

    Parameters
    ----------
    dt : float
        Seconds a step.
    std : sequence of float
        Standard deviations of the noise a step [m, m, rad].
    """
    drive = motion.Velocity(dt=dt)
    return pgm.NonlinearGaussianCPD(
        pose,
        given=(pose.previous, velocity),
        function=drive,
        cov=diagonal(std),
        jacobian={pose.previous: drive.by_state, velocity: drive.by_control},
    )


def velocity_position(
    dt: float,
    *,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    start_std: Sequence[float] = (0.1, 0.1, 0.05),
    motion_std: Sequence[float] = (0.1, 0.1, 0.05),
    sensor_std: Sequence[float] = (0.2, 0.2),
) -> pgm.DynamicBayesianNetwork:
    """A robot driven by velocities whose position is read: z = [I₂ 0] x + e.

    Parameters
    ----------
    dt : float
        Seconds a step.
    start, start_std : sequence of float
        Mean and standard deviations of the first pose [m, m, rad].
    motion_std : sequence of float
        Standard deviations of the motion's noise a step [m, m, rad].
    sensor_std : sequence of float
        Standard deviations of a reading [m, m].

    Notes
    -----
    The example of the 2018 report for the extended and the unscented filter (sections 4.4.2 and
    4.5.1), its measurement matrix (equation 4.25) read as [I₂ 0]; `velocity_pose` reads it as I₃.
    """
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, mean=start, cov=diagonal(start_std))],
        transition=[driven(dt, motion_std)],
        observation=[reads_position(sensor_std)],
    )


def velocity_pose(
    dt: float,
    *,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    start_std: Sequence[float] = (0.1, 0.1, 0.05),
    motion_std: Sequence[float] = (0.1, 0.1, 0.05),
    sensor_std: Sequence[float] = (0.2, 0.2, 0.1),
) -> pgm.DynamicBayesianNetwork:
    """A robot driven by velocities whose whole pose is read: z = x + e.

    Parameters
    ----------
    dt : float
        Seconds a step.
    start, start_std : sequence of float
        Mean and standard deviations of the first pose [m, m, rad].
    motion_std, sensor_std : sequence of float
        Standard deviations of the motion's noise a step, and of a reading [m, m, rad].

    Notes
    -----
    The example of the 2018 report (section 4.4.2), its measurement matrix read as I₃.
    """
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, mean=start, cov=diagonal(start_std))],
        transition=[driven(dt, motion_std)],
        observation=[reads_pose(sensor_std)],
    )
