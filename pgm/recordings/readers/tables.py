"""Any table of comma-separated values: columns by name, in units of many kinds."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_tuple, is_whole
from pgm.errors import EvidenceError
from pgm.evidence import degrees
from pgm.factors.arrays import diagonal
from pgm.factors.scope import listed
from pgm.io.dropped import Dropped
from pgm.io.sources import Source
from pgm.io.stamped import as_stamps
from pgm.io.tum import JOINED
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array
from pgm.recordings.drives import earth, motion
from pgm.recordings.drives.datum import Datum, as_datum
from pgm.recordings.drives.quantities import LATITUDE, LONGITUDE, STAMP, WORLD, quantity
from pgm.recordings.drives.recording import Recording
from pgm.recordings.drives.stream import Stream
from pgm.recordings.readers import cells, files
from pgm.recordings.readers.units import unit_of
from pgm.units import ANGLE, RATE, plain_unit

# A landmark's number; 1_0 is a name, of which Python would make 10.
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
# Words within a column's name, such as those of gps_lat and gpsLat.
_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+")
SUBJECT, VARIANCE, COVARIANCE = "subject", "variance of ", "covariance of "
_STREAMS = ("odometry", "velocities", "truth", "imu", "fixes")
_MOTION = ("odometry", "velocities")
# Where the variances of places on the earth stand, which are in metres.
_SPREAD = {
    LATITUDE: earth.NORTH,
    LONGITUDE: earth.EAST,
    **dict.fromkeys(earth.HEIGHTS, earth.UP),
}
# Components in metres, and words of columns' names that tell of degrees in their place.
_FLAT = (earth.EAST, earth.NORTH, "x", "y")
_ON_EARTH = {
    **dict.fromkeys(("lat", "latitude"), LATITUDE),
    **dict.fromkeys(("lon", "long", "lng", "longitude"), LONGITUDE),
}
# Angles that go on beyond a turn where they are not wrapped.
_UNBOUNDED = ("heading", "yaw")


@dataclass(frozen=True, slots=True)
class _Column:
    """A column asked for, by name or number, and the size and quantity of its unit, if told."""

    name: str | int
    size: float = 1.0
    quantity: str | None = None

    @property
    def told(self) -> bool:
        return self.quantity is not None


@public
def read_csv(
    path: Source,
    columns: Mapping[str, Mapping[str, Any]],
    *,
    landmarks: Mapping[Any, Any] | None = None,
    begin: float | None = None,
    wheelbase: float | None = None,
    delimiter: str = ",",
    decimal: str = ".",
    datum: Datum | Sequence[float] | None = None,
) -> Recording:
    r"""Read streams from a table of comma-separated values.

    Parameters
    ----------
    path : str, Path or open file
        Its first line names the columns, but where `columns` numbers them. Lines that begin with
        ``#`` are comments; one of those at the top may have the names, with or without its ``#``.
    columns : mapping of str to mapping
        For ``odometry``, ``velocities``, ``truth``, ``imu``, ``fixes``, or a sensor of any other
        name: which column each component is, ``{"t": "time", "range": "d"}``, or a pair of it and
        its unit, ``("heading", "deg")``; numbered from 0 where there is no line of names. ``t`` is
        the stamp, ``subject`` the landmark, ``"variance of range"`` is in the square of the unit,
        ``"covariance of range*bearing"`` in the product, ``("c", "m", "deg")``; without the latter
        components are not correlated.
        Places on the earth are ``latitude`` and ``longitude``, ``("lat", "deg")``, with ``up`` or
        without; they become metres east and north of the datum, of all streams one.
    landmarks : mapping, optional
        Positions by identity.
    begin : float, optional
        When the first increment of odometry begins, seconds.
    wheelbase : float, optional
        Metres between two wheels, where odometry or velocities are (left, right).
    delimiter, decimal : str, optional
        Letters between cells, and before the decimals of a number.
    datum : Datum or sequence of float, optional
        The origin of east and north, latitude and longitude [°], with the height [m] or without;
        the first place, if none is given. The recording keeps it, ``drive.datum``, for other files.

    Raises
    ------
    EvidenceError
        If `columns` is none, or a unit is unknown, or of another quantity than the component; or
        a column named as a latitude or longitude is read as metres without a unit that says so.
    FileError
        If a column is not there, a cell is no number, a line has more cells than there are names,
        angles without a unit seem to be degrees, or a latitude is beyond ±90° or a longitude
        beyond ±180°; it has file and line.
    ImportError
        Of places on the earth, without pymap3d, of the extra ``geo``.

    Notes
    -----
    A line is no row of a stream for which all its cells are empty; `dropped` tells of lines that
    are of none. Of several files: ``read_csv(...).replace(truth=read_csv(...).truth)``.

    Examples
    --------
    >>> import io
    >>> text = "time,speed,yaw rate,beacon,distance\n0,1.0,90,,\n500,1.5,0,7,420\n"
    >>> drive = pgm.recordings.read_csv(io.StringIO(text), {
    ...     "velocities": {"t": ("time", "ms"), "v": "speed", "omega": ("yaw rate", "deg/s")},
    ...     "radio": {"t": ("time", "ms"), "subject": "beacon", "range": ("distance", "cm")},
    ... })
    >>> drive.velocities["omega"], drive.sightings["radio"]["range"]
    (array([1.57079633, 0.        ]), array([4.2]))
    """
    where = as_datum(datum)
    asked = {part: _asked(part, given) for part, given in _mapping(columns, "columns").items()}
    if not (isinstance(delimiter, str) and len(delimiter) == 1):
        raise EvidenceError(f"delimiter= is one letter, not {delimiter!r}")
    if not (isinstance(decimal, str) and len(decimal) == 1 and decimal != delimiter):
        raise EvidenceError(f"decimal= is one letter, another than delimiter=, not {decimal!r}")
    numbered = {is_whole(each.name) for part in asked.values() for each in part.values()}
    if len(numbered) > 1:
        raise EvidenceError("columns are all named or all numbered")
    table = cells.cells_of(files.content(path), delimiter, decimal)
    header: Sequence[str] = ()
    if numbered == {False}:
        wanted = {str(each.name) for part in asked.values() for each in part.values()}
        header, table = cells.named(table, wanted)
    streams: dict[str, Stream] = {}
    empty = np.ones(len(table.rows), dtype=bool)
    for part, wanted_of in asked.items():
        places = {name: cells.place(each.name, header, table) for name, each in wanted_of.items()}
        with files.told_of(table.origin):
            streams[part], filled = _stream(part, wanted_of, places, table, begin)
        if part in _MOTION and wheelbase is not None:
            streams[part] = _driven(part, streams[part], wheelbase)
        empty[filled] = False
    told = [Dropped("table", "of no stream", np.flatnonzero(empty))] if empty.any() else []
    with files.told_of(table.origin):
        streams, fates, place = earth.on_plane(streams, where)
        return Recording(
            **{part: stream for part, stream in streams.items() if part in _STREAMS},  # type: ignore[arg-type]
            sightings={part: stream for part, stream in streams.items() if part not in _STREAMS},
            landmarks=landmarks,
            datum=place,
            name=files.name(path),
            dropped=[*told, *fates],
        )


def _stream(
    part: str,
    columns: Mapping[str, _Column],
    places: Mapping[str, int],
    table: cells.Cells,
    begin: float | None,
) -> tuple[Stream, list[int]]:
    """A stream, and the rows of the table that it has its rows from."""
    names = [name for name in places if name not in (STAMP, SUBJECT) and not _pair(name)]
    spreads = _spreads(names)
    pairs = {asked: [spreads.index(name) for name in _pair(asked)] for asked in places}
    pairs = {asked: pair for asked, pair in pairs.items() if pair}
    last, missing = max(places.values()), part not in _MOTION
    filled, stamps, values, spread, subjects = [], [], [], [], []
    for row, (line, row_cells) in enumerate(table.rows):
        if len(row_cells) <= last:
            raise table.origin.fault(
                f"it has {len(row_cells)} cells, where column {last}, counted from 0, was due", line
            )
        words = {name: row_cells[at].strip() for name, at in places.items()}
        if missing:
            words |= {name: "" for name in (*names, *pairs) if words[name].lower() == "nan"}
        if not any(words[name] for name in (*names, *([SUBJECT] if SUBJECT in words else []))):
            continue
        filled.append(row)
        found = {
            name: cells.number_in(word, columns[name].size, line, table, missing and name != STAMP)
            for name, word in words.items()
            if name != SUBJECT
        }
        stamps.append(found[STAMP])
        values.append([found[name] for name in names])
        spread.append([found[asked] for asked in pairs])
        subjects.append(_identity(words.get(SUBJECT, "")))
    when = _stamps(part, columns[STAMP], stamps)
    table_of = np.array(values).reshape(-1, len(names))
    for name, given in zip(names, table_of.T, strict=True):
        _require_radians(part, name, columns[name], when, given)
    cov = diagonal(np.full(table_of.shape, math.nan))
    told = np.array(spread).reshape(len(spread), len(pairs)).T
    for (one, other), given in zip(pairs.values(), told, strict=True):
        cov[:, one, other] = cov[:, other, one] = given
    stream = Stream(
        when,
        table_of,
        names,
        units=[plain_unit(each) if each else "" for each in _quantities(part, names, columns)],
        subject=subjects if SUBJECT in places else None,
        cov=cov if pairs else None,
        begin=begin if part == "odometry" else None,
    )
    return stream, filled


def _quantities(
    part: str, names: Sequence[str], columns: Mapping[str, _Column]
) -> list[str | None]:
    """The quantity of each component, by its name or its unit."""
    return [quantity(part, name) or columns[name].quantity for name in names]


def _stamps(part: str, column: _Column, stamps: Sequence[float]) -> Array:
    """Stamps in seconds; of another unit they are refused with the way to say it."""
    try:
        return as_stamps(f"columns[{part!r}]['t']", stamps)
    except EvidenceError as error:
        hint = "" if column.told else f"; say their unit, ({column.name!r}, 'ms'), say, or 'ns'"
        raise EvidenceError(f"{error}{hint}") from error


def _require_radians(part: str, name: str, column: _Column, stamps: Array, values: Array) -> None:
    """Refuse angles and turn rates without a unit that can hardly be radians."""
    due = quantity(part, name)
    if column.told or due not in (ANGLE, RATE):
        return
    if due == RATE:
        odd = degrees.too_fast(values)
    elif name in _UNBOUNDED:
        odd = degrees.seem_headings_in_degrees(stamps, values)
    else:
        odd = degrees.beyond_a_turn(values)
    if odd:
        most = np.nanmax(np.abs(values))
        one, other = ("deg/s", "rad/s") if due == RATE else ("deg", "rad")
        raise EvidenceError(
            f"columns[{part!r}][{name!r}] goes to {most:.4g} {other}, {most / TURN:.3g} turns"
            f"{' a second' * (due == RATE)}; it seems to be in degrees: say so, "
            f"({column.name!r}, {one!r}), or ({column.name!r}, {other!r}) where it is not"
        )


def _driven(part: str, stream: Stream, wheelbase: float) -> Stream:
    """Velocity and turn rate of a differential drive from its wheels' speeds."""
    if stream.variances is not None:
        raise EvidenceError(
            f"columns[{part!r}]: variances of two wheels are none of the motion that they make; "
            "leave them out"
        )
    left, right = (stream[name] for name in motion.WHEELS)
    names = motion.ARC if part == "odometry" else motion.SPEEDS
    values = motion.of_wheels(left, right, wheelbase)
    return Stream(stream.stamps, values, names, begin=stream.begin)


