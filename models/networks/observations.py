"""Observation CPDs of a pose: what a robot may sense of itself and of known landmarks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

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


def sees_range(std: float, *, grouped: bool = False) -> pgm.NonlinearGaussianCPD:
    """The distance to a landmark, with a standard deviation [m].

    Parameters
    ----------
    std : float
        Standard deviation [m].
    grouped : bool
        Whether sigma points see the ranges of a step as one vector.
    """
    return pgm.NonlinearGaussianCPD(
        distance,
        given=(pose, landmark),
        function=sensors.range_only,
        cov=variances(std),
        jacobian={
            pose: sensors.range_only_by_state,
            landmark: sensors.range_only_by_landmark,
        },
        grouped=grouped,
    )


def sees_bearing(std: float) -> pgm.NonlinearGaussianCPD:
    """The direction of a landmark from the heading, with a standard deviation [rad]."""
    return pgm.NonlinearGaussianCPD(
        bearing,
        given=(pose, landmark),
        function=sensors.bearing_only,
        cov=variances(std),
        jacobian={
            pose: sensors.bearing_only_by_state,
            landmark: sensors.bearing_only_by_landmark,
        },
    )


def sees_landmark(std: Sequence[float]) -> pgm.NonlinearGaussianCPD:
    """Range and bearing of a landmark, with standard deviations [m, rad]."""
    return pgm.NonlinearGaussianCPD(
        sighting,
        given=(pose, landmark),
        function=sensors.range_bearing,
        cov=diagonal(std),
        jacobian={
            pose: sensors.range_bearing_by_state,
            landmark: sensors.range_bearing_by_landmark,
        },
    )
