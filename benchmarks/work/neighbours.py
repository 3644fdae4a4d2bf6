"""Neighbours of the model of range and bearing: one ordinary thing more, and one robot each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

import pgm
from benchmarks.work import changes, robots
from benchmarks.work.robots import DT, Array, Robots
from models.networks import landmark, pose, sighting, velocity
from pgm.cpds.robust import RobustNoise

FEW, TEN = 3, 10  # sightings a step
CANDIDATES = 20
compass = pgm.Variable("c", components=("heading",), angles=("heading",))
fix = pgm.Variable("p", components=("east", "north"))
COMPASS_STD, FIX_STD = 0.05, 0.5  # [rad], [m]
RANGES = np.linspace(0.0, 100.0, 101)  # [m], of the table


@dataclass(frozen=True, eq=False)
class Sensed(Robots):
    """One run, whose evidence has more than sightings of known landmarks.

    Attributes
    ----------
    more : mapping of Variable
        Further readings, or others in their place.
    """

    more: Mapping[pgm.Variable, Any] = field(default_factory=dict)

    def evidence(self, runs: slice | int = slice(None)) -> dict[pgm.Variable, Any]:
        """As of any robots, and what there is more."""
        return super().evidence(runs) | dict(self.more)


def grouped(work: Robots) -> Robots:
    """Three sightings a step, linearised as one vector."""
    return changes.grouped(robots.draw(1, work.steps, seen=FEW))


def ten_landmarks(work: Robots) -> Robots:
    """Ten sightings a step, one after the other."""
    return robots.draw(1, work.steps, seen=TEN)


def three_sensors(work: Robots) -> Robots:
    """A heading and a position are read at each step, beside the sighting."""
    rng = np.random.default_rng(1)
    here = work.truth[0, 1:]
    reads = [
        pgm.LinearGaussianCPD(compass, given={pose: [[0.0, 0.0, 1.0]]}, cov=COMPASS_STD**2),
        pgm.LinearGaussianCPD(fix, given={pose: np.eye(2, 3)}, cov=FIX_STD**2 * np.eye(2)),
    ]
    network = work.network.replace(observation=[*work.network.observation, *reads])
    headings = here[:, 2:] + COMPASS_STD * rng.standard_normal((work.steps, 1))
    positions = here[:, :2] + FIX_STD * rng.standard_normal((work.steps, 2))
    # The variables have no value at step 0.
    return _sensed(work, network, {compass: _from_one(headings), fix: _from_one(positions)})


def robust(noise: RobustNoise) -> Callable[[Robots], Robots]:
    """A change of the work that makes the sensor's noise a robust one."""

    def change(work: Robots) -> Robots:
        (sensor,) = work.network.observation
        assert isinstance(sensor, pgm.NonlinearGaussianCPD)
        heavy = pgm.NonlinearGaussianCPD(
            sighting,
            given=sensor.given,
            function=sensor.function,
            cov=work.sensor_cov,
            jacobian=sensor.jacobian,
            noise=noise,
        )
        return replace(work, network=work.network.replace(observation=[heavy]))

    return change


def unknown_landmark(work: Robots) -> Robots:
    """Of each sighting it is not known which of twenty landmarks it is of."""
    steps = work.steps
    drawn = robots.draw(1, steps, stay=-(-steps // CANDIDATES))
    candidates = np.unique(drawn.landmarks.reshape(-1, 2), axis=0)
    which: dict[pgm.Variable, Any] = {landmark: pgm.unknown(candidates, association="likelihood")}
    seen = pgm.sightings(drawn.readings[0, :, 0], np.arange(1, steps + 1), which)
    return _sensed(drawn, drawn.network, {sighting: seen})


def branch(work: Robots) -> Robots:
    """The motion asks how fast the robot turns, which no trace can follow."""
    drive = pgm.NonlinearGaussianCPD(
        pose, given=(pose.previous, velocity), function=branching, cov=work.motion_cov
    )
    return replace(work, network=work.network.replace(transition=[drive]))


def table(work: Robots) -> Robots:
    """The sensor looks its range up in a table, which no trace can follow."""
    sensor = pgm.NonlinearGaussianCPD(
        sighting, given=(pose, landmark), function=looked_up, cov=work.sensor_cov
    )
    return replace(work, network=work.network.replace(observation=[sensor]))


def branching(x: Array, u: Array) -> Array:
    """The drive along a chord; whether all turn is asked before its length is divided, (..., 3)."""
    half = 0.5 * DT * u[..., 1]
    ratio = np.sin(half) / half if half.all() else np.sinc(half / np.pi)
    chord, course = DT * u[..., 0] * ratio, x[..., 2] + half
    return x + np.stack([chord * np.cos(course), chord * np.sin(course), 2.0 * half], axis=-1)


def looked_up(x: Array, m: Array) -> Array:
    """Range and bearing, the range by a table that says it as it is, (..., 2)."""
    away = m - x[..., :2]
    distance = np.interp(np.hypot(away[..., 0], away[..., 1]), RANGES, RANGES)
    return np.stack([distance, np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]], axis=-1)


def _from_one(readings: Array) -> Any:
    """Readings (T, d) of the steps from 1 on."""
    return pgm.sightings(readings, np.arange(1, len(readings) + 1), {})


def _sensed(
    work: Robots, network: pgm.DynamicBayesianNetwork, more: Mapping[pgm.Variable, Any]
) -> Sensed:
    """One run, of a network and with evidence of its own."""
    own = {each.name: getattr(work, each.name) for each in fields(Robots)}
    return Sensed(**own | {"network": network}, more=more)