def _identity(word: str) -> int | str | None:
    """A landmark's number or name; None where there is none."""
    return int(word) if _WHOLE.fullmatch(word) else word or None


def _asked(part: str, given: Any) -> dict[str, _Column]:
    """The column and the unit of each component."""
    found: dict[str, _Column] = {}
    asked = _mapping(given, f"columns[{part!r}]")
    for name, value in asked.items():
        what = f"columns[{part!r}][{name!r}]"
        column, *units = (value,) if isinstance(value, str | int) else as_tuple(value) or ("",)
        if not (column != "" and (isinstance(column, str) or (is_whole(column) and column >= 0))):
            raise EvidenceError(
                f"{what} is a column's name or number, or one with its unit, not {value!r}"
            )
        pair = _pair(name)
        _require_spread(what, pair, asked)
        components = pair or (name,)
        if len(units) > len(set(components)):
            raise EvidenceError(
                f"{what}: {tuple(units)!r} are several units; "
                f"{'one or two are' if len(set(components)) > 1 else 'one is'} due"
            )
        if not units and name in WORLD:
            raise EvidenceError(f"{what} has its unit beside it, ({column!r}, 'deg') or 'rad'")
        if units:
            # One unit of two components is that of both.
            both = zip(components, (*units, units[-1]), strict=False)
            each = [unit_of(what, part, component, unit) for component, unit in both]
            size = math.prod(unit.size for unit in each)
            found[name] = _Column(column, size, each[0].quantity)
        else:
            found[name] = _Column(column)
    if STAMP not in found or not set(found) - {STAMP, SUBJECT}:
        raise EvidenceError(f"columns[{part!r}] names a column for t, and one or more components")
    for name in _FLAT:
        if name in found:
            _require_metres(part, name, found[name])
    return found


