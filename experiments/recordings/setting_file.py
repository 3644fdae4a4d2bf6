"""Settings of a recording from a file in TOML, and the readers by name.

The guide's page about recordings has the schema, and an example of each reader.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import pgm
from experiments.recordings.settings import KINDS, Sensor, Setting, Ways
from experiments.recordings.toml_table import TomlTable, is_number
from pgm import recordings
from pgm.cpds.robust import RobustNoise
from pgm.errors import EvidenceError, FileError, ModelError
from pgm.recordings import Dropped, Recording, Stream

POSE = ("east", "north", "heading")
ROBUST: dict[str, Callable[[float], RobustNoise]] = {
    "Cauchy": pgm.Cauchy,
    "Huber": pgm.Huber,
    "StudentT": pgm.StudentT,
    "TruncatedLeastSquares": pgm.TruncatedLeastSquares,
}
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")


@dataclass(frozen=True)
class Described:
    """The contents of a file of settings.

    Attributes
    ----------
    name : str
        Of the recording, in tables and names of figures.
    setting : Setting
    path : Path
        Of the recording.
    """

    name: str
    setting: Setting
    path: Path


def described(file: Path, reader: str, path: Path | None = None) -> Described:
    """The settings of a recording.

    Parameters
    ----------
    file : Path
        In TOML.
    reader : str
        One of `READERS`.
    path : Path, optional
        Of the recording, in place of the file's.

    Raises
    ------
    FileError
        If the file is no TOML, or lacks a key, has one that is unknown, or a value that is none;
        it names file and key.
    """
    top = TomlTable.read(file)
    path = located(top, path)
    name = top.text("name", "a name for tables and figures", plain_name(path.stem))
    if name != plain_name(name):
        raise top.fault("name", f"is {name!r}", "letters, digits, _ and - alone")
    read = READERS[reader](top.table("reader"))
    moves, begins = top.table("motion", needed=True), top.table("start")
    rates = moves.numbers("std", ("forward", "left", "turn"), _not_negative, "of one second, ")
    period = moves.number("period", "a positive number of seconds", _positive, None)
    start = begins.numbers("mean", POSE, lambda v: not np.isinf(v), default=None)
    start_std = begins.numbers("std", POSE, _not_negative, default=(0.1, 0.1, 0.05))
    truth = top.table("truth")
    shift = truth.number("heading_shift", "a number of radians", _finite, 0.0)
    sensors = tuple(_sensor(stream, each) for stream, each in top.tables("sensors").items())
    marks = top.table("landmarks")
    landmarks = {
        key: marks.numbers(key, ("east", "north"), kind="a place, ") for key in marks.values
    }
    setting = Setting(
        partial(_read, read, file, landmarks),
        sensors,
        rates,
        start_std,
        start,
        shift,
        period,
        ways=_ways(top.table("methods")),
        about=top.text("about", "a sentence", f"Settings of {file.name}."),
    )
    for table in (moves, begins, truth, top):
        table.done()
    return Described(name, setting, path)


def located(top: TomlTable, path: Path | None) -> Path:
    """The recording: as asked for, or as the file says, from the folder where that is."""
    told = top.text("path", "the recording's file or folder, here or as --path,", path)
    found = path or top.file.parent / told
    if not found.exists():
        raise top.fault("path", f"is {str(found)!r}, where there is nothing", "a file or folder")
    return found


def _read(
    read: Callable[[Path], Recording],
    file: Path,
    landmarks: dict[str, tuple[float, float]],
    path: Path,
) -> Recording:
    with _told_of(file):
        found = read(path)
    if not landmarks:
        return found
    words = {
        word
        for stream in found.sightings.values()
        if stream.subject is not None
        for word in stream.subject.tolist()
        if isinstance(word, str)
    }
    places: dict[Hashable, tuple[float, float]] = {
        int(key) if _WHOLE.fullmatch(key) and key not in words else key: place
        for key, place in landmarks.items()
    }
    return found.replace(landmarks=places)


@contextmanager
def _told_of(file: Path) -> Iterator[None]:
    """Put the file's name before errors about what it asks a reader for."""
    try:
        yield
    except EvidenceError as error:
        raise FileError(f"{file}: reader: {error}", path=str(file)) from error


def _sensor(stream: str, table: TomlTable) -> Sensor:
    due = f"one of {', '.join(KINDS)}"
    reads = table.take("reads", due, lambda v: isinstance(v, str) and v in KINDS)
    kind = KINDS[reads]
    std = table.numbers("std", kind.variable.components, _positive, "above zero, ")
    scale = offset = None
    if "range" in kind.variable.components:
        scale = table.number("scale", "a positive number", _positive, 1.0)
        offset = table.number("offset", "a number of metres", _finite, 0.0)
    mount = table.numbers("mount", ("forward", "left", "turn"), default=None)
    table.done()
    return Sensor(stream, reads, std, scale or 1.0, offset or 0.0, mount)


