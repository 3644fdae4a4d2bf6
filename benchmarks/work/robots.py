"""Robots that drive arcs under commanded velocities and see landmarks of a known map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from models import motion, networks, sensors
from models.networks import landmark, pose, sighting, velocity
from models.sinc import sinc
from pgm.cpds import CPD

Array = npt.NDArray[np.float64]

DT = 0.1
DRIVE = motion.Velocity(dt=DT)
START_STD = (0.1, 0.1, 0.05)
MOTION_STD = (0.03, 0.03, 0.02)
SENSOR_STD = (0.2, 0.05)
# A vehicle that navigates by reflectors: a laser, and odometry of a thousandth of the way.
PRECISE_START = (0.1, 0.1, 0.005)
PRECISE_MOTION = (0.0002, 0.0002, 0.00003)
PRECISE_SENSOR = (0.02, 0.002)


@dataclass(frozen=True, eq=False)
class Robots:
    """Runs of T steps, each with some sightings.

    Attributes
    ----------
    network : DynamicBayesianNetwork
    controls : ndarray
        (T, 2), or (runs, T, 2): speed [m/s] and turn rate [rad/s].
    landmarks : ndarray
        (T, seen, 2): those in sight at each step [m].
    readings : ndarray
        (runs, T, seen, 2): range [m] and bearing [rad].
    truth : ndarray
        (runs, T + 1, 3).
    """

    network: pgm.DynamicBayesianNetwork
    controls: Array
    landmarks: Array
    readings: Array
    truth: Array

    @property
    def runs(self) -> int:
        """How many robots, or simulations of one."""
        return len(self.readings)

    @property
    def steps(self) -> int:
        """T."""
        return len(self.landmarks)

    @property
    def start(self) -> tuple[Array, Array]:
        """Mean and covariance of the first pose."""
        return np.zeros(3), _cov(self.network.prior[0])

    @property
    def motion_cov(self) -> Array:
        """Covariance of the motion's noise, (3, 3)."""
        return _cov(self.network.transition[0])

    @property
    def sensor_cov(self) -> Array:
        """Covariance of a sighting's noise, (2, 2)."""
        return _cov(self.network.observation[0])

    def of(self, run: int) -> Array:
        """The controls of a run, (T, 2)."""
        return self.controls if self.controls.ndim == 2 else self.controls[run]

    def evidence(self, runs: slice | int = slice(None)) -> dict[pgm.Variable, Any]:
        """Of some runs, for pgm; of one without an axis of runs."""
        steps, seen, _ = self.landmarks.shape
        readings = self.readings[runs]
        seen_at = pgm.sightings(
            readings.reshape(*readings.shape[:-3], steps * seen, 2),
            np.repeat(np.arange(1, steps + 1), seen),
            {landmark: self.landmarks.reshape(-1, 2)},
        )
        controls = self.controls if self.controls.ndim == 2 else self.controls[runs]
        return {velocity: controls, sighting: seen_at}

    def dead_reckoning(self, run: int) -> Array:
        """Where the controls alone would have taken a run, (T + 1, 3)."""
        return drive(self.of(run), np.zeros((self.steps, 3)))


def draw(
    runs: int,
    steps: int,
    *,
    seen: int = 1,
    stay: int = 1,
    start_std: tuple[float, float, float] = START_STD,
    motion_std: tuple[float, float, float] = MOTION_STD,
    sensor_std: tuple[float, float] = SENSOR_STD,
    own_controls: bool = False,
    seed: int = 0,
) -> Robots:
    """Robots that start together; what they see lies ahead of them.

    Ahead, because then no bearing comes near ±π: dynamax and cuthbert do not wrap angles.

    Parameters
    ----------
    runs, steps : int
    seen : int
        Landmarks in sight at each step.
    stay : int
        How many steps the same ones are in sight.
    start_std : tuple of float
        Standard deviations of the first pose [m, m, rad].
    motion_std : tuple of float
        Standard deviations of the motion's noise a step [m, m, rad].
    sensor_std : tuple of float
        Standard deviations of a sighting [m, rad].
    own_controls : bool
        Whether each run is driven a little differently.
    seed : int
    """
    rng = np.random.default_rng(seed)
    controls = np.stack([np.ones(steps), 0.3 * np.sin(0.05 * np.arange(steps))], axis=-1)
    if own_controls:
        controls = controls + 0.1 * rng.standard_normal((runs, steps, 2))
    noise = np.array(motion_std) * rng.standard_normal((runs, steps, 3))
    start = np.array(start_std) * rng.standard_normal((runs, 3))
    truth = drive(controls, noise, start)
    # One robot sees landmarks near it; many see the same ones, near where they were sent.
    path = truth[0] if runs == 1 else drive(controls.reshape(-1, steps, 2)[0], 0.0 * noise[0])
    places = path[1::stay, None]
    side = rng.uniform(-1.0, 1.0, (len(places), seen)) + places[..., 2]
    away = rng.uniform(8.0, 25.0, (len(places), seen))
    offsets = away[..., None] * np.stack([np.cos(side), np.sin(side)], axis=-1)
    landmarks = np.repeat(places[..., :2] + offsets, stay, axis=0)[:steps]
    here = np.broadcast_to(truth[:, 1:, None], (runs, steps, seen, 3))
    exact = sensors.range_bearing(here, landmarks)
    readings = exact + np.array(sensor_std) * rng.standard_normal(exact.shape)
    network = networks.range_bearing(
        DT, start_std=start_std, motion_std=motion_std, sensor_std=sensor_std
    )
    return Robots(network, controls, landmarks, readings, truth)


def precise(steps: int) -> Robots:
    """A vehicle that navigates by reflectors, of which it sees four at each step."""
    return draw(
        1,
        steps,
        seen=4,
        stay=50,
        start_std=PRECISE_START,
        motion_std=PRECISE_MOTION,
        sensor_std=PRECISE_SENSOR,
    )


def drive(controls: Array, noise: Array, start: Array | None = None) -> Array:
    """All poses at once, (..., T + 1, 3): the motion's sums, where noise is added to each step."""
    if start is None:
        start = np.zeros((*noise.shape[:-2], 3))
    turns = DT * controls[..., 1]
    heading = start[..., None, 2] + _sums(turns + noise[..., 2])
    course = heading[..., :-1] + 0.5 * turns
    chord = DT * controls[..., 0] * sinc(0.5 * turns)
    east = start[..., None, 0] + _sums(chord * np.cos(course) + noise[..., 0])
    north = start[..., None, 1] + _sums(chord * np.sin(course) + noise[..., 1])
    return np.stack([east, north, heading], axis=-1)


def _cov(cpd: CPD) -> Array:
    """The covariance of a CPD's noise."""
    assert isinstance(cpd, pgm.GaussianCPD | pgm.NonlinearGaussianCPD)
    return np.array(cpd.cov)


def _sums(changes: Array) -> Array:
    """Running sums from 0, one more than there are changes."""
    sums = np.zeros((*changes.shape[:-1], changes.shape[-1] + 1))
    np.cumsum(changes, axis=-1, out=sums[..., 1:])
    return sums


__all__ = [
    "DRIVE",
    "DT",
    "Robots",
    "draw",
    "drive",
    "landmark",
    "pose",
    "precise",
    "sighting",
    "velocity",
]
