"""A bootstrap particle filter beside the Kalman filter, on the linear problem."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.differential_drive.problems import DT, MOTIONS, RADIUS, SCALE, Problem
from experiments.resampling import resampled

Array = npt.NDArray[np.float64]


def particle_means(
    controls: Array,
    readings: Array,
    std: Mapping[str, float],
    count: int,
    rng: np.random.Generator,
) -> Array:
    """The means of a bootstrap particle filter of problem 1, by its equations, network apart.

    Particles are moved by the model, weighed by each reading, and then drawn anew (Gordon, Salmond
    & Smith 1993).

    Parameters
    ----------
    controls : ndarray
        (T, 2): wheel speeds [rad/s].
    readings : ndarray
        (runs, M, 2): after every eighth step.
    std : mapping of str to float
        As `problems.deviations` gives them.
    count : int
        Of particles.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray
        (runs, T+1, 2) [m].
    """
    runs, steps = len(readings), len(controls)
    process = np.sqrt(DT) * np.array([std["w_x"], std["w_y"]])
    sensor = np.array([std["r_x"], std["r_y"]])
    x, means = np.zeros((runs, count, 2)), np.zeros((runs, steps + 1, 2))
    for t in range(1, steps + 1):
        x += 0.5 * RADIUS * DT * controls[t - 1].sum() + process * rng.standard_normal(x.shape)
        if t % MOTIONS:
            means[:, t] = x.mean(axis=1)
            continue
        off = (readings[:, t // MOTIONS - 1, None] - SCALE * x) / sensor
        log_weight = -0.5 * (off**2).sum(axis=-1)
        weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        means[:, t] = np.einsum("rp,rpn->rn", weight, x)
        x = np.take_along_axis(x, resampled(weight, rng)[..., None], axis=1)
    return means


def against_kalman(
    problem: Problem,
    truth: Array,
    evidence: Mapping[pgm.Variable, Any],
    std: Mapping[str, float],
    counts: tuple[int, ...],
    rng: np.random.Generator,
) -> dict[str, Any]:
    """RMSE [m] of the Kalman filter and of particle filters on the same drives.

    ``excess`` is a particle filter's mean square error less the Kalman filter's [m²], with its
    standard error over the runs, and ``worse`` the fraction of runs where it is above 0.
    """
    kalman = pgm.filter(problem.network, evidence)[problem.state].mean
    best = _square_error(kalman, truth)
    found: dict[str, Any] = {"kalman": float(np.sqrt(best.mean())), "particles": {}}
    for count in counts:
        values = evidence[problem.reading].values
        means = particle_means(problem.controls, values, std, count, rng)
        error = _square_error(means, truth)
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
