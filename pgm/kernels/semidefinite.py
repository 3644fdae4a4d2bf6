"""Covariances that rounding has left with slightly negative eigenvalues, made semidefinite."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import (
    Array,
    deviation,
    symmetric,
)

# A share of the variances beyond which a negative eigenvalue is visible in float64.
_VISIBLE = 1e-12


def semidefinite(cov: Array, largest: float) -> Array:
    """Covariances without the asymmetry and the negative eigenvalues that rounding has left.

    Eigenvalues are in units of the variances; one that is `largest` below zero is no rounding.
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
