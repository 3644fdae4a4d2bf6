"""Messages of ROS as rows of streams."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pgm.errors import EvidenceError
from pgm.io.dropped import BACKWARDS, Dropped
from pgm.io.sources import Origin
from pgm.kernels import quaternions
from pgm.kernels.arrays import Array, Mask
from pgm.recordings.drives import earth, odometers
from pgm.recordings.drives.motion import PLANAR_SPEEDS
from pgm.recordings.drives.quantities import WORLD
from pgm.recordings.drives.recording import POSE
from pgm.recordings.drives.scans import Scans
from pgm.recordings.drives.stream import Stream

# Of a 6 × 6 covariance, x, y, z and three turns: those in the plane.
_PLANE = (0, 1, 5)
_UNIT = 1e-3
NO_FIX = "without a fix"
CORRELATED = "with covariances between components, of which the variances alone are read"
Read = tuple[Any, list[Dropped]]


def _odometry(topic: str, part: str, rows: Sequence[Any], origin: Origin) -> Read:
    """Read messages of nav_msgs/Odometry."""
    if part != "velocities":
        return _poses(topic, part, rows, origin)
    return _speeds(topic, rows, [m.twist.twist for m in rows])


def _poses(topic: str, part: str, rows: Sequence[Any], origin: Origin) -> Read:
    """Messages that have a pose, with a covariance or without."""
    each = [m.pose.pose if hasattr(m.pose, "pose") else m.pose for m in rows]
    turns = _table([(q.x, q.y, q.z, q.w) for q in (pose.orientation for pose in each)], 4)
    places = _table([(pose.position.x, pose.position.y) for pose in each], 2)
    poses = np.column_stack([places, _yaw(topic, turns)])
    stamps = _stamps(topic, rows)
    if part == "odometry":
        return odometers.increments(part, Stream(stamps, poses, POSE)) if rows else (None, [])
    spread, told = None, []
    if rows and hasattr(rows[0].pose, "covariance"):
        cov = _table([m.pose.covariance for m in rows], 36).reshape(-1, 6, 6)
        cov = cov[:, _PLANE][:, :, _PLANE]
        spread = np.diagonal(cov, axis1=1, axis2=2)
        beside = cov[:, *np.triu_indices(3, 1)].any(axis=1)
        if not spread.any():
            spread = None  # all zero: not told
        elif beside.any():
            told = [Dropped(_name(topic, part), CORRELATED, np.flatnonzero(beside), kept=True)]
    return Stream(stamps, poses, POSE, variances=spread), told


def _twists(topic: str, part: str, rows: Sequence[Any], origin: Origin) -> Read:
    """Messages of geometry_msgs/TwistStamped."""
    return _speeds(topic, rows, [m.twist for m in rows])


def _speeds(topic: str, rows: Sequence[Any], each: Sequence[Any]) -> Read:
    values = _table([(twist.linear.x, twist.linear.y, twist.angular.z) for twist in each], 3)
    return Stream(_stamps(topic, rows), values, PLANAR_SPEEDS), []


def _imu(topic: str, part: str, rows: Sequence[Any], origin: Origin) -> Read:
    """Messages of sensor_msgs/Imu; a covariance that begins with −1 says: not measured."""
    names, columns, spreads = [], [], []
    for what, attribute in (("rate", "angular_velocity"), ("acceleration", "linear_acceleration")):
        cov = _table([getattr(m, f"{attribute}_covariance") for m in rows], 9)
        values = _table([[getattr(getattr(m, attribute), axis) for axis in "xyz"] for m in rows], 3)
        values[cov[:, 0] == -1.0] = np.nan
        names += [f"{what}_{axis}" for axis in "xyz"]
        columns.append(values)
        spreads.append(np.where(cov[:, :1] == -1.0, 0.0, cov[:, [0, 4, 8]]))
    turns = _table([(q.x, q.y, q.z, q.w) for q in (m.orientation for m in rows)], 4)
    cov = _table([m.orientation_covariance for m in rows], 9)
    told = (cov[:, 0] != -1.0) & turns.any(axis=1)
    yaw = np.full(len(rows), np.nan)
    yaw[told] = _yaw(topic, turns[told])
    spreads.append(np.where(told, cov[:, 8], 0.0)[:, None])
    spread = np.concatenate(spreads, axis=1)
    values = np.column_stack([*columns, yaw])
    variances = spread if spread.any() else None
    return Stream(_stamps(topic, rows), values, (*names, "heading"), variances=variances), []


def _fixes(topic: str, part: str, rows: Sequence[Any], origin: Origin) -> Read:
    """Messages of sensor_msgs/NavSatFix: latitude and longitude [rad], altitude [m]."""
    world = _table([(m.latitude, m.longitude, m.altitude) for m in rows], 3)
    world[:, :2] = np.radians(world[:, :2])
    fixed = np.array([m.status.status >= 0 for m in rows], dtype=bool)
    fixed &= np.isfinite(world[:, :2]).all(axis=1)
    null = fixed & earth.is_null(world[:, :2])
    told = [
        Dropped(_name(topic, part), fate, np.flatnonzero(which))
        for fate, which in ((NO_FIX, ~fixed), (earth.NULL, null))
        if which.any()
    ]
    fixed &= ~null
    if not fixed.any():
        return None, told
    world[~np.isfinite(world[:, 2]), 2] = np.nan
    spread, fates = _spread(_name(topic, part), rows, fixed)
    stream = Stream(
        _stamps(topic, rows)[fixed],
        world[fixed],
        (*WORLD, "altitude"),
        variances=None if spread is None else spread[fixed],
    )
    return stream, [*told, *fates]


def _spread(name: str, rows: Sequence[Any], fixed: Mask) -> tuple[Array | None, list[Dropped]]:
    """The variances of latitude, longitude and altitude, (n, 3), NaN where a fix has none."""
    # East, north, up: the longitude's variance comes first.
    cov = _table([m.position_covariance for m in rows], 9)
    spread, beside = cov[:, [4, 0, 8]], cov[:, [1, 2, 5]]
    known = np.array([m.position_covariance_type != 0 for m in rows], dtype=bool)
    if not (spread[known & fixed]).any():
        return None, []
    told = [
        Dropped(name, fate, np.flatnonzero(which), kept=True)
        for fate, which in (
            ("of a fix without a covariance, whose variances are NaN", fixed & ~known),
            (CORRELATED, fixed & known & beside.any(axis=1)),
        )
        if which.any()
    ]
    return np.where(known[:, None], spread, np.nan), told


def _name(topic: str, part: str) -> str:
    """The name of a stream: sensors are called like their topics."""
    return topic if part == "sightings" else part


def _scans(topic: str, part: str, rows: Sequence[Any], origin: Origin) -> Read:
    """Messages of sensor_msgs/LaserScan."""
    if not rows:
        return None, []
    settings = {
        (m.angle_min, m.angle_increment, m.range_min, m.range_max, len(m.ranges)) for m in rows
    }
    if len(settings) > 1:
        raise origin.fault(
            f"{topic}: scans of {len(settings)} kinds (first angle, step, ranges, rays), as "
            f"{sorted(settings)[:2]}; one kind was due"
        )
    start, step, least, most, count = settings.pop()
    ranges = _table([m.ranges for m in rows], count)
    # By REP 117 infinity is nothing in reach, and what is too near or no reading is NaN.
    with np.errstate(invalid="ignore"):
        ranges[ranges < least] = np.nan
    stamps = _stamps(topic, rows)
    told = []
    if (back := np.flatnonzero(np.diff(stamps) < 0.0) + 1).size:
        told.append(Dropped(topic, BACKWARDS, back, kept=True))
    order = np.argsort(stamps, kind="stable")
    return Scans(stamps[order], ranges[order], start + step * np.arange(count), most), told


def _stamps(topic: str, rows: Sequence[Any]) -> Array:
    """The stamps of headers, seconds."""
    if any(m.header.stamp.sec == 0 and m.header.stamp.nanosec == 0 for m in rows[1:]):
        raise EvidenceError(
            f"{topic}: headers of messages have no stamps, and the bag's times, when they came, "
            "are not used; stamp them, or leave the topic out of topics="
        )
    return np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in rows], dtype=float)


def _table(rows: Sequence[Any], width: int) -> Array:
    return np.array(rows, dtype=float).reshape(len(rows), width)


def _yaw(topic: str, turns: Array) -> Array:
    with np.errstate(over="ignore"):  # of numbers that are no quaternion either
        length = np.linalg.norm(turns, axis=1)
    if not (np.abs(length - 1.0) <= _UNIT).all():
        row = int((~(np.abs(length - 1.0) <= _UNIT)).argmax())
        raise EvidenceError(
            f"{topic}, message {row}: the orientation {turns[row].tolist()} is no unit quaternion"
        )
    yaw: Array = quaternions.angles(turns / length[:, None])[:, 2]
    return yaw


READERS: dict[str, Callable[[str, str, Sequence[Any], Origin], Read]] = {
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": _poses,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _poses,
    "geometry_msgs/msg/TwistStamped": _twists,
    "sensor_msgs/msg/Imu": _imu,
    "sensor_msgs/msg/NavSatFix": _fixes,
    "sensor_msgs/msg/LaserScan": _scans,
}
