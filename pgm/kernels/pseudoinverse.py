"""Regression on components of which some may be determined by others."""

from __future__ import annotations

import numpy as np

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
