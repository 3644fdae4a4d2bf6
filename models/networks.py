"""Localisation networks: a robot in the plane, its motion, and what it sees of known landmarks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

import pgm
from models import motion, sensors

# A pose; positions in metres, heading in radians.
pose = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
# A commanded velocity [m/s, rad/s], and motion since the step before [m, rad, s].
velocity = pgm.Variable("u", components=("v", "omega"))
travelled = pgm.Variable("u", components=("distance", "turn", "dt"))
# A landmark at a known place [m], and readings of it [m, rad].
landmark = pgm.Variable("m", components=("east", "north"))
distance = pgm.Variable("z", components=("range",))
sighting = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
# A point that moves in the plane, its displacement, and a reading of its position [m].
point = pgm.Variable("x", components=("east", "north"))
shift = pgm.Variable("u", components=("east", "north"))
fix = pgm.Variable("z", components=("east", "north"))


def _diagonal(std: Sequence[float]) -> npt.NDArray[np.float64]:
    return np.diag(np.square(std))


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
    drive = motion.Velocity(dt=dt)
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, mean=start, cov=_diagonal(start_std))],
        transition=[
            pgm.NonlinearGaussianCPD(
                pose,
                given=(pose.previous, velocity),
                function=drive,
                cov=_diagonal(motion_std),
                jacobian={pose.previous: drive.by_state, velocity: drive.by_control},
            )
        ],
        observation=[
            pgm.NonlinearGaussianCPD(
                sighting,
                given=(pose, landmark),
                function=sensors.range_bearing,
                cov=_diagonal(sensor_std),
                jacobian={
                    pose: sensors.range_bearing_by_state,
                    landmark: sensors.range_bearing_by_landmark,
                },
            )
        ],
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
    rates = _diagonal((position_rate, position_rate, heading_rate))
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, mean=start, cov=_diagonal(start_std))],
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
        observation=[
            pgm.NonlinearGaussianCPD(
                distance,
                given=(pose, landmark),
                function=sensors.range_only,
                cov=sensor_std**2,
                jacobian={
                    pose: sensors.range_only_by_state,
                    landmark: sensors.range_only_by_landmark,
                },
            )
        ],
    )


def linear(
    *,
    start_std: float = 1.0,
    motion_std: float = 0.3,
    sensor_std: float = 0.5,
) -> pgm.DynamicBayesianNetwork:
    """A point moved by known displacements whose position is read: every CPD is linear [m]."""
    plane = np.eye(2)
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(point, mean=np.zeros(2), cov=start_std**2 * plane)],
        transition=[
            pgm.LinearGaussianCPD(
                point, given={point.previous: 1.0, shift: 1.0}, cov=motion_std**2 * plane
            )
        ],
        observation=[pgm.LinearGaussianCPD(fix, given={point: 1.0}, cov=sensor_std**2 * plane)],
    )
