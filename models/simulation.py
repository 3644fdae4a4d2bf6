"""Simulated drives among landmarks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from models.networks import landmark, pose, sighting, velocity

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive, or several runs of it.

    Attributes
    ----------
    truth : ndarray
        (*runs, T+1, 3): the poses [m, m, rad].
    landmarks : ndarray
        (L, 2) [m].
    evidence : dict
        Controls and sightings, ready for `pgm.infer`.
    """

    truth: Array
    landmarks: Array
    evidence: dict[pgm.Variable, Any]


def figure_of_eight(steps: int, dt: float, *, speed: float = 1.0, period: float = 25.0) -> Array:
    """Velocities (T, 2) [m/s, rad/s] that drive one loop to the left, the next to the right."""
    time = dt * np.arange(steps)
    turn = 2.0 * np.pi / period * np.where(np.floor(time / period) % 2 == 0, 1.0, -1.0)
    return np.stack([np.full(steps, speed), turn], axis=-1)


def scatter(
    count: int, extent: tuple[float, float, float, float], rng: np.random.Generator
) -> Array:
    """Landmarks (count, 2) [m], uniform over (west, east, south, north)."""
    west, east, south, north = extent
    return rng.uniform((west, south), (east, north), size=(count, 2))


def drive(
    network: pgm.DynamicBayesianNetwork,
    controls: Array,
    landmarks: Array,
    *,
    reach: float,
    runs: int | tuple[int, ...] = (),
    rng: np.random.Generator,
) -> Drive:
    """Drive a robot and let it see, at each step, the landmarks within reach.

    Parameters
    ----------
    network : DynamicBayesianNetwork
        As `models.networks.range_bearing` declares it.
    controls : ndarray
        (T, 2) velocities.
    landmarks : ndarray
        (L, 2).
    reach : float
        How far the sensor sees [m].
    runs : int or tuple of int
        Leading axes of independent runs; what one does not see is a reading not taken.
    rng : numpy.random.Generator
        What draws.
    """
    steps = len(controls)
    at = np.repeat(np.arange(steps + 1), len(landmarks))
    seen = np.tile(landmarks, (steps + 1, 1))
    full = network.sample(
        {velocity: controls, sighting: pgm.sightings(step=at, given={landmark: seen})},
        runs=runs,
        rng=rng,
    )
    truth, readings = full[pose], full[sighting]
    away = np.linalg.norm(truth[..., at, :2] - seen, axis=-1)
    readings = np.where((away <= reach)[..., None], readings, np.nan)
    kept = ~np.isnan(readings[..., 0]).all(axis=tuple(range(readings.ndim - 2)))
    evidence = {
        velocity: controls,
        sighting: pgm.sightings(readings[..., kept, :], at[kept], {landmark: seen[kept]}),
    }
    return Drive(truth, landmarks, evidence)