def _require_metres(part: str, name: str, column: _Column) -> None:
    """Refuse a place in the plane whose column is by its name of latitudes or longitudes.

    A unit beside the column's name, which must be one of length, says that it is metres after all.
    """
    words = _WORDS.findall(str(column.name))
    world = next((_ON_EARTH[w.lower()] for w in words if w.lower() in _ON_EARTH), None)
    if world is not None and not column.told:
        raise EvidenceError(
            f"columns[{part!r}][{name!r}] is in metres, and the column {column.name!r} by its name "
            f"a {world}: degrees become metres as {{{world!r}: ({column.name!r}, 'deg'), ...}}; "
            f"where it is in metres after all, say so, ({column.name!r}, 'm')"
        )


def _require_spread(what: str, pair: tuple[str, ...], asked: Mapping[str, Any]) -> None:
    """Refuse a variance given for a component that is not read, or a covariance without these."""
    due = _spreads([name for name in asked if LATITUDE in asked and name in _SPREAD])
    for component in dict.fromkeys(pair):
        if component in WORLD or (component not in asked and component not in due):
            hint = f" {listed(due)}, in metres" if due else " a component that is read, too"
            raise EvidenceError(f"{what}: a variance is of{hint}")
    variances = {VARIANCE + name for name in pair}
    if pair and (len(pair) != 2 or (len(variances) > 1 and not variances <= set(asked))):
        raise EvidenceError(
            f"{what}: a covariance is of two components, like 'covariance of east*north', whose "
            "variances are read, too"
        )
    if pair and [sorted(_pair(name)) for name in asked].count(sorted(pair)) > 1:
        raise EvidenceError(f"{what}: a column of {listed(pair)} is named twice; leave one out")


def _pair(name: str) -> tuple[str, ...]:
    """The two components that a variance or covariance is of, by its name; none of another name."""
    if name.startswith(COVARIANCE):
        return tuple(name.removeprefix(COVARIANCE).split(JOINED))
    return (name.removeprefix(VARIANCE),) * 2 if name.startswith(VARIANCE) else ()


def _spreads(names: Sequence[str]) -> list[str]:
    """The names that variances of components have: of places on the earth, those in metres."""
    return [_SPREAD.get(name, name) if LATITUDE in names else name for name in names]


def _mapping(given: Any, what: str) -> Mapping[str, Any]:
    if not isinstance(given, Mapping) or not given or not all(isinstance(k, str) for k in given):
        raise EvidenceError(f"{what} is a mapping of names, like {{'t': 'time'}}, not {given!r}")
    return given
