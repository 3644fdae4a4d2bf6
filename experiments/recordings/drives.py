"""Recorded drives as networks see them: one motion for all recordings, and their sensors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.recordings.settings import SETTINGS, Sensor, Setting
from models import motion, networks
from models.networks import landmark, pose
from models.networks.covariances import diagonal
from pgm.cpds.robust import RobustNoise
from pgm.recordings import Recording, Stream

Array = npt.NDArray[np.float64]

# The motion of a step as it is seen from its beginning [m, m, rad], and its duration [s].
moved = pgm.Variable("u", components=("forward", "left", "turn", "dt"))


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
    timeline: pgm.results.Timeline
    truth: Array | None
    start: Array

    @cached_property
    def sensors(self) -> dict[pgm.Variable, Sensor]:
        """The sensors, by their variables."""
        return named(self.setting.sensors)

    @property
    def evidence(self) -> dict[pgm.Variable, Any]:
        """Motion and readings."""
        return dict(self.timeline.evidence)

    @property
    def motion(self) -> dict[pgm.Variable, Any]:
        """The motion alone, for dead reckoning."""
        return {moved: self.timeline.evidence[moved]}

    @property
    def labels(self) -> dict[pgm.Variable, npt.NDArray[np.str_]]:
        """The landmark that each sighting of the evidence is of, (M,)."""
        places = {tuple(place[:2]): str(key) for key, place in self.recording.landmarks.items()}
        found = {}
        for variable, sensor in self.sensors.items():
            if sensor.kind.of_landmarks:
                rows = np.asarray(self.evidence[variable].given[landmark]).tolist()
                found[variable] = np.array([places[tuple(row)] for row in rows])
        return found

    def network(
        self,
        *,
        start: npt.ArrayLike | None = None,
        start_std: npt.ArrayLike | None = None,
        noise: RobustNoise | None = None,
    ) -> pgm.DynamicBayesianNetwork:
        """The network of the drive, from its own start or another, with noise of its sensors."""
        setting = self.setting
        std = setting.start_std if start_std is None else np.asarray(start_std).tolist()
        observation = []
        for variable, sensor in self.sensors.items():
            mount = sensor.mount
            if mount is None and sensor.stream in self.recording.mounts:
                mount = tuple(self.recording.mounts[sensor.stream].tolist())
            parents = (pose, landmark) if sensor.kind.of_landmarks else (pose,)
            cov = diagonal(sensor.std)
            observation.append(
                networks.senses(variable, sensor.kind.sensor, parents, cov, mount, noise=noise)
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
            observation=observation,
        )


def named(sensors: tuple[Sensor, ...]) -> dict[pgm.Variable, Sensor]:
    """Sensors by variables; of a lone one of landmarks its kind's, else one of its name."""
    if len(sensors) == 1 and sensors[0].kind.of_landmarks:
        return {sensors[0].kind.variable: sensors[0]}
    found = {}
    for sensor in sensors:
        alike, name = sensor.kind.variable, sensor.stream
        if name in (pose.name, moved.name, landmark.name):
            name = f"z of {name}"
        variable = pgm.Variable(name, components=alike.components, angles=alike.angles)
        found[variable] = sensor
    return found


def load(name: str, path: Path, *, every_stamp: bool = False) -> Drive:
    """Read a recording and lay it on the times of its motion, or with `every_stamp` of all rows."""
    setting = SETTINGS[name]
    return laid(name, setting, read(setting, path), every_stamp=every_stamp)


def read(setting: Setting, path: Path) -> Recording:
    """The recording, its ranges calibrated, without sightings of what has no place.

    Raises
    ------
    EvidenceError
        If it has no such sensor, or one that does not read what it should.
    """
    found = setting.read(path)
    for sensor in setting.sensors:
        _require(found, sensor)
        if (sensor.scale, sensor.offset) != (1.0, 0.0):
            found = found.calibrated(sensor.stream, sensor.scale, sensor.offset)
    of_landmarks = any(sensor.kind.of_landmarks for sensor in setting.sensors)
    return found.located() if of_landmarks else found


def _require(found: Recording, sensor: Sensor) -> None:
    """Refuse a sensor that the recording does not have."""
    known: dict[str, Stream | None] = dict(found.sightings)
    known |= {"fixes": found.fixes, "imu": found.imu}
    stream = known.get(sensor.stream)
    if stream is None:
        has = ", ".join(name for name, each in known.items() if each is not None) or "none"
        raise pgm.EvidenceError(f"{found._title}: no sensor {sensor.stream!r}; it has {has}")
    due = sensor.kind.variable.components
    if lost := [name for name in due if name not in stream.components]:
        raise pgm.EvidenceError(
            f"{sensor.stream} has the components {', '.join(stream.components)}; to read "
            f"{sensor.reads} it lacks {', '.join(lost)}"
        )
    if sensor.kind.of_landmarks and stream.subject is None:
        raise pgm.EvidenceError(
            f"{sensor.stream} does not say which landmark a reading is of, which {sensor.reads} "
            "needs: name its column, subject"
        )
    if sensor.kind.of_landmarks and not found.landmarks:
        raise pgm.EvidenceError(
            f"{sensor.stream} reads {sensor.reads}, and the recording has no map; give the places "
            "of its landmarks"
        )


def laid(name: str, setting: Setting, found: Recording, *, every_stamp: bool = False) -> Drive:
    """A recording on the times of its states.

    Where the start is the truth's, what was driven before the truth begins is left out.

    Raises
    ------
    EvidenceError
        If nothing says where the drive begins.
    """
    start = np.full(3, np.nan) if setting.start is None else np.array(setting.start)
    if np.isnan(start).any() and found.truth is not None and len(found.truth):
        found = _from_truth(name, found)
    times = None if every_stamp else found.times
    if setting.period is not None and not every_stamp:
        times = found.resampled(period=setting.period).times
    sensors = named(setting.sensors)
    of_landmarks = any(sensor.kind.of_landmarks for sensor in sensors.values())
    timeline = found.timeline(
        times,
        odometry=moved,
        sensors={variable: sensor.stream for variable, sensor in sensors.items()},
        landmark=landmark if of_landmarks else None,
    )
    truth = _truth(found, timeline.times, setting.heading_shift)
    if np.isnan(start).any():
        if truth is None or np.isnan(np.where(np.isnan(start), truth[0], start)).any():
            raise pgm.EvidenceError(
                f"{name}: the truth does not say where the drive begins; give the start's mean"
            )
        start = np.where(np.isnan(start), truth[0], start)
    return Drive(name, setting, found, timeline, truth, start)


def _from_truth(name: str, found: Recording) -> Recording:
    """The recording from where its truth begins."""
    assert found.truth is not None
    (first, last), known = found.times[[0, -1]].tolist(), found.truth.stamps[[0, -1]].tolist()
    if known[0] >= last or known[1] <= first:
        raise pgm.EvidenceError(
            f"{name}: the motion covers {first:.9g} s to {last:.9g} s, and the truth "
            f"{known[0]:.9g} s to {known[1]:.9g} s; they have no time in common: are their clocks "
            "the same?"
        )
    return found if known[0] <= first else found.between(known[0], last)


def _truth(found: Recording, times: Array, shift: float) -> Array | None:
    if found.truth is None or not len(found.truth):
        return None
    known = found.truth.stamps
    inside = (times >= known[0]) & (times <= known[-1])
    truth = np.full((len(times), 3), np.nan)
    if inside.any():
        values = found.truth_at(times[inside]).values
        truth[inside, : values.shape[1]] = values
    truth[:, 2] += shift
    return truth
