"""Covariances that rounding has left with slightly negative eigenvalues, made semidefinite."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import (
    Array,
    deviation,
    symmetric,
)

# The size beyond which a negative eigenvalue of correlations is more than those of float64 vary by.
_VISIBLE = 1e-12


def semidefinite(cov: Array, largest: float) -> Array:
    """Covariances (..., n, n) without the asymmetry and negative eigenvalues left by rounding.

    The eigenvalues are those of the correlations. Negative ones become zero where the least is
    between −`largest` and −10⁻¹². A covariance with an eigenvalue of −`largest` or less, which is
    no rounding, is only made symmetric, and so are all if an entry of any is infinite or NaN.
    """
    cov = symmetric(cov)
    unit = deviation(cov)
    unit = np.where(unit > 0.0, unit, 1.0)
    scaled = cov / unit[..., None] / unit[..., None, :]
    if not np.isfinite(scaled).all():
        return cov
    values, axes = np.linalg.eigh(scaled)
    least = values.min(axis=-1, initial=0.0)
    blurred = (least < -_VISIBLE) & (least > -largest)
    if not blurred.any():
        return cov
    kept = (axes * np.maximum(values, 0.0)[..., None, :]) @ axes.mT
    return np.where(blurred[..., None, None], kept * unit[..., None] * unit[..., None, :], cov)
