"""Recorded drives begun with a wide belief."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

import pgm
from experiments.freiburg import exercise
from experiments.recordings import drives
from experiments.recordings.drives import Drive
from experiments.recordings.settings import SETTINGS, Sensor, Setting

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """A recording, and how little its start is known.

    Attributes
    ----------
    setting : Setting
        Of the recording, with the wide start.
    seconds : float
        The part of the drive from its beginning that is judged [s].
    oracle : Grid, Particles or None
        The kind of beliefs that is the oracle; a grid where cells narrower than the noise fit.
    about : str
        The start, in words.
    """

    setting: Setting
    seconds: float
    oracle: pgm.Grid | pgm.Particles | None
    about: str


def _wide(name: str, *start_std: float) -> Setting:
    east, north, heading = start_std
    return replace(SETTINGS[name], start_std=(east, north, heading))


_EXERCISE = replace(
    SETTINGS["freiburg"],
    rates=tuple(np.sqrt(exercise.MOTION).tolist()),
    sensors=(Sensor("landmark", "range", (float(np.sqrt(exercise.SENSOR)),)),),
    start_std=tuple(np.sqrt(exercise.START).tolist()),
)
CASES = {
    "plaza2": Case(_wide("plaza2", 15.0, 15.0, 0.05), 10.0, None, "15 m"),
    "labyrinth": Case(
        _wide("labyrinth", 1.0, 1.0, 1.0),
        10.0,
        pgm.Particles(200_000, seed=0),  # 4 mm of noise a step: cells would blur the belief
        "1 m and 1 rad",
    ),
    "freiburg": Case(
        _EXERCISE,
        330.0,
        pgm.Grid({"east": (-6.0, 18.0, 60), "north": (-6.0, 18.0, 60), "heading": 48}),
        "1 m and 1 rad, and the exercise's noise",
    ),
}


def load(name: str) -> Drive | None:
    """The part of a drive that is judged; None where the recording is not here."""
    case = CASES[name]
    path = case.setting.find()
    if path is None:
        return None
    whole = drives.laid(name, case.setting, drives.read(case.setting, path))
    first, last = whole.timeline.times[[0, -1]].tolist()
    part = whole.recording.between(first, min(first + case.seconds, last))
    return drives.laid(name, case.setting, part)


def starts(drive: Drive, count: int, rng: np.random.Generator) -> Array:
    """Means of the first pose, drawn about the true one with their own deviations, (count, 3)."""
    return drive.start + np.array(drive.setting.start_std) * rng.standard_normal((count, 3))
