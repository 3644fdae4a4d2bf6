"""The Plaza recordings: a lawn mower with odometry that hears its distance to four beacons.

Recorded by J. Djugash, B. Hamner and S. Roth (Navigating with ranging radios, 2009); the gtsam
wheel carries them.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
import typer

from experiments.record import note
from models.networks import distance, landmark, travelled
from pgm.errors import EvidenceError
from pgm.recordings import Recording, read_plaza
from pgm.results import Timeline

Array = npt.NDArray[np.float64]

Data = Annotated[
    Literal["plaza1", "plaza2"] | None, typer.Option(help="Which recording; both without.")
]
File = Annotated[
    Path | None,
    typer.Option(help="The .mat file; that of the gtsam package without.", exists=True),
]


@dataclass(frozen=True)
class Setting:
    """The settings of one recording.

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
START_STD = (0.2, 0.2, 0.05)  # m, m, rad


@dataclass(frozen=True, eq=False)
class Log:
    """A recording on the times of its states.

    Attributes
    ----------
    recording : Recording
        With calibrated ranges, and what became of rows that were odd.
    timeline : Timeline
        Controls and ranges as evidence, and what became of every row.
    truth : ndarray
        (n, 3): satellite positions [m] and headings [rad].
    steps : ndarray of int
        (n,): of the states whose truth that is.
    beacons : ndarray
        (4, 2) [m].
    """

    recording: Recording
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


def chosen(experiment: str, data: str | None, path: Path | None) -> dict[str, Path]:
    """The files of the recordings that an experiment is asked for; none, with a note, without one.

    Raises
    ------
    EvidenceError
        If a path is given of a recording that is not named.
    """
    if path is not None and data is None:
        raise EvidenceError("--path names one file; say which recording it is: --data plaza1")
    files = {name: path or find(name) for name in ([data] if data else SETTINGS)}
    there = {name: file for name, file in files.items() if file is not None}
    if there.keys() == files.keys():
        return there
    note(
        f"{experiment}: the package gtsam, which carries the recordings, is not installed; "
        "`pip install gtsam`, or give the file with --data and --path"
    )
    return {}


def load(path: Path, setting: Setting, *, every_stamp: bool = False) -> Log:
    """Read a recording, calibrate its ranges, and lay it on the times of the true positions.

    With `every_stamp` there are states at the ranges' own times, too.
    """
    drive = read_plaza(path).calibrated("radio", setting.scale, setting.offset)
    truth = drive.truth
    assert truth is not None
    laid = drive.timeline(
        None if every_stamp else truth.stamps,
        odometry=travelled,
        sensors={distance: "radio"},
        landmark=landmark,
    )
    poses = truth.values + np.array([0.0, 0.0, setting.heading_shift])
    steps = np.searchsorted(laid.times, truth.stamps)
    return Log(drive, laid, poses, steps, np.array(list(drive.landmarks.values())))
