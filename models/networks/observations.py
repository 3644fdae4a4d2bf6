"""Observation CPDs of a pose: what a robot may sense of itself and of known landmarks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

import pgm
from models import sensors
from models.networks.covariances import diagonal, variances
from models.networks.variables import (
    bearing,
    compass,
    distance,
    fix,
    landmark,
    pose,
    pose_fix,
    sighting,
)
from pgm.cpds.robust import RobustNoise


def reads_position(
    std: Sequence[float], *, scale: Sequence[float] = (1.0, 1.0)
) -> pgm.LinearGaussianCPD:
    """A position is read, each coordinate on its own scale: z = diag(scale) (east, north) + e.

    Parameters
    ----------
    std : sequence of float
        Standard deviations of the reading, in its own units.
    scale : sequence of float
        What the reading multiplies east and north with.
    """
    return pgm.LinearGaussianCPD(
        fix, given={pose: np.diag(scale) @ np.eye(2, 3)}, cov=diagonal(std)
    )


def reads_pose(std: Sequence[float]) -> pgm.LinearGaussianCPD:
    """The whole pose is read, with standard deviations [m, m, rad]: z = x + e."""
    return pgm.LinearGaussianCPD(pose_fix, given={pose: 1.0}, cov=diagonal(std))


def reads_heading(std: float) -> pgm.LinearGaussianCPD:
    """The heading is read, as an inertial unit or a compass does: z = θ + e, e of std [rad]."""
    return pgm.LinearGaussianCPD(compass, given={pose: [[0.0, 0.0, 1.0]]}, cov=variances(std))


def reads_antenna(
    std: Sequence[float], mount: Sequence[float] | pgm.Variable
) -> pgm.NonlinearGaussianCPD:
    """The position of an antenna that is not at the robot's reference point is read.

    Parameters
    ----------
    std : sequence of float
        Standard deviations [m, m].
    mount : sequence of float or Variable
        Where the antenna is, (forward [m], left [m], turn [rad]), or the parent that says it.
    """
    return senses(fix, sensors.POSITION, (pose,), diagonal(std), mount)


def sees_range(
    std: float,
    *,
    grouped: bool = False,
    mount: Sequence[float] | pgm.Variable | None = None,
    calibration: Sequence[float] | pgm.Variable | None = None,
) -> pgm.NonlinearGaussianCPD:
    """The distance to a landmark, with a standard deviation [m].

    Parameters
    ----------
    std : float
        Standard deviation [m].
    grouped : bool
        Whether sigma points see the ranges of a step as one vector.
    mount : sequence of float or Variable, optional
        Where the sensor is on the robot, (forward [m], left [m], turn [rad]), or the parent that
        says it.
    calibration : sequence of float or Variable, optional
        (scale, offset [m]): range = scale · distance + offset; or the parent that says it.
    """
    cov = variances(std)
    return senses(
        distance, sensors.RANGE, (pose, landmark), cov, mount, calibration, grouped=grouped
    )


def sees_bearing(
    std: float, *, mount: Sequence[float] | pgm.Variable | None = None
) -> pgm.NonlinearGaussianCPD:
    """The direction of a landmark from the heading, with a standard deviation [rad].

    Parameters
    ----------
    std : float
        Standard deviation [rad].
    mount : sequence of float or Variable, optional
        As of `sees_range`.
    """
    return senses(bearing, sensors.BEARING, (pose, landmark), variances(std), mount)


def sees_landmark(
    std: Sequence[float],
    *,
    mount: Sequence[float] | pgm.Variable | None = None,
    calibration: Sequence[float] | pgm.Variable | None = None,
) -> pgm.NonlinearGaussianCPD:
    """Range and bearing of a landmark, with standard deviations [m, rad].

    Parameters
    ----------
    std : sequence of float
        Standard deviations [m, rad].
    mount, calibration : sequence of float or Variable, optional
        As of `sees_range`.
    """
    cov = diagonal(std)
    return senses(sighting, sensors.RANGE_BEARING, (pose, landmark), cov, mount, calibration)


def senses(
    child: pgm.Variable,
    sensor: sensors.Sensor,
    parents: tuple[pgm.Variable, ...],
    cov: npt.NDArray[np.float64],
    mount: Sequence[float] | pgm.Variable | None = None,
    calibration: Sequence[float] | pgm.Variable | None = None,
    *,
    grouped: bool = False,
    noise: RobustNoise | None = None,
) -> pgm.NonlinearGaussianCPD:
    """A CPD of a sensor as it is on the robot.

    Parameters
    ----------
    child : Variable
        The reading.
    sensor : Sensor
    parents : tuple of Variable
        The pose, and what else the sensor reads.
    cov : ndarray
    mount, calibration : sequence of float or Variable, optional
        As of `sees_range`.
    grouped : bool
        Whether sigma points see the readings of a step as one vector.
    noise : RobustNoise, optional
    """
    for changed, by in ((sensors.mounted, mount), (sensors.calibrated, calibration)):
        if isinstance(by, pgm.Variable):
            sensor, parents = changed(sensor), (*parents, by)
        elif by is not None:
            sensor = changed(sensor, by)
    return pgm.NonlinearGaussianCPD(
        child,
        given=parents,
        function=sensor.function,
        cov=cov,
        jacobian=dict(zip(parents, sensor.derivatives, strict=True)),
        grouped=grouped,
        noise=noise,
    )