def _ways(table: TomlTable) -> Ways:
    plain = Ways()
    gate = table.number("gate", "a probability below 1", lambda v: 0.0 < v < 1.0, plain.gate)
    lag, many = table.whole("lag", plain.lag), table.whole("iterations", plain.iterations)
    due = "a noise and its parameter, like {Cauchy = 1.0}, of " + ", ".join(ROBUST)
    noise = table.take(
        "robust",
        due,
        lambda v: (
            isinstance(v, dict)
            and len(v) == 1
            and set(v) <= set(ROBUST)
            and all(map(is_number, v.values()))
        ),
        None,
    )
    table.done()
    if noise is None:
        return Ways(gate, plain.robust, lag, many)
    ((name, value),) = noise.items()
    try:
        return Ways(gate, ROBUST[name](value), lag, many)
    except ModelError as error:
        raise FileError(
            f"{table.file}: {table.name}.robust: {error}", path=str(table.file)
        ) from None


def plain_name(name: str) -> str:
    """A name as a file may have it."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name)


def _positive(value: float) -> bool:
    return bool(0.0 < value < np.inf)


def _not_negative(value: float) -> bool:
    return bool(0.0 <= value < np.inf)


def _finite(value: float) -> bool:
    return bool(np.isfinite(value))


Reader = Callable[[Path], Recording]


def _without_options(read: Reader) -> Callable[[TomlTable], Reader]:
    def made(table: TomlTable) -> Reader:
        table.done()
        return read

    return made


def _file(table: TomlTable, key: str) -> Path | None:
    """Another file of the recording, from the folder of the settings."""
    told = table.text(key, "a file", None)
    if told is None:
        return None
    path: Path = table.file.parent / told
    if not path.is_file():
        raise table.fault(key, f"is {told!r}, where there is no file", "a file")
    return path


def _labyrinth(table: TomlTable) -> Reader:
    truth, swapped = _file(table, "truth"), table.flag("swapped", True)
    base = table.number("wheelbase", "a positive number of metres", _positive, 0.157)
    table.done()
    return lambda path: recordings.read_labyrinth(path, truth, swapped=swapped, wheelbase=base)


def _mrclam(table: TomlTable) -> Reader:
    robot = table.whole("robot", 1)
    table.done()
    return lambda path: recordings.read_mrclam(path, robot)


def _bag(table: TomlTable) -> Reader:
    topics = table.take(
        "topics",
        "topics, or a table of the part that each is, {'/odom' = 'odometry'},",
        lambda v: (
            isinstance(v, list | dict)
            and bool(v)
            and all(isinstance(each, str) for each in (*v, *_values(v)))
        ),
        None,
    )
    table.done()
    return lambda path: recordings.read_bag(path, topics)


def _csv(table: TomlTable) -> Reader:
    columns = table.take(
        "columns", "a table of columns for each stream", lambda v: isinstance(v, dict) and bool(v)
    )
    options = {
        "begin": table.number("begin", "a number of seconds", _finite, None),
        "wheelbase": table.number("wheelbase", "a positive number of metres", _positive, None),
        "delimiter": table.text("delimiter", "a letter", ","),
        "decimal": table.text("decimal", "a letter", "."),
    }
    table.done()
    return lambda path: recordings.read_csv(path, columns, **options)


def _tum(table: TomlTable) -> Reader:
    truth, readings = _file(table, "truth"), _file(table, "poses")
    table.done()
    return lambda path: trajectories(path, truth, readings)


def trajectories(path: Path, truth: Path | None, readings: Path | None) -> Recording:
    """Trajectories as a drive, seen from above.

    Parameters
    ----------
    path : Path
        Its motion from pose to pose is the odometry.
    truth : Path, optional
        The reference.
    readings : Path, optional
        Poses that are readings of a sensor, ``poses``.
    """
    driven = pgm.read_tum(path)
    if len(driven.times) < 2:
        raise EvidenceError(f"{path}: it has one pose, which is no motion; 2 were due")
    seen, mended = {}, list[Dropped]()
    if readings is not None:
        told = pgm.read_tum(readings)
        seen["poses"] = Stream(told.times, told.planar, POSE)
        mended += told.dropped
    return Recording(
        odometry=driven,
        truth=None if truth is None else pgm.read_tum(truth),
        sightings=seen,
        name=path.stem,
        dropped=mended,
    )


def _values(value: Any) -> tuple[Any, ...]:
    return tuple(value.values()) if isinstance(value, dict) else ()


READERS: dict[str, Callable[[TomlTable], Reader]] = {
    "plaza": _without_options(recordings.read_plaza),
    "freiburg": _without_options(recordings.read_freiburg),
    "labyrinth": _labyrinth,
    "mrclam": _mrclam,
    "barfoot": _without_options(recordings.read_barfoot),
    "bag": _bag,
    "csv": _csv,
    "tum": _tum,
}
