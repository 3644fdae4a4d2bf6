"""Targets of nearly constant velocity whose position is read: every CPD is linear."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

import pgm
from models import networks
from models.networks import fix, target

Array = npt.NDArray[np.float64]

DT = 0.1


@dataclass(frozen=True, eq=False)
class Tracking:
    """One target.

    Attributes
    ----------
    network : DynamicBayesianNetwork
    readings : ndarray
        (T, 2) [m].
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
        return {fix: self.readings}

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
            np.array(motion.matrices[target.previous]),
            np.array(motion.cov),
            np.array(sensor.matrices[target]),
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
