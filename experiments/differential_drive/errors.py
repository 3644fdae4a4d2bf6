"""How wrong beliefs are, and whether they know it, over many drives."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.differential_drive.problems import LANDMARK
from models.networks import pose
from pgm import consistency

Array = npt.NDArray[np.float64]


def at_steps(belief: pgm.Gaussian, steps: npt.ArrayLike) -> pgm.Gaussian:
    """A belief at some of its steps."""
    at = np.asarray(steps)
    return pgm.Gaussian(belief.scope[0], belief.mean[..., at, :], belief.cov[..., at, :, :])


def later(belief: pgm.Gaussian) -> pgm.Gaussian:
    """A belief without step 0, which is exactly known, so that its errors have no scale."""
    return at_steps(belief, np.arange(1, belief.mean.shape[-2]))


def mean_nees(belief: pgm.Gaussian, truth: Array) -> Array:
    """The NEES of each step, averaged over the runs, (T,), of a belief from step 1 on."""
    averaged: Array = consistency.nees(belief, truth[:, 1:]).mean(axis=0)
    return averaged


def errors(belief: pgm.Gaussian, truth: Array) -> dict[str, Any]:
    """RMSE [m, rad], the mean NEES, and the fraction of steps where it is in its 99 % band.

    The runs of one step are independent, so that their mean NEES has the band of χ². Steps are
    not: the mean over all of them has none.
    """
    (state,) = belief.scope
    nees = mean_nees(belief, truth)
    low, high = consistency.mean_band(state.dimension, len(truth))
    found = {
        "rmse": consistency.rmse(belief, truth[:, 1:], ("east", "north")),
        "nees": float(nees.mean()),
        "nees_last": float(nees[-1]),
        "inside": float(((low < nees) & (nees < high)).mean()),
    }
    if state == pose:
        found["rmse_heading"] = consistency.rmse(belief, truth[:, 1:], ("heading",))
    return found


def about_landmark(belief: pgm.Gaussian) -> tuple[Array, Array]:
    """Standard deviations of a position towards the landmark and along the circle about it.

    Parameters
    ----------
    belief : Gaussian
        Of a pose, (..., 3).

    Returns
    -------
    ndarray, ndarray
        (...), each [m].
    """
    towards = LANDMARK - belief.mean[..., :2]
    towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    along = np.stack([-towards[..., 1], towards[..., 0]], axis=-1)
    plane = belief.cov[..., :2, :2]
    radial, tangential = (
        np.sqrt(np.einsum("...i,...ij,...j->...", d, plane, d)) for d in (towards, along)
    )
    return radial, tangential
