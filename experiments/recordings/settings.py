"""Settings of recordings: noises, sensors and the like, which the recordings do not tell."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import pgm
from models import networks, sensors
from pgm import recordings
from pgm.cpds.robust import RobustNoise
from pgm.recordings import Recording

_ROBUST = pgm.Cauchy(1.0)
# The folder of recordings, where it is not beside the checkout.
VARIABLE = "PGM_DATA"
BESIDE = Path(__file__).parents[3] / "shared" / "data"


@dataclass(frozen=True)
class Kind:
    """A kind of readings: its variable, its function, and whether it is of landmarks."""

    variable: pgm.Variable
    sensor: sensors.Sensor
    of_landmarks: bool


KINDS = {
    "range": Kind(networks.distance, sensors.RANGE, True),
    "bearing": Kind(networks.bearing, sensors.BEARING, True),
    "range and bearing": Kind(networks.sighting, sensors.RANGE_BEARING, True),
    "position": Kind(networks.fix, sensors.POSITION, False),
    "pose": Kind(networks.pose_fix, sensors.POSE, False),
    "heading": Kind(networks.compass, sensors.HEADING, False),
}


@dataclass(frozen=True)
class Sensor:
    """A stream of a recording as a sensor of the network.

    Attributes
    ----------
    stream : str
        Its name in the recording; ``fixes`` and ``imu`` are such, too.
    reads : str
        One of `KINDS`.
    std : tuple of float
        Standard deviations of its components [m, rad].
    scale, offset : float
        range = scale · distance + offset, of which the range is freed.
    mount : tuple of float or None
        Where it is on the robot [m, m, rad]; where the recording says, without.
    """

    stream: str
    reads: str
    std: tuple[float, ...]
    scale: float = 1.0
    offset: float = 0.0
    mount: tuple[float, ...] | None = None

    @property
    def kind(self) -> Kind:
        """The kind of its readings."""
        return KINDS[self.reads]


@dataclass(frozen=True)
class Ways:
    """Settings of the methods.

    Attributes
    ----------
    gate : float
        The probability that a good reading stays within the gate.
    robust : RobustNoise
    lag : int
        Steps of the fixed lag.
    iterations : int
        Linearisations at the most; five times as many where sightings are weighed, too.
    """

    gate: float = 0.999
    robust: RobustNoise = _ROBUST
    lag: int = 20
    iterations: int = 10


_PLAIN = Ways()


@dataclass(frozen=True)
class Setting:
    """The settings of a recording's network.

    Attributes
    ----------
    read : callable
        From the path to a `Recording`.
    sensors : tuple of Sensor
        Whose readings are taken.
    rates : tuple of float
        Standard deviations of the motion's noise after one second, along, across, and of the
        heading [m, m, rad].
    start_std : tuple of float
        Of the first pose [m, m, rad].
    start : tuple of float or None
        The first pose; that of the truth without. A NaN in it is the truth's.
    heading_shift : float
        What true headings lack [rad].
    period : float or None
        Seconds from a state to the next; without, states are at the stamps of the motion.
    ways : Ways
    find : callable
        The path where the recording is on this machine; None where it is not.
    needs : str
        Where it comes from.
    about : str
        What of the above was fitted, to what.
    """

    read: Callable[[Path], Recording]
    sensors: tuple[Sensor, ...]
    rates: tuple[float, float, float]
    start_std: tuple[float, float, float] = (0.1, 0.1, 0.05)
    start: tuple[float, float, float] | None = None
    heading_shift: float = 0.0
    period: float | None = None
    ways: Ways = _PLAIN
    find: Callable[[], Path | None] = field(default=lambda: None)
    needs: str = "give --path"
    about: str = "The noise is a guess, tuned to nothing."


def _in_gtsam(name: str) -> Path | None:
    try:
        gtsam = importlib.import_module("gtsam")
    except ImportError:
        return None
    return Path(gtsam.findExampleDataFile(name))


def _beside(name: str) -> Path | None:
    folder = Path(os.environ.get(VARIABLE) or BESIDE) / name
    return folder if folder.is_dir() else None


_TUNED = "Range calibration and noise were fitted with the truth: a check of an engine, no claim."
_GTSAM = "pip install gtsam, or --path"
_FOLDER = "--path, or the folder of recordings named by PGM_DATA"
SETTINGS = {
    "plaza1": Setting(
        recordings.read_plaza,
        (Sensor("radio", "range", (0.508,), scale=1.0693, offset=0.034),),
        rates=(0.05, 0.05, 0.001),
        start_std=(0.2, 0.2, 0.05),
        find=lambda: _in_gtsam("Plaza1_.mat"),
        needs=_GTSAM,
        about=_TUNED,
    ),
    "plaza2": Setting(
        recordings.read_plaza,
        (Sensor("radio", "range", (0.529,), scale=1.0694, offset=0.020),),
        rates=(0.05, 0.05, 0.02),
        start_std=(0.2, 0.2, 0.05),
        heading_shift=np.pi,
        find=lambda: _in_gtsam("Plaza2_.mat"),
        needs=_GTSAM,
        about=_TUNED,
    ),
    "labyrinth": Setting(
        recordings.read_labyrinth,
        (Sensor("uwb", "range", (0.0857,), offset=0.118),),
        rates=(0.01, 0.01, 0.02),
        start_std=(0.1, 0.1, 0.3),
        start=(np.nan, np.nan, np.pi),
        find=lambda: _beside("labyrinth"),
        needs=_FOLDER,
        about=_TUNED,
    ),
    "freiburg": Setting(
        recordings.read_freiburg,
        (Sensor("landmark", "range and bearing", (0.10, 0.048)),),
        rates=(0.02, 0.02, 0.01),
        start=(0.0, 0.0, 0.0),
        find=lambda: _beside("freiburg"),
        needs=_FOLDER,
        about="The sensor's noise is that of its residuals; there is no truth.",
    ),
    "mrclam": Setting(
        recordings.read_mrclam,
        (Sensor("camera", "range and bearing", (0.2, 0.1)),),
        rates=(0.05, 0.05, 0.05),
    ),
    "barfoot": Setting(
        recordings.read_barfoot,
        (Sensor("laser", "range and bearing", (0.05, 0.03)),),
        rates=(0.05, 0.05, 0.05),
    ),
}
