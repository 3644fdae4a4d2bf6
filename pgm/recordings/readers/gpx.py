"""Tracks of satellite receivers in GPX, read and written."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any
from xml.etree import ElementTree

import numpy as np

from pgm.arguments import public
from pgm.display import titled
from pgm.errors import EvidenceError
from pgm.io import sources
from pgm.io.dropped import Dropped
from pgm.io.poses import Poses
from pgm.io.sources import Origin, Source
from pgm.io.stamped import EPOCH, clock
from pgm.kernels.arrays import Array
from pgm.recordings.drives import earth
from pgm.recordings.drives.datum import Datum, as_datum
from pgm.recordings.drives.quantities import WORLD
from pgm.recordings.drives.recording import Recording
from pgm.recordings.drives.stream import Stream
from pgm.recordings.readers import files
from pgm.recordings.readers.messages import NO_FIX

SPACE = "http://www.topografix.com/GPX/1/1"
_START = datetime(1970, 1, 1, tzinfo=UTC)
NO_TIME, NO_TRACK = "without a time", "of no track"


@public
def read_gpx(path: Source, *, datum: Datum | Sequence[float] | None = None) -> Recording:
    r"""Read the tracks of a GPX file, as receivers and telephones write it.

    Parameters
    ----------
    path : str, Path or open file
    datum : Datum or sequence of float, optional
        The origin of east and north, latitude and longitude [°], with the height [m] or without;
        the first point, if none is given.

    Returns
    -------
    Recording
        With `fixes`, (east, north, up) or, where no point has an elevation, (east, north); stamps
        are seconds since 1970. Elevations are above the sea.

    Raises
    ------
    FileError
        If it is no GPX, has no point with a time, or a number or time is none.
    EvidenceError
        If the datum is none.
    ImportError
        Without pymap3d, of the extra ``geo``.

    Notes
    -----
    Points without a time, or whose ``<fix>`` is ``none``, waypoints and routes are left out, and
    `dropped` tells of them. Times without a zone are in UTC.

    References
    ----------
    Topografix, GPX 1.1 Schema Documentation, 2004.

    Examples
    --------
    >>> import io
    >>> text = '''<gpx version="1.1"><trk><trkseg><trkpt lat="48.1371" lon="11.5754">
    ... <time>2024-05-01T10:00:00Z</time></trkpt><trkpt lat="48.1372" lon="11.5754">
    ... <time>2024-05-01T10:00:01.5Z</time></trkpt></trkseg></trk></gpx>'''
    >>> drive = pgm.recordings.read_gpx(io.StringIO(text))  # doctest: +SKIP
    >>> drive.fixes["north"].round(2)  # doctest: +SKIP
    array([ 0.  , 11.12])
    """
    place = as_datum(datum)
    content = files.content(path)
    root = _root(content)
    points = [each for each in root.iter() if _name(each) == "trkpt"]
    if not points:
        raise content.origin.fault("it has no track, <trkpt> within <trk>; is it a route alone?")
    told, rows = [], [_row(k, each, content.origin) for k, each in enumerate(points)]
    table = np.array([row[:4] for row in rows])
    lost = np.array([row[4] for row in rows], dtype=bool)
    untimed = ~lost & np.isnan(table[:, 0])
    for fate, which in ((NO_FIX, lost), (NO_TIME, untimed)):
        if which.any():
            told.append(Dropped("fixes", fate, np.flatnonzero(which)))
    for kind in ("wpt", "rtept"):
        if others := sum(_name(each) == kind for each in root.iter()):
            told.append(Dropped(kind, NO_TRACK, np.arange(others)))
    kept = table[~(lost | untimed)]
    if not len(kept):
        raise content.origin.fault("no point of its tracks has a fix and a time")
    high = not np.isnan(kept[:, 3]).all()
    names = (*WORLD, *(["up"] if high else []))
    with files.told_of(content.origin):
        fixes = Stream(kept[:, 0], kept[:, 1 : 1 + len(names)], names)
        streams, fates, place = earth.on_plane({"fixes": fixes}, place)
        return Recording(
            fixes=streams["fixes"], datum=place, name=files.name(path), dropped=[*told, *fates]
        )


@public
def write_gpx(
    path: Source,
    places: Poses | Stream,
    *,
    datum: Datum | Sequence[float],
    begin: datetime | None = None,
    name: str = "",
) -> None:
    """Write places on the plane as a track on the earth, which maps and telephones show.

    Parameters
    ----------
    path : str, Path or open file
        Gzipped, if it ends in ``.gz``.
    places : Poses or Stream
        `Poses.of` a belief, or a stream of (east, north) or (east, north, up) [m].
    datum : Datum or sequence of float
        Where east and north are zero, as ``drive.datum``.
    begin : datetime, optional
        When the stamps are zero, with its time zone; without it they are seconds since 1970.
    name : str, optional
        The track's.

    Raises
    ------
    EvidenceError
        If places are not on a plane or not finite, the datum is none, or stamps are not since
        1970 and no beginning is given.
    FileError
        If the target cannot be written.
    ImportError
        Without pymap3d, of the extra ``geo``.

    Notes
    -----
    Poses whose heights are all zero, and streams without ``up``, have no elevations, and are at
    the datum's height. Covariances have no place in GPX.

    Examples
    --------
    >>> import io
    >>> track = pgm.recordings.Stream([1.7e9], [[0.0, 100.0]], ("east", "north"))
    >>> file = io.StringIO()
    >>> pgm.recordings.write_gpx(file, track, datum=(48.0, 11.0))  # doctest: +SKIP
    """
    where = as_datum(datum)
    if where is None:
        raise EvidenceError("datum= is needed, the place where east and north are zero")
    stamps, table = _table(places)
    world = where.to_earth(table)
    root = ElementTree.Element("gpx", {"version": "1.1", "creator": "sepset", "xmlns": SPACE})
    track = ElementTree.SubElement(root, "trk")
    if name:
        ElementTree.SubElement(track, "name").text = name
    segment = ElementTree.SubElement(track, "trkseg")
    for when, row in zip(_times(stamps, begin), world.tolist(), strict=True):
        point = ElementTree.SubElement(
            segment, "trkpt", {"lat": f"{row[0]:.12f}", "lon": f"{row[1]:.12f}"}
        )
        if len(row) == 3:
            ElementTree.SubElement(point, "ele").text = f"{row[2]:.6f}"
        ElementTree.SubElement(point, "time").text = when
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    sources.write(path, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')


def _root(content: sources.Content) -> ElementTree.Element:
    from defusedxml import ElementTree as safe  # type: ignore[import-untyped]
    from defusedxml.common import DefusedXmlException  # type: ignore[import-untyped]

    try:
        root: ElementTree.Element = safe.fromstring(content.data)
    except ElementTree.ParseError as error:
        raise content.origin.fault(f"it is no well-formed XML: {error}") from None
    except DefusedXmlException:
        raise content.origin.fault(
            "it defines entities or refers to other files, which is refused"
        ) from None
    if _name(root) != "gpx":
        raise content.origin.fault(f"its root is <{_name(root)}>, where <gpx> was due")
    return root


def _name(element: ElementTree.Element) -> str:
    """An element's name, without the namespace of a version."""
    return str(element.tag).rpartition("}")[2]


