"""Recorded drives as networks see them: one motion, one sensor, for all recordings."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from models import motion, networks
from models.networks import distance, landmark, pose, sighting
from models.networks.covariances import diagonal
from pgm import recordings
from pgm.cpds.robust import RobustNoise
from pgm.recordings import Recording

Array = npt.NDArray[np.float64]

# The motion of a step as it is seen from its beginning [m, m, rad], and its duration [s].
moved = pgm.Variable("u", components=("forward", "left", "turn", "dt"))
# The folder of recordings, where it is not beside the checkout.
VARIABLE = "PGM_DATA"
_BESIDE = Path(__file__).parents[3] / "shared" / "data"


@dataclass(frozen=True)
class Setting:
    """What a network has to know of a recording that the recording does not say.

    Attributes
    ----------
    read : callable
        From the path to a `Recording`.
    sensor : str
        Whose sightings are read.
    rates : tuple of float
        Standard deviations of the motion's noise after one second, along, across, and of the
        heading [m, m, rad].
    sensor_std : tuple of float
        Of a range [m], or of a range and a bearing [m, rad].
    start_std : tuple of float
        Of the first pose [m, m, rad].
    start : tuple of float or None
        The first pose; that of the truth without. A heading of NaN in it is the truth's.
    heading_shift : float
        What true headings lack [rad].
    scale, offset : float
        range = scale · distance + offset, of which the range is freed.
    find : callable
        The path where the recording is on this machine; None where it is not.
    needs : str
        Where it comes from.
    about : str
        What of the above was fitted, to what.
    """

    read: Callable[[Path], Recording]
    sensor: str
    rates: tuple[float, float, float]
    sensor_std: tuple[float, ...]
    start_std: tuple[float, float, float] = (0.1, 0.1, 0.05)
    start: tuple[float, float, float] | None = None
    heading_shift: float = 0.0
    scale: float = 1.0
    offset: float = 0.0
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
    folder = Path(os.environ.get(VARIABLE) or _BESIDE) / name
    return folder if folder.is_dir() else None


_TUNED = "Range calibration and noise were fitted with the truth: a check of an engine, no claim."
_GTSAM = "pip install gtsam, or --path"
_FOLDER = "--path, or the folder of recordings named by PGM_DATA"
SETTINGS = {
    "plaza1": Setting(
        recordings.read_plaza,
        "radio",
        rates=(0.05, 0.05, 0.001),
        sensor_std=(0.508,),
        start_std=(0.2, 0.2, 0.05),
        scale=1.0693,
        offset=0.034,
        find=lambda: _in_gtsam("Plaza1_.mat"),
        needs=_GTSAM,
        about=_TUNED,
    ),
    "plaza2": Setting(
        recordings.read_plaza,
        "radio",
        rates=(0.05, 0.05, 0.02),
        sensor_std=(0.529,),
        start_std=(0.2, 0.2, 0.05),
        heading_shift=np.pi,
        scale=1.0694,
        offset=0.020,
        find=lambda: _in_gtsam("Plaza2_.mat"),
        needs=_GTSAM,
        about=_TUNED,
    ),
    "labyrinth": Setting(
        recordings.read_labyrinth,
        "uwb",
        rates=(0.01, 0.01, 0.02),
        sensor_std=(0.0857,),
        start_std=(0.1, 0.1, 0.3),
        start=(np.nan, np.nan, np.pi),
        offset=0.118,
        find=lambda: _beside("labyrinth"),
        needs=_FOLDER,
        about=_TUNED,
    ),
    "freiburg": Setting(
        recordings.read_freiburg,
        "landmark",
        rates=(0.02, 0.02, 0.01),
        sensor_std=(0.10, 0.048),
        start=(0.0, 0.0, 0.0),
        find=lambda: _beside("freiburg"),
        needs=_FOLDER,
        about="The sensor's noise is that of its residuals; there is no truth.",
    ),
    "mrclam": Setting(
        lambda path: recordings.read_mrclam(path).located(),
        "camera",
        rates=(0.05, 0.05, 0.05),
        sensor_std=(0.2, 0.1),
    ),
    "barfoot": Setting(
        recordings.read_barfoot, "laser", rates=(0.05, 0.05, 0.05), sensor_std=(0.05, 0.03)
    ),
}


@dataclass(frozen=True, eq=False)
class Drive:
    """A recording on the times of its states.

    Attributes
    ----------
    name : str
    setting : Setting
    recording : Recording
        Its ranges calibrated.
    timeline : Timeline
    truth : ndarray or None
        (T+1, 3): poses, NaN where not known; None where nothing is.
    start : ndarray
        (3,): the mean of the first pose.
    """

    name: str
    setting: Setting
    recording: Recording
    timeline: pgm.Timeline
    truth: Array | None
    start: Array

    @property
    def sensor(self) -> pgm.Variable:
        """The variable of sightings."""
        return distance if len(self.setting.sensor_std) == 1 else sighting

    @property
    def evidence(self) -> dict[pgm.Variable, Any]:
        """Motion and sightings."""
        return dict(self.timeline.evidence)

    @property
    def motion(self) -> dict[pgm.Variable, Any]:
        """The motion alone, for dead reckoning."""
        return {moved: self.timeline.evidence[moved]}

    @property
    def labels(self) -> npt.NDArray[np.str_]:
        """Whom each sighting of the evidence is of, (M,)."""
        places = {tuple(place[:2]): str(key) for key, place in self.recording.landmarks.items()}
        rows = self.evidence[self.sensor].given[landmark]
        return np.array([places[tuple(row)] for row in np.asarray(rows).tolist()])

    def network(
        self,
        *,
        start: npt.ArrayLike | None = None,
        start_std: npt.ArrayLike | None = None,
        noise: RobustNoise | None = None,
    ) -> pgm.DynamicBayesianNetwork:
        """The network of the drive, from its own start or another, with noise of its sensor."""
        setting = self.setting
        std = setting.start_std if start_std is None else np.asarray(start_std).tolist()
        sees = (
            networks.sees_range(setting.sensor_std[0])
            if self.sensor == distance
            else networks.sees_landmark(setting.sensor_std)
        )
        if noise is not None:
            sees = pgm.NonlinearGaussianCPD(
                sees.child, sees.given, sees.function, sees.cov, jacobian=sees.jacobian, noise=noise
            )
        return pgm.DynamicBayesianNetwork(
            prior=[pgm.GaussianCPD(pose, self.start if start is None else start, diagonal(std))],
            transition=[
                pgm.NonlinearGaussianCPD(
                    pose,
                    given=(pose.previous, moved),
                    function=motion.increment,
                    cov=networks.grows(setting.rates, moved),
                    jacobian={
                        pose.previous: motion.increment_by_state,
                        moved: motion.increment_by_control,
                    },
                )
            ],
            observation=[sees],
        )


def load(name: str, path: Path, *, every_stamp: bool = False) -> Drive:
    """Read a recording and lay it on the times of its motion, or with `every_stamp` of all rows."""
    setting = SETTINGS[name]
    return laid(name, setting, read(setting, path), every_stamp=every_stamp)


def read(setting: Setting, path: Path) -> Recording:
    """The recording, its ranges calibrated."""
    found = setting.read(path)
    if (setting.scale, setting.offset) == (1.0, 0.0):
        return found
    return found.calibrated(setting.sensor, setting.scale, setting.offset)


def laid(name: str, setting: Setting, found: Recording, *, every_stamp: bool = False) -> Drive:
    """A recording on the times of its states."""
    sensor = distance if len(setting.sensor_std) == 1 else sighting
    timeline = found.timeline(
        None if every_stamp else found.times,
        odometry=moved,
        sensors={sensor: setting.sensor},
        landmark=landmark,
    )
    truth = _truth(found, timeline.times, setting.heading_shift)
    start = np.full(3, np.nan) if setting.start is None else np.array(setting.start)
    if np.isnan(start).any():
        if truth is None or np.isnan(np.where(np.isnan(start), truth[0], start)).any():
            raise pgm.EvidenceError(f"{name}: the truth does not say where the drive begins")
        start = np.where(np.isnan(start), truth[0], start)
    return Drive(name, setting, found, timeline, truth, start)


def _truth(found: Recording, times: Array, shift: float) -> Array | None:
    if found.truth is None:
        return None
    known = found.truth.stamps
    inside = (times >= known[0]) & (times <= known[-1])
    truth = np.full((len(times), 3), np.nan)
    values = found.truth_at(times[inside]).values
    truth[inside, : values.shape[1]] = values
    truth[:, 2] += shift
    return truth
