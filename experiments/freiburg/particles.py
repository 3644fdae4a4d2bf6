"""A bootstrap particle filter of the exercise, by its equations, the network apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm
from experiments.freiburg.exercise import MOTION, SENSOR, START
from experiments.freiburg.log import Log
from experiments.resampling import resampled
from models.networks import pose

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Particles:
    """The poses as particles have them, given the ranges up to each step.

    Attributes
    ----------
    belief : Gaussian
        Over steps 0..T: the Gaussian of their weighted mean and covariance.
    cloud : ndarray
        (T+1, kept, 3): some of them, each as likely as the next.
    log_evidence : float
        Σ ln of the mean weight; an estimate of the exact one.
    effective : ndarray
        (T+1,): 1 / Σ w², the number of particles that carry the weight.
    """

    belief: pgm.Gaussian
    cloud: Array
    log_evidence: float
    effective: Array


def particle_filter(log: Log, count: int, rng: np.random.Generator, kept: int = 500) -> Particles:
    """Move particles by the odometry, weigh them by the ranges, draw them anew, at every step.

    Parameters
    ----------
    log : Log
    count : int
        Of particles.
    rng : numpy.random.Generator
    kept : int
        Size of the cloud, at most.

    Returns
    -------
    Particles

    Notes
    -----
    Gordon, Salmond & Smith (1993).
    """
    steps, every = len(log.odometry), max(count // kept, 1)
    start, drift = (np.sqrt(variances)[:, None] for variances in (START, MOTION))
    means, covs = np.zeros((steps + 1, 3)), np.zeros((steps + 1, 3, 3))
    effective, cloud = np.empty(steps + 1), []
    log_evidence = 0.0
    x = start * rng.standard_normal((3, count))
    for t in range(steps + 1):
        if t:
            rot1, trans, rot2 = log.odometry[t - 1]
            course = x[2] + rot1
            moved = np.stack([trans * np.cos(course), trans * np.sin(course), course - x[2] + rot2])
            x = x + moved + drift * rng.standard_normal(x.shape)
        log_weight = np.zeros(count)
        for (east, north), heard in _heard(log, t):
            away = heard - np.hypot(east - x[0], north - x[1])
            log_weight -= 0.5 * (away**2 / SENSOR + np.log(2.0 * np.pi * SENSOR))
        most = log_weight.max()
        weight = np.exp(log_weight - most)
        log_evidence += float(most + np.log(weight.mean()))
        weight /= weight.sum()
        means[t] = x @ weight
        apart = x - means[t][:, None]
        covs[t] = (weight * apart) @ apart.T
        effective[t] = 1.0 / (weight @ weight)
        # Drawn anew also where nothing was heard: a comb of equal weights takes each once.
        x = x[:, resampled(weight[None], rng)[0]]
        # A copy: a view would keep all particles of every step.
        cloud.append(x[:, ::every][:, :kept].T.copy())
    belief = pgm.Gaussian(pose, means, covs, steps=np.arange(steps + 1))
    return Particles(belief, np.array(cloud), log_evidence, effective)


def _heard(log: Log, step: int) -> list[tuple[Array, float]]:
    """Landmarks and their ranges at a step."""
    at = log.step == step
    return list(zip(log.places[at], log.ranges[at].tolist(), strict=True))