def _row(
    row: int, point: ElementTree.Element, origin: Origin
) -> tuple[float, float, float, float, bool]:
    """The time, latitude, longitude [rad] and elevation of a point, and whether it is no fix."""
    told = {_name(each): (each.text or "").strip() for each in point}
    world = []
    for key in ("lat", "lon"):
        if key not in point.attrib:
            raise origin.fault(f"the track's point {row} has no {key}")
        world.append(float(np.radians(_number(point.attrib[key].strip(), row, origin))))
    when = _seconds(told["time"], row, origin) if told.get("time") else np.nan
    height = _number(told["ele"], row, origin) if told.get("ele") else np.nan
    return when, *world, height, told.get("fix") == "none"  # type: ignore[return-value]


def _number(word: str, row: int, origin: Origin) -> float:
    try:
        found = float(word)
    except ValueError:
        found = math.nan
    if "_" in word or not math.isfinite(found):
        raise origin.fault(f"the track's point {row} has {word!r}, where a finite number was due")
    return found


def _seconds(text: str, row: int, origin: Origin) -> float:
    """Seconds since 1970 of a time in ISO 8601."""
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise origin.fault(
            f"the track's point {row} has the time {text!r}; one like 2024-05-01T10:00:00Z was due"
        ) from None
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def _table(places: Any) -> tuple[Array, Array]:
    """Stamps, and places (n, 2) or (n, 3) on the plane."""
    if isinstance(places, Poses):
        stamps, table = places.times, places.position
        table = table if table[:, 2].any() else table[:, :2]
    elif isinstance(places, Stream):
        lost = [name for name in (earth.EAST, earth.NORTH) if name not in places.components]
        if lost:
            raise EvidenceError(f"{places._title} has no component {lost[0]!r}")
        names = (earth.EAST, earth.NORTH, earth.UP)
        stamps = places.stamps
        table = np.column_stack([places[name] for name in names if name in places.components])
    else:
        raise EvidenceError(
            "places are Poses.of(belief, ...) or a Stream of (east, north), not " + titled(places)
        )
    if not np.isfinite(table).all():
        row = int((~np.isfinite(table)).any(axis=1).argmax())
        raise EvidenceError(f"places, row {row}: {table[row].tolist()} m; finite ones were due")
    return stamps, table


def _times(stamps: Array, begin: Any) -> list[str]:
    """Times in ISO 8601, to the microsecond."""
    if begin is None and (stamps < EPOCH).any():
        raise EvidenceError(
            f"times begin at {clock(stamps.min())}, which is no time since 1970; say when they "
            "are zero, begin=datetime(2024, 5, 1, 10, tzinfo=UTC)"
        )
    if begin is not None and not (isinstance(begin, datetime) and begin.tzinfo is not None):
        raise EvidenceError(f"begin= is a datetime with its tzinfo, not {begin!r}")
    since = _START if begin is None else begin.astimezone(UTC)
    each = (since + timedelta(seconds=float(stamp)) for stamp in stamps)
    return [when.isoformat().replace("+00:00", "Z") for when in each]
