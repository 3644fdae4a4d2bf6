"""Any table of comma-separated values: columns by name, in units of many kinds."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_tuple, is_whole
from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.io.sources import Origin, Source, number
from pgm.kernels.arrays import Array
from pgm.recordings import motion
from pgm.recordings.mending import Dropped
from pgm.recordings.readers import files
from pgm.recordings.recording import Recording
from pgm.recordings.stream import Stream

UNITS = {
    "m": 1.0,
    "km": 1e3,
    "cm": 1e-2,
    "mm": 1e-3,
    "ft": 0.3048,
    "in": 0.0254,
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "rad": 1.0,
    "deg": math.pi / 180.0,
    "mrad": 1e-3,
    "turn": 2.0 * math.pi,
    "m/s": 1.0,
    "km/h": 1.0 / 3.6,
    "mph": 0.44704,
    "cm/s": 1e-2,
    "mm/s": 1e-3,
    "rad/s": 1.0,
    "deg/s": math.pi / 180.0,
    "rpm": math.pi / 30.0,
}
# A landmark's number; 1_0 is a name, of which Python would make 10.
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
STAMP, SUBJECT, VARIANCE = "t", "subject", "variance of "
_STREAMS = ("odometry", "velocities", "truth", "imu", "fixes")
_MOTION = ("odometry", "velocities")


@public
def read_csv(
    path: Source,
    columns: Mapping[str, Mapping[str, Any]],
    *,
    landmarks: Mapping[Any, Any] | None = None,
    begin: float | None = None,
    wheelbase: float | None = None,
    delimiter: str = ",",
) -> Recording:
    r"""Read streams from a table of comma-separated values.

    Parameters
    ----------
    path : str, Path or open file
        Its first line names the columns, but where `columns` numbers them. Lines that begin with
        ``#`` are comments.
    columns : mapping of str to mapping
        For ``odometry``, ``velocities``, ``truth``, ``imu``, ``fixes``, or a sensor of any other
        name: which column each component is, ``{"t": "time", "range": "d"}``, or a pair of it and
        its unit, ``("heading", "deg")``; numbered from 0 where there is no line of names. ``t`` is
        the stamp, ``subject`` the landmark, ``"variance of range"`` is in the square of the unit.
    landmarks : mapping, optional
        Positions by identity.
    begin : float, optional
        When the first increment of odometry begins, seconds.
    wheelbase : float, optional
        Metres between two wheels, where odometry or velocities are (left, right).
    delimiter : str, optional

    Raises
    ------
    EvidenceError
        If `columns` is none, or a unit is unknown.
    FileError
        If a column is not there, or a cell is no number; it has file and line.

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
    asked = {part: _asked(part, given) for part, given in _mapping(columns, "columns").items()}
    if not (isinstance(delimiter, str) and len(delimiter) == 1):
        raise EvidenceError(f"delimiter= is one letter, not {delimiter!r}")
    held = files.content(path)
    numbered = {is_whole(column) for each in asked.values() for column, _ in each.values()}
    if len(numbered) > 1:
        raise EvidenceError("columns are all named or all numbered")
    rows = _rows(held.text(), held.origin, delimiter)
    header: Sequence[str] = ()
    if numbered == {False}:
        _, header = next(rows, (0, ()))
    table = list(rows)
    streams: dict[str, Stream] = {}
    empty = np.ones(len(table), dtype=bool)
    for part, wanted in asked.items():
        places = {
            name: (_place(column, header, table, held.origin), unit)
            for name, (column, unit) in wanted.items()
        }
        with files.told_of(held.origin):
            streams[part], filled = _stream(part, places, table, held.origin, begin)
        if part in _MOTION and wheelbase is not None:
            streams[part] = _driven(part, streams[part], wheelbase)
        empty[filled] = False
    told = [Dropped("table", "of no stream", np.flatnonzero(empty))] if empty.any() else []
    sensors = {part: stream for part, stream in streams.items() if part not in _STREAMS}
    with files.told_of(held.origin):
        return Recording(
            **{part: stream for part, stream in streams.items() if part in _STREAMS},  # type: ignore[arg-type]
            sightings=sensors,
            landmarks=landmarks,
            name=files.name(path),
            dropped=told,
        )


