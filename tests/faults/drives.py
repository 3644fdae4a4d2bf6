"""Recorded drives, laid out for the faults: networks, evidence as arrays, true places."""

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import pgm
from models import sensors
from models.motion import steps as motion
from pgm import recordings

DATA = Path(os.environ.get("PGM_DATA", Path(__file__).parents[3] / "shared" / "data"))
x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("forward", "left", "turn", "dt"))
m = pgm.Variable("m", components=("east", "north"))
r = pgm.Variable("r", components=("range",))
b = pgm.Variable("b", components=("range", "bearing"), angles=("bearing",))


@dataclass(frozen=True)
class Drive:
    """A recorded drive.

    Attributes
    ----------
    times : ndarray
        (T+1,), seconds.
    controls : ndarray
        (T, 4).
    step, values, places, subject : ndarray
        Of sightings: (M,), (M, d), (M, 2) and (M,).
    truth : ndarray
        (T+1, 2).
    start : tuple
        The prior's mean and deviations, each (3,).
    noise : tuple of float
        Of the motion for a second, in m, m and rad; and the deviations of a sighting.
    """

    sensor: pgm.Variable
    times: np.ndarray
    controls: np.ndarray
    step: np.ndarray
    values: np.ndarray
    places: np.ndarray
    subject: np.ndarray
    truth: np.ndarray
    start: tuple
    noise: tuple

    def model(self, start=None):
        """The network, whose prior has these means."""
        spread = np.square(self.noise[0])
        bearing = self.sensor is b
        function = sensors.range_bearing if bearing else sensors.range_only
        by_state = sensors.range_bearing_by_state if bearing else sensors.range_only_by_state

        def noise(u):
            return u[..., 3, None, None] * np.diag(spread)

        return pgm.DynamicBayesianNetwork(
            prior=[
                pgm.GaussianCPD(
                    x, self.start[0] if start is None else start, np.diag(np.square(self.start[1]))
                )
            ],
            transition=[
                pgm.NonlinearGaussianCPD(
                    x,
                    (x.previous, u),
                    lambda x, u: motion.increment(x, u[..., :3]),
                    cov=pgm.noise(noise, given=(u,)),
                    jacobian={x.previous: lambda x, u: motion.increment_by_state(x, u[..., :3])},
                )
            ],
            observation=[
                pgm.NonlinearGaussianCPD(
                    self.sensor,
                    (x, m),
                    function,
                    cov=np.diag(np.square(self.noise[1])),
                    jacobian={x: by_state},
                )
            ],
        )

    def evidence(self, controls=None, values=None, places=None):
        """Evidence, with some of it changed."""
        given = {m: self.places if places is None else places}
        values = self.values if values is None else values
        return {
            u: self.controls if controls is None else controls,
            self.sensor: pgm.sightings(values, step=self.step, given=given),
        }

    def part(self, last):
        """The first steps of it."""
        kept = self.step <= last
        return Drive(
            self.sensor,
            self.times[: last + 1],
            self.controls[:last],
            self.step[kept],
            self.values[kept],
            self.places[kept],
            self.subject[kept],
            self.truth[: last + 1],
            self.start,
            self.noise,
        )


def needs(path, what):
    if not path.exists():
        pytest.skip(f"{what} is not here: {path}; PGM_DATA names the folder of recorded data")
    return path


def laid(recording, sensor, name, start, noise, smooth=False):
    """A recording as a drive."""
    recording = recording.located()
    times = recording.times
    log = recording.timeline(times, odometry=u, sensors={sensor: name}, landmark=m, tolerance=0.5)
    seen = log.evidence[sensor]
    values, places = np.asarray(seen.values), np.asarray(seen.given[m])
    _, subject = np.unique(places, axis=0, return_inverse=True)
    parts = sensor, times, np.asarray(log.evidence[u]), np.asarray(seen.step), values, places
    truth = np.zeros((len(times), 2))
    if recording.truth is not None:
        inside = np.clip(times, *recording.truth.stamps[[0, -1]])
        truth = np.column_stack(
            [
                np.interp(inside, recording.truth.stamps, column)
                for column in recording.truth.values[:, :2].T
            ]
        )
    drive = Drive(*parts, subject.reshape(-1), truth, start, noise)
    if smooth:
        drive = Drive(
            *parts,
            subject.reshape(-1),
            pgm.smooth(drive.model(), drive.evidence())[x].mean[:, :2],
            start,
            noise,
        )
    return drive


@cache
def drive(name):
    """Plaza1, Plaza2, Labyrinth or Freiburg."""
    if name.startswith("Plaza"):
        gtsam = pytest.importorskip("gtsam", reason="gtsam's wheel has the Plaza recordings")
        pytest.importorskip("scipy")
        found = recordings.read_plaza(gtsam.findExampleDataFile(f"{name}_.mat"))
        one = name == "Plaza1"
        found = found.calibrated("radio", *((1.0693, 0.034) if one else (1.0694, 0.020)))
        pose = found.truth.values[0] + [0.0, 0.0, 0.0 if one else np.pi]
        noise = (0.05, 0.05, 0.001 if one else 0.02), (0.508 if one else 0.529,)
        return laid(found, r, "radio", (pose, (0.2, 0.2, 0.05)), noise)
    if name == "Labyrinth":
        found = recordings.read_labyrinth(needs(DATA / "labyrinth", "Labyrinth"))
        found = found.calibrated("uwb", offset=0.118)
        pose = [*found.truth.values[0], np.pi]
        return laid(found, r, "uwb", (pose, (0.1, 0.1, 0.3)), ((0.01, 0.01, 0.02), (0.0857,)))
    found = recordings.read_freiburg(needs(DATA / "freiburg", "Freiburg"))
    noise = (0.01, 0.01, 0.005), (0.10, 0.048)
    start = np.zeros(3), (0.05, 0.05, 0.05)
    return laid(found, b, "landmark", start, noise, smooth=True)
