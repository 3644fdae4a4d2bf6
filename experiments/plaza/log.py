"""The Plaza recordings: a lawn mower with odometry that hears its distance to four beacons.

Recorded by J. Djugash, B. Hamner and S. Roth (Navigating with ranging radios, 2009); the gtsam
wheel carries them.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.io import loadmat

from models.networks import distance, landmark, travelled
from pgm.errors import EvidenceError, FileError
from pgm.io import Timeline, stamped, timeline

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Setting:
    """What is known of one recording.

    The range calibration, range = scale · distance + offset, was fitted with the truth, and the
    noise was tuned: results check an engine, they claim no accuracy.
    """

    file: str
    scale: float
    offset: float
    heading_shift: float  # what its true headings lack [rad]
    heading_rate: float  # rad after one second
    sensor_std: float  # m


SETTINGS = {
    "plaza1": Setting("Plaza1_.mat", 1.0693, 0.034, 0.0, 0.001, 0.508),
    "plaza2": Setting("Plaza2_.mat", 1.0694, 0.020, np.pi, 0.02, 0.529),
}
POSITION_RATE = 0.05  # m after one second
# Of each table: true poses, odometry, ranges heard, and places of beacons, by time or number.
COLUMNS = {"GT": 4, "DR": 3, "TD": 4, "TL": 3}
START_STD = (0.2, 0.2, 0.05)  # m, m, rad


@dataclass(frozen=True, eq=False)
class Log:
    """A recording on the times of its states.

    Attributes
    ----------
    timeline : Timeline
        Controls and ranges as evidence, and what became of every row.
    truth : ndarray
        (n, 3): satellite positions [m] and headings [rad].
    steps : ndarray of int
        (n,): of the states whose truth that is.
    beacons : ndarray
        (4, 2) [m].
    """

    timeline: Timeline
    truth: Array
    steps: npt.NDArray[np.int64]
    beacons: Array


def find(name: str) -> Path | None:
    """The recording inside the gtsam package; None where that is not installed."""
    try:
        gtsam = importlib.import_module("gtsam")
    except ImportError:
        return None
    return Path(gtsam.findExampleDataFile(SETTINGS[name].file))


def load(path: Path, setting: Setting, *, every_stamp: bool = False) -> Log:
    """Read a recording, calibrate its ranges, and lay it on the times of the true positions.

    With `every_stamp` there are states at the ranges' own times, too.
    """
    truth, moved, heard, where = _tables(path)
    place = {int(beacon): (east, north) for beacon, east, north in where}
    strangers = sorted({int(beacon) for beacon in heard[:, 2]} - set(place))
    if strangers:
        raise EvidenceError(f"{path}: the beacons {strangers} in TD have no place in TL")
    ranges = (heard[:, 3] - setting.offset) / setting.scale
    beacons = np.array([place[int(beacon)] for beacon in heard[:, 2]])
    begin = np.array([[truth[0, 0], 0.0, 0.0]])  # the first increment counts from there
    rolled = np.concatenate([begin, moved]) if every_stamp else moved
    laid = timeline(
        None if every_stamp else truth[:, 0],
        odometry={travelled: stamped(rolled[:, 0], rolled[:, 1:])},
        sensors={distance: stamped(heard[:, 0], ranges, {landmark: beacons})},
    )
    poses = truth[:, 1:] + np.array([0.0, 0.0, setting.heading_shift])
    steps = np.searchsorted(laid.times, truth[:, 0])
    return Log(laid, poses, steps, np.array(list(place.values())))


def _tables(path: Path) -> list[Array]:
    """The tables of a recording, checked."""
    try:
        data = loadmat(path)
    except Exception as error:  # of many kinds, as the damage is
        raise FileError(
            f"{path} cannot be read as a .mat file ({type(error).__name__}: {error}); fetch it "
            "again, or leave out --path",
            path=str(path),
        ) from error
    lost = [key for key in COLUMNS if key not in data]
    if lost:
        raise EvidenceError(f"{path} has no tables {lost}; is it a Plaza recording?")
    for key, width in COLUMNS.items():
        table = data[key]
        if table.dtype.kind not in "fiu" or table.ndim != 2 or table.shape[1] != width:
            raise EvidenceError(
                f"{path}: the table {key} has shape {table.shape} of {table.dtype}; numbers in "
                f"{width} columns were due; is it a Plaza recording?"
            )
    return [np.asarray(data[key], dtype=float) for key in COLUMNS]
