"""Quantiles of the distributions that statistics are compared with."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import betaincinv, gammaincinv, ndtri

from pgm.consistency.checks import check_confidence
from pgm.errors import ModelError
from pgm.kernels.arrays import Array


def tails(confidence: float) -> tuple[float, float]:
    """The probabilities below the lower and below the upper end of a two-sided band."""
    value = check_confidence(confidence)
    if value.ndim:
        raise ModelError(f"a band has one confidence, not {value.size} of them; ask for each")
    return 0.5 * float(1.0 - value), 0.5 * float(1.0 + value)


def chi_squared(probability: npt.ArrayLike, dof: npt.ArrayLike) -> Array:
    """The value that a χ² with so many degrees of freedom stays below with a probability."""
    half = 0.5 * np.asarray(dof, dtype=float)
    return np.asarray(2.0 * gammaincinv(half, np.asarray(probability, dtype=float)))


def normal(confidence: float) -> float:
    """The z with P(|n| ≤ z) = confidence for a standard normal n."""
    return float(ndtri(tails(confidence)[1]))


def clopper_pearson(share: Array, count: int, confidence: float) -> tuple[Array, Array]:
    """The exact two-sided interval of a probability, from the share of `count` trials it won."""
    low, high = tails(confidence)
    won = share * count
    lost = count - won
    # The incomplete beta function has no inverse at zero trials won or lost.
    below = np.where(won > 0.0, betaincinv(np.maximum(won, 1e-9), lost + 1.0, low), 0.0)
    above = np.where(lost > 0.0, betaincinv(won + 1.0, np.maximum(lost, 1e-9), high), 1.0)
    return below, above
