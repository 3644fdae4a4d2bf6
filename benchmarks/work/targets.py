"""Linear networks: targets of nearly constant velocity whose position is read, and systems."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

import pgm
from models import networks

Array = npt.NDArray[np.float64]

DT = 0.1


@dataclass(frozen=True, eq=False)
class Tracking:
    """One target, or system.

    Attributes
    ----------
    network : DynamicBayesianNetwork
    readings : ndarray
        (T, d), of a target [m].
    """

    network: pgm.DynamicBayesianNetwork
    readings: Array

    @property
    def steps(self) -> int:
        """T."""
        return len(self.readings)

    @property
    def evidence(self) -> dict[pgm.Variable, Array]:
        """For pgm."""
        return {self.network.sensors[0]: self.readings}

    @property
    def state(self) -> pgm.Variable:
        """The one hidden variable."""
        return self.network.states[0]

    @cached_property
    def parameters(self) -> Parameters:
        """For the others."""
        prior, motion, sensor = self.network.cpds
        assert isinstance(prior, pgm.GaussianCPD)
        assert isinstance(motion, pgm.LinearGaussianCPD)
        assert isinstance(sensor, pgm.LinearGaussianCPD)
        return Parameters(
            np.array(prior.mean),
            np.array(prior.cov),
            np.array(motion.matrices[self.state.previous]),
            np.array(motion.cov),
            np.array(sensor.matrices[self.state]),
            np.array(sensor.cov),
        )


@dataclass(frozen=True, eq=False)
class Parameters:
    """x' = F x + n and z = H x + e."""

    mean: Array
    cov: Array
    F: Array
    motion_cov: Array
    H: Array
    sensor_cov: Array


def draw(steps: int, seed: int = 0) -> Tracking:
    """One target, its motion and readings drawn from the network."""
    network = networks.constant_velocity(DT)
    rng = np.random.default_rng(seed)
    p = Tracking(network, np.empty((0, 2))).parameters
    noise = rng.multivariate_normal(np.zeros(4), p.motion_cov, steps)
    # Velocities are sums of their noise, and positions of velocities and theirs.
    first = rng.multivariate_normal(p.mean, p.cov)
    velocity = first[2:] + np.concatenate([np.zeros((1, 2)), np.cumsum(noise[:, 2:], axis=0)])
    position = first[:2] + np.cumsum(DT * velocity[:-1] + noise[:, :2], axis=0)
    readings = position + rng.multivariate_normal(np.zeros(2), p.sensor_cov, steps)
    return Tracking(network, readings)


def system(size: int, steps: int, seed: int = 0) -> Tracking:
    """A stable linear system of so many components, of which half as many combinations are read."""
    rng, half = np.random.default_rng(seed), size // 2
    state, reading = (
        pgm.Variable(name, [f"{name[0]}{k}" for k in range(count)])
        for name, count in (("state", size), ("reading", half))
    )
    turn, _ = np.linalg.qr(rng.standard_normal((size, size)))
    rows = rng.standard_normal((half, size)) / np.sqrt(size)
    network = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(state, np.zeros(size), np.eye(size))],
        transition=[
            pgm.LinearGaussianCPD(state, {state.previous: 0.95 * turn}, cov=0.1 * np.eye(size))
        ],
        observation=[pgm.LinearGaussianCPD(reading, {state: rows}, cov=0.5 * np.eye(half))],
    )
    drawn = network.sample(steps=steps, rng=rng)
    return Tracking(network, np.asarray(drawn[reading])[-steps:])
