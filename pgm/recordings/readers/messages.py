"""Messages of ROS as rows of streams."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pgm.errors import EvidenceError
from pgm.io.dropped import BACKWARDS, Dropped
from pgm.io.sources import Origin
from pgm.kernels import quaternions
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.recordings.drives import earth, odometers, spreads
from pgm.recordings.drives.motion import PLANAR_SPEEDS
from pgm.recordings.drives.quantities import WORLD
from pgm.recordings.drives.recording import POSE
from pgm.recordings.drives.scans import Scans
from pgm.recordings.drives.stream import Stream

# Of a 6 × 6 covariance, x, y, z and three turns: those in the plane.
_PLANE = (0, 1, 5)
_NORTH_FIRST = (1, 0, 2)
_UNIT = 1e-3
NO_FIX = "without a fix"
UNKNOWN = "of a fix without a covariance, whose variances are NaN"
IMPROPER = "whose covariance is none, as indefinite ones are not; its variances are NaN"
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
    cov: Array | None = None
    told: list[Dropped] = []
    if rows and hasattr(rows[0].pose, "covariance"):
        whole = _table([m.pose.covariance for m in rows], 36).reshape(-1, 6, 6)
        cov, told = _proper(_name(topic, part), whole[:, _PLANE][:, :, _PLANE])
    return Stream(stamps, poses, POSE, cov=cov), told


def _proper(
    name: str, cov: Array, unknown: Mask | None = None, rows: Integers | None = None
) -> tuple[Array | None, list[Dropped]]:
    """Covariances (n, d, d), NaN where they are unknown or none; None where all are zero.

    Each is of the message of its number in `rows`.
    """
    rows = np.arange(len(cov)) if rows is None else rows
    lost = np.zeros(len(cov), dtype=bool) if unknown is None else unknown
    if not cov[~lost].any():
        return None, []  # receivers and filters that do not tell them fill them with zeros
    odd = np.zeros(len(cov), dtype=bool)
    odd[[row for row in spreads.faults(cov) if not lost[row]]] = True
    told = [
        Dropped(name, fate, rows[which], kept=True)
        for fate, which in ((UNKNOWN, lost), (IMPROPER, odd))
        if which.any()
    ]
    return np.where((lost | odd)[:, None, None], np.nan, cov), told


def _twists(topic: str, part: str, rows: Sequence[Any], origin: Origin) -> Read:
    """Messages of geometry_msgs/TwistStamped."""
    return _speeds(topic, rows, [m.twist for m in rows])


def _speeds(topic: str, rows: Sequence[Any], each: Sequence[Any]) -> Read:
    values = _table([(twist.linear.x, twist.linear.y, twist.angular.z) for twist in each], 3)
    return Stream(_stamps(topic, rows), values, PLANAR_SPEEDS), []


def _imu(topic: str, part: str, rows: Sequence[Any], origin: Origin) -> Read:
    """Messages of sensor_msgs/Imu; a covariance that begins with −1 says: not measured."""
    names, columns, blocks = [], [], []
    for what, attribute in (("rate", "angular_velocity"), ("acceleration", "linear_acceleration")):
        cov = _table([getattr(m, f"{attribute}_covariance") for m in rows], 9)
        values = _table([[getattr(getattr(m, attribute), axis) for axis in "xyz"] for m in rows], 3)
        values[cov[:, 0] == -1.0] = np.nan
        names += [f"{what}_{axis}" for axis in "xyz"]
        columns.append(values)
        blocks.append(np.where(cov[:, :1] == -1.0, 0.0, cov).reshape(-1, 3, 3))
    turns = _table([(q.x, q.y, q.z, q.w) for q in (m.orientation for m in rows)], 4)
    cov = _table([m.orientation_covariance for m in rows], 9)
    told = (cov[:, 0] != -1.0) & turns.any(axis=1)
    yaw = np.full(len(rows), np.nan)
    yaw[told] = _yaw(topic, turns[told])
    blocks.append(np.where(told, cov[:, 8], 0.0)[:, None, None])
    values = np.column_stack([*columns, yaw])
    whole = np.zeros((len(rows), values.shape[1], values.shape[1]))
    for k, block in zip((0, 3, 6), blocks, strict=True):
        own = slice(k, k + block.shape[1])
        whole[:, own, own] = block
    found, fates = _proper(_name(topic, part), whole)
    return Stream(_stamps(topic, rows), values, (*names, "heading"), cov=found), fates


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
    whole = _table([m.position_covariance for m in rows], 9)[fixed].reshape(-1, 3, 3)
    unknown = np.array([m.position_covariance_type for m in rows])[fixed] == 0
    # East, north, up: the longitude's variance comes first.
    whole = whole[:, _NORTH_FIRST][:, :, _NORTH_FIRST]
    cov, fates = _proper(_name(topic, part), whole, unknown, np.flatnonzero(fixed))
    stream = Stream(_stamps(topic, rows)[fixed], world[fixed], (*WORLD, "altitude"), cov=cov)
    return stream, [*told, *fates]


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