def _stream(
    part: str,
    places: Mapping[str, tuple[int, float]],
    table: Sequence[tuple[int, Sequence[str]]],
    origin: Origin,
    begin: float | None,
) -> tuple[Stream, list[int]]:
    """A stream, and the rows of the table that it has its rows from."""
    names = [name for name in places if name not in (STAMP, SUBJECT) and VARIANCE not in name]
    spreads = [name for name in names if VARIANCE + name in places]
    filled, stamps, values, variances, subjects = [], [], [], [], []
    for row, (line, cells) in enumerate(table):
        if len(cells) <= max(at for at, _ in places.values()):
            raise origin.fault(
                f"it has {len(cells)} cells, where column {max(at for at, _ in places.values())}, "
                "counted from 0, was due",
                line,
            )
        words = {name: cells[at].strip() for name, (at, _) in places.items()}
        if not any(words[name] for name in (*names, *([SUBJECT] if SUBJECT in words else []))):
            continue
        filled.append(row)
        found = {
            name: _cell(word, places[name][1], line, origin, part not in _MOTION and name in names)
            for name, word in words.items()
            if name != SUBJECT
        }
        stamps.append(found[STAMP])
        values.append([found[name] for name in names])
        variances.append([found.get(VARIANCE + name, math.nan) for name in names])
        subjects.append(_identity(words.get(SUBJECT, "")))
    stream = Stream(
        stamps,
        np.array(values).reshape(-1, len(names)),
        names,
        subject=subjects if SUBJECT in places else None,
        variances=_variances(variances, len(names)) if spreads else None,
        begin=begin if part == "odometry" else None,
    )
    return stream, filled


def _driven(part: str, stream: Stream, wheelbase: float) -> Stream:
    """The motion of two wheels."""
    if stream.variances is not None:
        raise EvidenceError(
            f"columns[{part!r}]: variances of two wheels are none of the motion that they make; "
            "leave them out"
        )
    left, right = (stream[name] for name in motion.WHEELS)
    names = motion.ARC if part == "odometry" else motion.SPEEDS
    values = motion.of_wheels(left, right, wheelbase)
    return Stream(stream.stamps, values, names, begin=stream.begin)


def _variances(rows: Sequence[Sequence[float]], width: int) -> Array:
    return np.array(rows).reshape(-1, width)


def _cell(word: str, scale: float, line: int, origin: Origin, missing: bool) -> float:
    if not word and missing:
        return math.nan
    found = number(word, line, origin) if word else None
    if found is None:
        raise origin.fault("an empty cell, where a number was due", line)
    return found * scale


def _identity(word: str) -> int | str | None:
    """A landmark's number or name; None where there is none."""
    return int(word) if _WHOLE.fullmatch(word) else word or None


def _rows(text: str, origin: Origin, delimiter: str) -> Iterator[tuple[int, Sequence[str]]]:
    """The cells of each line that has any and is no comment, with its number from 1."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    while True:
        try:
            cells = next(reader, None)
        except csv.Error as error:
            raise origin.fault(f"it is no table of values: {error}", reader.line_num) from None
        if cells is None:
            return
        if any(map(str.strip, cells)) and not cells[0].lstrip().startswith("#"):
            yield reader.line_num, cells


def _place(
    column: Any, header: Sequence[str], table: Sequence[tuple[int, Sequence[str]]], origin: Origin
) -> int:
    """The place of a column that is named or numbered."""
    if is_whole(column):
        return column
    names = [name.strip() for name in header]
    if names.count(column) != 1:
        found = "no column" if column not in names else "several columns"
        raise origin.fault(f"it has {found} {column!r}; they are {listed(names)}")
    return names.index(column)


def _asked(part: str, given: Any) -> dict[str, tuple[str | int, float]]:
    """The column and the unit of each component."""
    found: dict[str, tuple[str | int, float]] = {}
    for name, value in _mapping(given, f"columns[{part!r}]").items():
        column, *units = (value,) if isinstance(value, str | int) else as_tuple(value) or ("",)
        unit = units[0] if units else "s" if name == STAMP else "m"
        if not (column != "" and (isinstance(column, str) or (is_whole(column) and column >= 0))):
            raise EvidenceError(
                f"columns[{part!r}][{name!r}] is a column's name or number, or one with its unit, "
                f"not {value!r}"
            )
        if unit not in UNITS or len(units) > 1:
            raise EvidenceError(
                f"columns[{part!r}][{name!r}]: {unit!r} is no unit; known are {listed(UNITS, 99)}"
            )
        scale = UNITS[unit]
        found[name] = (column, scale**2 if VARIANCE in name else scale)
    if STAMP not in found or not set(found) - {STAMP, SUBJECT}:
        raise EvidenceError(f"columns[{part!r}] names a column for t, and one or more components")
    return found


def _mapping(given: Any, what: str) -> Mapping[str, Any]:
    if not isinstance(given, Mapping) or not given or not all(isinstance(k, str) for k in given):
        raise EvidenceError(f"{what} is a mapping of names, like {{'t': 'time'}}, not {given!r}")
    return given
