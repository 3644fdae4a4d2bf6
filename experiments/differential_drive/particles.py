"""Particles beside the Kalman filter, on the linear problem."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.differential_drive.problems import MOTIONS, Problem
from models.networks import wheels

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Followed:
    """Drives followed by particles.

    Attributes
    ----------
    mean, cov : ndarray
        (runs, T+1, n) and (runs, T+1, n, n), given the readings up to each step.
    log_evidence : ndarray
        (runs,).
    number : ndarray of int
        (runs, T+1): of particles.
    """

    mean: Array
    cov: Array
    log_evidence: Array
    number: npt.NDArray[np.int_]


def follow(problem: Problem, readings: Array, particles: pgm.Particles) -> Followed:
    """Filter drives with particles, one step at a time: all of the steps would fill the memory.

    Parameters
    ----------
    problem : Problem
    readings : ndarray
        (runs, M, 2): after every eighth step.
    particles : Particles

    Returns
    -------
    Followed
    """
    runs, n = len(readings), problem.state.dimension
    mean, cov = np.empty((problem.steps + 1, runs, n)), np.empty((problem.steps + 1, runs, n, n))
    number = np.empty((problem.steps + 1, runs), dtype=int)
    for t, belief in enumerate(_beliefs(problem, readings, particles)):
        found = belief[problem.state]
        mean[t], cov[t], number[t] = found.mean, found.cov, found.number
    return Followed(mean.swapaxes(0, 1), cov.swapaxes(0, 1), belief.log_evidence, number.T)


@dataclass(frozen=True, eq=False)
class Cloud:
    """One drive followed by particles, as an animation shows it.

    Attributes
    ----------
    mean : ndarray
        (T+1, n), given the readings up to each step.
    states : ndarray
        (T+1, N, n): N draws of each belief, equally weighted.
    """

    mean: Array
    states: Array


def cloud(problem: Problem, readings: Array, count: int, *, seed: int) -> Cloud:
    """Follow one drive, its readings (M, 2), with so many particles."""
    particles = pgm.Particles(count, seed=seed)
    every = [belief[problem.state] for belief in _beliefs(problem, readings[None], particles)]
    states = [found.sample(count, rng=seed).reshape(count, -1) for found in every]
    return Cloud(np.stack([found.mean.reshape(-1) for found in every]), np.stack(states))


def _beliefs(
    problem: Problem, readings: Array, particles: pgm.Particles
) -> Iterator[pgm.results.OnlineBelief]:
    """The belief of drives, readings (runs, M, 2), at each step."""
    runs = len(readings)
    robot = pgm.OnlineFilter(problem.network, belief=particles)
    belief = robot.initial()
    with warnings.catch_warnings():
        # How well a few particles do is the question.
        warnings.simplefilter("ignore", pgm.ParticleWarning)
        for t in range(problem.steps + 1):
            if t:
                # The first belief is of one run, which inputs make as many as there are.
                speeds = np.broadcast_to(problem.controls[t - 1], (runs, 2))
                belief = robot.predict(belief, {wheels: speeds})
            if t and t % MOTIONS == 0:
                read = {problem.reading: readings[:, t // MOTIONS - 1]}
                belief = robot.update(belief, {**read, **problem.given})
            yield belief


def against_kalman(
    problem: Problem,
    truth: Array,
    evidence: Mapping[pgm.Variable, Any],
    counts: tuple[int, ...],
    *,
    drives: int,
    seed: int,
) -> dict[str, Any]:
    """RMSE [m] of the Kalman filter and of particles on the same drives, the first of them.

    ``excess`` is the particles' mean square error less the Kalman filter's [m²], with its standard
    error over the drives, and ``worse`` the fraction of drives where it is above 0.
    """
    kalman = pgm.filter(problem.network, evidence)[problem.state].mean
    best = _square_error(kalman, truth)[:drives]
    found: dict[str, Any] = {
        "kalman": float(np.sqrt(best.mean())),
        "drives": len(best),
        "particles": {},
    }
    values = evidence[problem.reading].values[:drives]
    for count in counts:
        means = follow(problem, values, pgm.Particles(count, seed=seed)).mean
        error = _square_error(means, truth[:drives])
        excess = error - best
        found["particles"][str(count)] = {
            "rmse": float(np.sqrt(error.mean())),
            "excess": float(excess.mean()),
            "excess_se": float(excess.std(ddof=1) / np.sqrt(len(excess))),
            "worse": float((excess > 0.0).mean()),
        }
    return found


def _square_error(means: Array, truth: Array) -> Array:
    """Mean square error of each run [m²], (runs,), the known start apart."""
    error: Array = np.sum((means - truth)[:, 1:] ** 2, axis=-1).mean(axis=1)
    return error
