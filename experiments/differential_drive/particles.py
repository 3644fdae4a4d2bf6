"""Particles beside the Kalman filter, on the linear problem."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.differential_drive.problems import MOTIONS, Problem
from models.networks import wheels

Array = npt.NDArray[np.float64]


def particle_means(problem: Problem, readings: Array, particles: pgm.Particles) -> Array:
    """The means of particles, one step at a time: all of the steps would fill the memory.

    Parameters
    ----------
    problem : Problem
        The linear one, whose readings have no observed parents.
    readings : ndarray
        (runs, M, 2): after every eighth step.
    particles : Particles

    Returns
    -------
    ndarray
        (runs, T+1, 2) [m].
    """
    robot = pgm.OnlineFilter(problem.network, belief=particles)
    belief = robot.initial()
    means = np.empty((len(readings), problem.steps + 1, problem.state.dimension))
    means[:, 0] = belief[problem.state].mean
    with warnings.catch_warnings():
        # How well a few particles do is the question.
        warnings.simplefilter("ignore", pgm.ParticleWarning)
        for t in range(1, problem.steps + 1):
            # The first belief is of one run, which the first inputs make as many as there are.
            speeds = np.broadcast_to(problem.controls[t - 1], (len(readings), 2))
            belief = robot.predict(belief, {wheels: speeds})
            if t % MOTIONS == 0:
                belief = robot.update(belief, {problem.reading: readings[:, t // MOTIONS - 1]})
            means[:, t] = belief[problem.state].mean
    return means


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
        means = particle_means(problem, values, pgm.Particles(count, seed=seed))
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
