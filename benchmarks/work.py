"""The work that every library is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm
from models import networks
from models.networks import landmark, pose, sighting, velocity

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Work:
    """Robots that drive the same controls and see one landmark a step, by range and bearing.

    Attributes
    ----------
    network : DynamicBayesianNetwork
    controls : ndarray
        (T, 2).
    landmarks : ndarray
        (T, 2): the one seen at each step.
    readings : ndarray
        (robots, T, 2).
    """

    network: pgm.DynamicBayesianNetwork
    dt: float
    start: Array
    start_cov: Array
    motion_cov: Array
    sensor_cov: Array
    controls: Array
    landmarks: Array
    readings: Array

    def evidence(self, robots: slice | int) -> dict[pgm.Variable, object]:
        """Of some robots, for pgm; of one without an axis of runs."""
        steps = np.arange(1, len(self.controls) + 1)
        seen = pgm.sightings(self.readings[robots], steps, {landmark: self.landmarks})
        return {velocity: self.controls, sighting: seen}


def range_bearing(robots: int, steps: int, seed: int = 0) -> Work:
    """Draw the work."""
    rng = np.random.default_rng(seed)
    dt = 0.1
    network = networks.range_bearing(dt)
    controls = np.stack([np.ones(steps), 0.3 * np.sin(0.05 * np.arange(steps))], axis=-1)
    field = rng.uniform(-15.0, 15.0, size=(8, 2)) + np.array([8.0, 0.0])
    landmarks = field[rng.integers(0, len(field), steps)]
    at = pgm.sightings(step=np.arange(1, steps + 1), given={landmark: landmarks})
    sample = network.sample({velocity: controls, sighting: at}, runs=robots, rng=rng)
    prior, transition, sensor = network.cpds
    return Work(
        network=network,
        dt=dt,
        start=np.zeros(pose.dimension),
        start_cov=np.array(prior.cov),
        motion_cov=np.array(transition.cov),
        sensor_cov=np.array(sensor.cov),
        controls=controls,
        landmarks=landmarks,
        readings=sample[sighting],
    )
