"""The Freiburg recording as the exercise sees it: motions, and ranges after each of them.

It belongs to an exercise in the extended Kalman filter (Introduction to Mobile Robotics, University
of Freiburg, sheet 7, 2019). It is no part of the project.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

import pgm
from models.networks import distance, landmark, odometry
from pgm.recordings import Recording, Stream, read_freiburg
from pgm.recordings.readers.freiburg import SENSOR, WORLD

Array = npt.NDArray[np.float64]

# The folder of recordings, where it is not beside the checkout.
VARIABLE = "PGM_DATA"
_BESIDE = Path(__file__).parents[3] / "shared" / "data"


@dataclass(frozen=True, eq=False)
class Log:
    """A recording; a motion a step, its sightings seen after it.

    Attributes
    ----------
    recording : Recording
        A step a second.
    """

    recording: Recording

    @property
    def odometry(self) -> Array:
        """First turn [rad], translation [m], second turn [rad], of steps 1..T, (T, 3)."""
        assert self.recording.odometry is not None
        return self.recording.odometry.values

    @property
    def sightings(self) -> Stream:
        """Ranges [m] and bearings [rad], as they are written; stamps are steps, in 1..T."""
        return self.recording.sightings["landmark"]

    @property
    def step(self) -> npt.NDArray[np.int_]:
        """The step of each sighting, (M,)."""
        return self.sightings.stamps.astype(int)

    @property
    def seen(self) -> npt.NDArray[np.int_]:
        """The number of each sighting's landmark, (M,)."""
        assert self.sightings.subject is not None
        return self.sightings.subject

    @property
    def ranges(self) -> Array:
        """The range of each sighting, (M,) [m]."""
        return self.sightings["range"]

    @property
    def places(self) -> Array:
        """East and north of each sighting's landmark, (M, 2) [m]."""
        landmarks = self.recording.landmarks
        return np.array([landmarks[number] for number in self.seen.tolist()]).reshape(-1, 2)

    @property
    def landmarks(self) -> Array:
        """East and north of each landmark, (L, 2) [m]."""
        return np.array(list(self.recording.landmarks.values()))

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
    return Log(read_freiburg(folder))
