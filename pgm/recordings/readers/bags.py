"""Bags of ROS 1 and ROS 2, through the package rosbags."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_tuple
from pgm.errors import EvidenceError, FileError
from pgm.factors.scope import listed
from pgm.io.dropped import Dropped
from pgm.io.sources import Origin
from pgm.recordings.drives import earth
from pgm.recordings.drives.datum import Datum, as_datum
from pgm.recordings.drives.recording import Recording
from pgm.recordings.drives.scans import Scans
from pgm.recordings.drives.stream import Stream
from pgm.recordings.readers import files, messages
from pgm.recordings.readers.unclosed import EXTRA, closed
from pgm.resources import optional

# The part of a recording that messages of a type are, unless told otherwise.
PARTS = {
    "nav_msgs/msg/Odometry": "odometry",
    "geometry_msgs/msg/PoseStamped": "truth",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "sightings",
    "geometry_msgs/msg/TwistStamped": "velocities",
    "sensor_msgs/msg/Imu": "imu",
    "sensor_msgs/msg/NavSatFix": "fixes",
    "sensor_msgs/msg/LaserScan": "scans",
}
# Other parts that they can be.
CHOICES = {
    "nav_msgs/msg/Odometry": ("odometry", "velocities", "truth", "sightings"),
    "geometry_msgs/msg/PoseStamped": ("truth", "odometry", "sightings"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("sightings", "truth", "odometry"),
    "sensor_msgs/msg/NavSatFix": ("fixes", "sightings"),
}
MANY = ("sightings", "scans")


@public
def read_bag(
    path: str | os.PathLike[str],
    topics: Mapping[str, str] | Sequence[str] | None = None,
    *,
    datum: Datum | Sequence[float] | None = None,
) -> Recording:
    """Read a bag of ROS 1, a file, or of ROS 2, a folder or one of its files.

    Stamps are those of the messages' headers. Poses are seen from above: x, y and yaw.

    Parameters
    ----------
    path : str or Path
    topics : sequence of str or mapping of str to str, optional
        The topics to read, all of a known type without; or the part of the recording that each is:

        - ``nav_msgs/Odometry``: ``odometry``, the motion (forward, left, turn) between its poses;
          or ``velocities``, (v_forward, v_left, omega) of its twist; ``truth`` or ``sightings``;
        - ``geometry_msgs/PoseStamped``: ``truth``; or ``odometry``, or ``sightings``;
        - ``geometry_msgs/PoseWithCovarianceStamped``: ``sightings``, (east, north, heading), called
          like the topic; or ``truth`` or ``odometry``;
        - ``geometry_msgs/TwistStamped``: ``velocities``;
        - ``sensor_msgs/Imu``: ``imu``, rates, accelerations and yaw;
        - ``sensor_msgs/LaserScan``: ``scans``, called like the topic, cut at the largest range;
        - ``sensor_msgs/NavSatFix``: ``fixes``, or ``sightings``, (east, north, up): metres in the
          plane that touches the ellipsoid of WGS 84 at the datum, of all receivers one.

    datum : Datum or sequence of float, optional
        Where that plane touches: latitude and longitude [°], with the height [m] or without; the
        first fix, if none is given. The recording keeps it.

    Notes
    -----
    Messages without a fix, or with one at 0°, 0°, and topics of other types are left out;
    `dropped` tells of these. A bag whose recorder was killed is read as far as its records are
    whole, from a copy in a temporary folder, and `dropped` tells of that: one of ROS 1 without an
    index, ``.bag.active`` too; one of ROS 2 without ``metadata.yaml``, an MCAP file without an end
    or cut within its last chunk, or a database that has not taken its transactions.

    Raises
    ------
    ImportError
        Without rosbags, of the extra ``bags``, or pymap3d, of ``geo``, where it has fixes.
    EvidenceError
        If a topic cannot be what it is asked to be, or the datum is none.
    FileError
        If it is no bag, is damaged, has no such topic, or two topics for one part.

    Examples
    --------
    >>> drive = pgm.recordings.read_bag("drive.bag", ["/odom", "/gps"])  # doctest: +SKIP
    >>> pgm.recordings.read_bag("nowhere.bag")
    Traceback (most recent call last):
        ...
    pgm.errors.FileError: nowhere.bag: it cannot be read as a bag: there is nothing
    """
    if not isinstance(path, str | os.PathLike):
        raise EvidenceError(f"a bag's path was due, not {type(path).__name__}")
    place = as_datum(datum)
    where = Path(os.fsdecode(path))
    origin = Origin(str(where), str(where))
    if not where.exists():
        raise origin.fault("it cannot be read as a bag: there is nothing")
    highlevel = optional("rosbags.highlevel", "read_bag", EXTRA)
    typesys = optional("rosbags.typesys", "read_bag", EXTRA)
    found: dict[str, tuple[str, list[Any]]] = {}
    try:
        with ExitStack() as stack:
            scratch = Path(stack.enter_context(TemporaryDirectory()))
            bag = closed(where, scratch)
            store = typesys.Stores.LATEST if bag.second else typesys.Stores.ROS1_NOETIC
            typestore = typesys.get_typestore(store)
            reader = stack.enter_context(
                highlevel.AnyReader(bag.paths, default_typestore=typestore)
            )
            if bag.mended and not reader.message_count:
                raise origin.fault("its recorder was killed before it had written a message")
            kinds = {each.topic: each.msgtype for each in reader.connections}
            parts, others = _parts(kinds, topics, origin)
            wanted = [each for each in reader.connections if each.topic in parts]
            counts = {topic: reader.topics[topic].msgcount for topic in kinds}
            found = {topic: (kinds[topic], []) for topic in parts}
            for connection, _, raw in reader.messages(connections=wanted) if wanted else ():
                found[connection.topic][1].append(reader.deserialize(raw, connection.msgtype))
    except (EvidenceError, FileError):
        raise
    except Exception as error:  # of many kinds, as the damage is
        raise origin.fault(
            f"it cannot be read as a bag ({type(error).__name__}: {error}); is it whole, and was "
            "it closed?"
        ) from error
    told = [
        Dropped(topic, f"of {kinds[topic]}", np.arange(counts[topic]))
        for topic in others
        if counts[topic]
    ]
    if bag.mended:
        fate = f"of a bag that was not closed, read {bag.mended}"
        told.insert(0, Dropped("bag", fate, np.arange(sum(counts.values())), kept=True))
    return _recording(found, parts, told, origin, where, place)


def _recording(
    found: Mapping[str, tuple[str, list[Any]]],
    parts: Mapping[str, str],
    told: list[Dropped],
    origin: Origin,
    where: Path,
    datum: Datum | None,
) -> Recording:
    """A recording made of messages by topic."""
    streams: dict[str, Stream] = {}
    scans: dict[str, Scans] = {}
    with files.told_of(origin):
        for topic, (kind, rows) in found.items():
            part = parts[topic]
            made, fates = messages.READERS[kind](topic, part, rows, origin)
            told += fates
            if isinstance(made, Scans):
                scans[topic] = made
            elif made is not None:
                streams[topic if part in MANY else part] = made
        # Only now, so that two receivers are on one plane.
        streams, fates, place = earth.on_plane(streams, datum)
        many = [topic for topic, part in parts.items() if part in MANY]
        sensors = {topic: streams.pop(topic) for topic in many if topic in streams}
        return Recording(
            **streams,  # type: ignore[arg-type]
            sightings=sensors,
            scans=scans,
            datum=place,
            name=where.stem,
            dropped=[*told, *fates],
        )


def _parts(
    kinds: Mapping[str, str], topics: Any, origin: Origin
) -> tuple[dict[str, str], list[str]]:
    """The kind of stream that each topic is read as, and the topics left unread."""
    if topics is None:
        parts = {topic: PARTS[kind] for topic, kind in kinds.items() if kind in PARTS}
    else:
        asked = topics if isinstance(topics, Mapping) else dict.fromkeys(as_tuple(topics) or ())
        if not asked:
            raise EvidenceError(f"topics= names topics, like ['/odom'], not {topics!r}")
        parts = {}
        for topic, part in asked.items():
            if topic not in kinds:
                raise origin.fault(f"it has no topic {topic!r}; it has {listed(kinds, 20)}")
            kind = kinds[topic]
            if kind not in PARTS:
                raise origin.fault(f"{topic} is of {kind}; known are {listed(PARTS)}")
            choices = CHOICES.get(kind, (PARTS[kind],))
            if part is not None and part not in choices:
                raise EvidenceError(f"{topic}, of {kind}, is {listed(choices)}, not {part!r}")
            parts[topic] = part or PARTS[kind]
    for part in set(parts.values()) - set(MANY):
        each = [topic for topic in parts if parts[topic] == part]
        if len(each) > 1:
            raise origin.fault(
                f"{listed(each)} would each be {part}; say which topics to read, and as which "
                f"part, like topics={{{each[0]!r}: {part!r}}}"
            )
    return parts, [topic for topic in kinds if topic not in parts] if topics is None else []
