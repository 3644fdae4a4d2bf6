"""Regression on components of which some may be determined by others."""

from __future__ import annotations

import numpy as np

from pgm.kernels import roots
from pgm.kernels.arrays import Array
from pgm.kernels.roots import NEGLIGIBLE


def regression(cross: Array, cov: Array) -> Array:
    """The gain G = C P⁺ of a covariance P and a cross-covariance C, (..., m, n), on its components.

    The pseudo-inverse is taken in deviations, so that units do not matter.
    """
    variance = np.diagonal(cov, axis1=-2, axis2=-1)
    deviation = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    correlation = cov / (deviation[..., :, None] * deviation[..., None, :])
    inverse = np.linalg.pinv(correlation, rcond=NEGLIGIBLE, hermitian=True)
    gain: Array = (cross / deviation[..., None, :]) @ inverse / deviation[..., None, :]
    return gain


def gain(cross: Array, cov: Array, lower: Array) -> Array:
    """The gain C P⁺ by a root of P, or by `regression` where the root was lost to rounding.

    Eliminating a component that is nearly determined magnifies the rounding of those after it.
    """
    result = roots.gain(cross, lower)
    lost = np.isnan(lower).any(axis=(-2, -1))
    if lost.any():
        result[lost] = regression(cross[lost], cov[lost])
    return result
