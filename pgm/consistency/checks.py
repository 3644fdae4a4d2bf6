"""Checks of what the statistics take."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from pgm.boundary import as_floats, is_whole
from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.inference import GridBelief, Innovations, ParticleBelief
from pgm.kernels.arrays import Array


def check_gaussian(belief: Any) -> Gaussian:
    """The Gaussian; refuses anything else."""
    if isinstance(belief, GridBelief | ParticleBelief):
        raise ModelError(
            f"a belief is a Gaussian, not {titled(belief)}; belief.gaussian() has its mean and "
            "covariance"
        )
    if not isinstance(belief, Gaussian):
        raise ModelError(
            f"a belief is a Gaussian, like posterior[x], not {type(belief).__name__}; take the "
            "marginal of one variable first"
        )
    return belief


def check_innovations(innovations: Any) -> Innovations:
    """The innovations; refuses anything else."""
    if not isinstance(innovations, Innovations):
        raise ModelError(
            "innovations are those of one sensor, posterior.innovations[z], not "
            f"{type(innovations).__name__}"
        )
    return innovations


def check_confidence(confidence: npt.ArrayLike) -> Array:
    """Confidences, (...); refuses what is no probability strictly between 0 and 1."""
    values = as_floats(confidence, "a confidence")
    if not ((values > 0.0) & (values < 1.0)).all():
        raise ModelError(f"a confidence lies between 0 and 1; {confidence!r} does not")
    return values


def check_count(what: str, value: Any) -> None:
    """Refuse what is no whole number, 1 or more."""
    if not is_whole(value) or value < 1:
        raise ModelError(f"{what} = {value!r}; a whole number, 1 or more, was due")
