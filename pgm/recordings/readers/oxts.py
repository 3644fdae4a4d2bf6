"""Packets of the inertial and satellite unit of KITTI's raw recordings."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from pgm.arguments import public
from pgm.io.dropped import Dropped
from pgm.io.sources import Content
from pgm.kernels.arrays import Array
from pgm.recordings.drives import earth
from pgm.recordings.drives.datum import Datum, as_datum
from pgm.recordings.drives.motion import PLANAR_SPEEDS
from pgm.recordings.drives.quantities import WORLD
from pgm.recordings.drives.recording import Recording
from pgm.recordings.drives.stream import Stream
from pgm.recordings.readers import files

FIELDS = (
    *("lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu"),
    *("ax", "ay", "az", "af", "al", "au", "wx", "wy", "wz", "wf", "wl", "wu"),
    *("pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode", "velmode", "orimode"),
)
IMU = ("rate_x", "rate_y", "rate_z", "acceleration_x", "acceleration_y", "acceleration_z")
LOST, BROKEN = "without a packet's file", "with numbers that are not finite"
_TIME = re.compile(r"(\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d)(\.\d*)?")


@public
def read_oxts(
    path: str | os.PathLike[str], *, datum: Datum | Sequence[float] | None = None
) -> Recording:
    """Read the OXTS packets of a raw recording of KITTI.

    Parameters
    ----------
    path : str or Path
        The folder ``oxts``, with ``timestamps.txt`` and ``data/0000000000.txt``, ...; or that of
        the drive, which has it.
    datum : Datum or sequence of float, optional
        The origin of east and north, latitude and longitude [°], with the height [m] or without;
        the first fix, if none is given.

    Returns
    -------
    Recording
        With `fixes`, (east, north, up), the variances of the first two being the told accuracy's
        square; `velocities`, (v_forward, v_left, omega); and `imu`, of the body's axes, with the
        heading, which is 0 towards east and grows to the left. Stamps are seconds since 1970, as if
        the times were in UTC.

    Raises
    ------
    FileError
        If a folder or file is not there, or is malformed.
    EvidenceError
        If the datum is none.
    ImportError
        Without pymap3d, of the extra ``geo``.

    Notes
    -----
    Stamps without a packet's file, and packets with NaN, are left out; `dropped` tells of them.

    References
    ----------
    Geiger, Lenz, Stiller and Urtasun, Vision meets robotics: the KITTI dataset, 2013.

    Examples
    --------
    >>> drive = pgm.recordings.read_oxts("2011_09_26_drive_0001_sync")  # doctest: +SKIP
    >>> pgm.recordings.read_oxts("nowhere")
    Traceback (most recent call last):
        ...
    pgm.errors.FileError: nowhere is no folder
    """
    place = as_datum(datum)
    folder = files.folder(path)
    if (folder / "oxts").is_dir():
        folder = folder / "oxts"
    clock = files.content(folder / "timestamps.txt")
    stamps = _stamps(clock)
    found = {int(p.stem): p for p in sorted((folder / "data").glob("*.txt")) if p.stem.isdigit()}
    if not found:
        raise clock.origin.fault("it stands beside no packets, data/0000000000.txt and so on")
    if max(found) >= len(stamps):
        raise clock.origin.fault(
            f"it has {len(stamps)} stamps, and the packets go to number {max(found)}, from 0"
        )
    rows = np.array(sorted(found))
    told = []
    if len(lost := np.setdiff1d(np.arange(len(stamps)), rows)):
        told.append(Dropped("oxts", LOST, lost))
    table = np.array([_packet(files.content(found[row])) for row in rows.tolist()])
    whole = np.isfinite(table[:, : FIELDS.index("navstat")]).all(axis=1)
    if not whole.all():
        told.append(Dropped("oxts", BROKEN, rows[~whole]))
    when, of = stamps[rows[whole]], dict(zip(FIELDS, table[whole].T, strict=True))
    spread = np.column_stack([of["pos_accuracy"] ** 2] * 2 + [np.full(len(when), np.nan)])
    world = np.column_stack([np.radians(of["lat"]), np.radians(of["lon"]), of["alt"]])
    body = [of[name] for name in ("wx", "wy", "wz", "ax", "ay", "az", "yaw")]
    units = (*("rad/s",) * 3, *("m/s^2",) * 3, "rad")
    with files.told_of(clock.origin):
        fixes = Stream(when, world, (*WORLD, "up"), variances=spread)
        streams, fates, place = earth.on_plane({"fixes": fixes}, place)
        return Recording(
            fixes=streams["fixes"],
            velocities=Stream(when, np.column_stack([of["vf"], of["vl"], of["wu"]]), PLANAR_SPEEDS),
            imu=Stream(when, np.column_stack(body), (*IMU, "heading"), units=units),
            datum=place,
            name=folder.parent.name if folder.name == "oxts" else folder.name,
            dropped=[*told, *fates],
        )


def _stamps(content: Content) -> Array:
    """Seconds since 1970 of lines like 2011-09-26 13:02:25.964389445."""
    found = []
    for k, line in enumerate(content.text().splitlines(), 1):
        if not line.strip():
            continue
        told = _TIME.fullmatch(line.strip())
        try:
            whole = datetime.fromisoformat(told[1]) if told else None
        except ValueError:
            whole = None
        if told is None or whole is None:
            raise content.origin.fault(
                f"{line.strip()!r}; a time like 2011-09-26 13:02:25.964389445 was due", k
            )
        found.append(whole.replace(tzinfo=UTC).timestamp() + float(f"0{told[2] or ''}"))
    return np.array(found)


def _packet(content: Content) -> list[float]:
    """The numbers of a packet, of which some may be NaN."""
    words = content.text().split()
    if len(words) != len(FIELDS):
        raise content.origin.fault(f"it has {len(words)} numbers; {len(FIELDS)} were due")
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise content.origin.fault(str(error)) from None
