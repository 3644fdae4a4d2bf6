"""Particles of one number on very many drives: a part of a study."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

import pgm
from experiments.differential_drive.particles import follow
from experiments.differential_drive.problems import problems
from experiments.particle_counts.study import mean_square


def sweep(
    runs: int,
    rng: np.random.Generator,
    *,
    problem: Literal["1", "2a", "2b"] = "2a",
    particles: int = 100,
    resampling: Literal["multinomial", "residual", "stratified", "systematic"] = "systematic",
    seconds: int = 8,
) -> dict[str, npt.NDArray[np.float64]]:
    """Errors of particle filters, beside a Kalman filter on the same drives.

    ``rmse`` [m] over the steps, what its square is above that of the Kalman filter (problem 2's is
    unscented) as ``excess`` [m²], and ``log_evidence``.

    Parameters
    ----------
    seconds : int
        Of a drive; a position or a landmark is read at each.
    """
    if seconds < 1:
        raise pgm.ModelError(f"a drive is of 1 second or more; found {seconds}")
    chosen = problems("variance", seconds)[problem]
    truth, evidence = chosen.sample(runs, rng)
    cloud = pgm.Particles(particles, seed=int(rng.integers(2**32)), resampling=resampling)
    followed = follow(chosen, np.asarray(evidence[chosen.reading].values), cloud)
    kalman = pgm.filter(chosen.network, evidence, lineariser=pgm.Unscented())[chosen.state]
    error = mean_square(followed.mean, truth)
    return {
        "rmse": np.sqrt(error),
        "excess": error - mean_square(kalman.mean, truth),
        "log_evidence": np.asarray(followed.log_evidence),
    }
