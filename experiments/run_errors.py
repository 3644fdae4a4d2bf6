"""Errors of a planar robot's pose, of each run by itself."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import pgm
from models.networks import pose
from pgm import consistency

Array = npt.NDArray[np.float64]


def run_errors(posterior: pgm.results.Posterior, truth: Array) -> dict[str, Array]:
    """Figures of many runs, (runs,) each, over the steps of a run.

    Parameters
    ----------
    posterior : Posterior
    truth : ndarray
        (runs, T+1, 3) [m, m, rad].

    Returns
    -------
    dict
        ``rmse`` [m] and ``rmse_heading`` [rad]; ``nees``, the mean, of which 3 is right; and
        ``log_evidence``.
    """
    belief = posterior[pose]
    squares = np.square(consistency.error(belief, truth))
    return {
        "rmse": np.sqrt(squares[..., :2].sum(axis=-1).mean(axis=-1)),
        "rmse_heading": np.sqrt(squares[..., 2].mean(axis=-1)),
        "nees": consistency.nees(belief, truth).mean(axis=-1),
        "log_evidence": np.asarray(posterior.log_evidence),
    }
