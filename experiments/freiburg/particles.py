"""The exercise with particles: the posterior as it is, to which filters are compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm
from experiments.freiburg import exercise
from experiments.freiburg.log import Log
from models.networks import distance, landmark, odometry, pose

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Particles:
    """The poses as particles have them, given the ranges up to each step.

    Attributes
    ----------
    belief : Gaussian
        Over steps 0..T: the Gaussian of their weighted mean and covariance, headings unwrapped as
        those of the filters are.
    cloud : ndarray
        (T+1, kept, 3): some of them, drawn by weight.
    log_evidence : float
        An estimate of the exact one.
    effective : ndarray
        (T+1,): 1 / Σ w², the number of particles that carry the weight.
    """

    belief: pgm.Gaussian
    cloud: Array
    log_evidence: float
    effective: Array


def particle_filter(log: Log, count: int, seed: int, kept: int = 500) -> Particles:
    """Filter the exercise's network with particles, one step at a time: all would fill the memory.

    Parameters
    ----------
    log : Log
    count : int
        Of particles.
    seed : int
    kept : int
        Size of the cloud.

    Returns
    -------
    Particles
    """
    steps = len(log.odometry)
    means, covs = np.empty((steps + 1, 3)), np.empty((steps + 1, 3, 3))
    effective, cloud = np.empty(steps + 1), np.empty((steps + 1, kept, 3))
    robot = pgm.OnlineFilter(exercise.network(), belief=pgm.Particles(count, seed=seed))
    belief, rng = robot.initial(), np.random.default_rng(seed)
    for t in range(steps + 1):
        if t:
            belief = robot.predict(belief, {odometry: log.odometry[t - 1]})
        seen = log.step == t
        if seen.any():
            ranges = pgm.sightings(log.ranges[seen, None], given={landmark: log.places[seen]})
            belief = robot.update(belief, {distance: ranges})
        found = belief[pose]
        means[t], covs[t] = _moments(found.states, found.weights)
        cloud[t] = found.sample(kept, rng=rng)
        effective[t] = float(found.effective)
    gaussian = pgm.Gaussian(pose, means, covs, steps=np.arange(steps + 1))
    return Particles(gaussian, cloud, float(belief.log_evidence), effective)


def _moments(states: Array, weights: Array) -> tuple[Array, Array]:
    """Mean (d,) and covariance (d, d) of particles, angles taken for numbers."""
    mean = weights @ states
    apart = states - mean
    return mean, (weights[:, None] * apart).T @ apart
