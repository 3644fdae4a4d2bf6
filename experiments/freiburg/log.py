"""The Freiburg recording: odometry, and sightings of numbered landmarks after each motion.

It belongs to an exercise in the extended Kalman filter (Introduction to Mobile Robotics, University
of Freiburg, sheet 7, 2019). It is no part of the project.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

import pgm
from models.networks import distance, landmark, odometry
from pgm.errors import FileError

Array = npt.NDArray[np.float64]

SENSOR, WORLD = "sensor_data.dat", "world.dat"
# The folder of recordings, where it is not beside the checkout.
VARIABLE = "PGM_DATA"
_BESIDE = Path(__file__).parents[3] / "shared" / "data"


@dataclass(frozen=True, eq=False)
class Log:
    """A recording; a motion a step, its sightings seen after it.

    Attributes
    ----------
    landmarks : dict of int to tuple of float
        East and north [m] by number.
    odometry : ndarray
        (T, 3): first turn [rad], translation [m], second turn [rad], of steps 1..T.
    step : ndarray
        (M,): of each sighting, in 1..T.
    seen : ndarray
        (M,): the number of the landmark.
    ranges, bearings : ndarray
        (M,) [m] and [rad]; bearings as they are written, not wrapped.
    """

    landmarks: dict[int, tuple[float, float]]
    odometry: Array
    step: npt.NDArray[np.int_]
    seen: npt.NDArray[np.int_]
    ranges: Array
    bearings: Array

    @property
    def places(self) -> Array:
        """East and north of each sighting's landmark, (M, 2) [m]."""
        return np.array([self.landmarks[number] for number in self.seen.tolist()]).reshape(-1, 2)

    @property
    def evidence(self) -> dict[pgm.Variable, object]:
        """Odometry, and the ranges alone: the exercise leaves the bearings out."""
        ranges = pgm.sightings(self.ranges[:, None], step=self.step, given={landmark: self.places})
        return {odometry: self.odometry, distance: ranges}


def find() -> Path | None:
    """The folder of the recording; None where there is none.

    It is looked for below the folder that the environment variable ``PGM_DATA`` names, or else
    below ``../shared/data`` of the checkout.
    """
    folder = Path(os.environ.get(VARIABLE) or _BESIDE) / "freiburg"
    return folder if (folder / SENSOR).is_file() and (folder / WORLD).is_file() else None


def load(folder: Path) -> Log:
    """Read a recording's two files.

    Raises
    ------
    FileError
        If one cannot be read, or a line is not what it should be; it has file and line.
    """
    landmarks = read_world(folder / WORLD)
    path = folder / SENSOR
    motions: list[list[float]] = []
    sightings: list[tuple[int, int, float, float]] = []
    for line, words in _lines(path):
        if words[0] == "ODOMETRY":
            motions.append(_numbers(path, line, words, "ODOMETRY rot1 trans rot2", 1))
        elif words[0] == "SENSOR":
            number, away, bearing = _numbers(path, line, words, "SENSOR id range bearing", 1)
            if number not in landmarks:
                raise _refused(path, line, f"a landmark {words[1]} that {WORLD} does not have")
            if away < 0.0:
                raise _refused(path, line, f"a range of {away:g} m; 0 or more was due")
            if not motions:
                raise _refused(path, line, "a sighting before the first ODOMETRY")
            sightings.append((len(motions), int(number), away, bearing))
        else:
            raise _refused(path, line, f"{words[0]!r}; ODOMETRY or SENSOR was due")
    if not motions:
        raise FileError(f"{path}: no line of ODOMETRY; is it a Freiburg recording?", path=str(path))
    table = np.array(sightings, dtype=float).reshape(-1, 4)
    step, seen = table[:, :2].astype(int).T
    return Log(landmarks, np.array(motions), step, seen, table[:, 2], table[:, 3])


def read_world(path: Path) -> dict[int, tuple[float, float]]:
    """Landmarks by number, of lines ``id east north``.

    Raises
    ------
    FileError
        If it cannot be read, or a line is not what it should be.
    """
    landmarks: dict[int, tuple[float, float]] = {}
    for line, words in _lines(path):
        number, east, north = _numbers(path, line, words, "id east north", 0)
        if number != int(number):
            raise _refused(path, line, f"a landmark {words[0]}; a whole number was due")
        if number in landmarks:
            raise _refused(path, line, f"the landmark {words[0]} for the second time")
        landmarks[int(number)] = (east, north)
    if not landmarks:
        raise FileError(f"{path}: no landmarks; lines of id east north were due", path=str(path))
    return landmarks


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The words of each line that has any, with its number from 1."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(
            f"{path} cannot be read as text ({type(error).__name__}: {error})", path=str(path)
        ) from error
    for number, line in enumerate(text.splitlines(), start=1):
        if words := line.split():
            yield number, words


def _numbers(path: Path, line: int, words: Sequence[str], due: str, skip: int) -> list[float]:
    """The numbers of a line behind its first words, as many as are due."""
    if len(words) != len(due.split()):
        raise _refused(path, line, f"{len(words)} words; `{due}` was due")
    try:
        found = [float(word) for word in words[skip:]]
    except ValueError:
        found = [np.nan]
    if not np.isfinite(found).all():
        raise _refused(path, line, f"{' '.join(words)!r}; `{due}`, in finite numbers, was due")
    return found


def _refused(path: Path, line: int, found: str) -> FileError:
    return FileError(f"{path}, line {line}: found {found}", path=str(path), line=line)
