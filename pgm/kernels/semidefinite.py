"""Covariances that rounding has left with slightly negative eigenvalues, made semidefinite."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import (
    Array,
    Mask,
    deviation,
    symmetric,
)

# The size beyond which a negative eigenvalue of correlations is more than those of float64 vary by.
_VISIBLE = 1e-12


def semidefinite(cov: Array, largest: float) -> Array:
    """Covariances (..., n, n) without the asymmetry and negative eigenvalues left by rounding.

    The eigenvalues are those of the correlations. Where the least one is between −`largest` and
    −10⁻¹², all negative ones become zero. Otherwise a covariance is only made symmetric: a least
    eigenvalue of −`largest` or less is no rounding. If an entry of any covariance is infinite or
    NaN, all are only made symmetric.
    """
    cov = symmetric(cov)
    unit = deviation(cov)
    unit = np.where(unit > 0.0, unit, 1.0)
    scaled = cov / unit[..., None] / unit[..., None, :]
    if not np.isfinite(scaled).all():
        return cov
    doubtful = ~_are_positive(scaled + 0.5 * _VISIBLE * np.eye(scaled.shape[-1]))
    if not doubtful.any():
        return cov
    values, axes = np.linalg.eigh(scaled[doubtful])
    least = values.min(axis=-1, initial=0.0)
    blurred = (least < -_VISIBLE) & (least > -largest)
    if not blurred.any():
        return cov
    kept = (axes * np.maximum(values, 0.0)[..., None, :]) @ axes.mT
    wide = unit[doubtful]
    kept = kept * wide[..., None] * wide[..., None, :]
    cov[doubtful] = np.where(blurred[..., None, None], kept, cov[doubtful])
    return cov


def _are_positive(matrix: Array) -> Mask:
    """The symmetric matrices (..., n, n) with positive pivots, which are found before eigenvalues.

    Their eigenvalues are positive but for the rounding of a few sums.
    """
    left = matrix.copy()
    found = np.ones(matrix.shape[:-2], dtype=bool)
    for j in range(matrix.shape[-1]):
        column = left[..., j:, j]
        found &= column[..., 0] > 0.0
        factor = column[..., 1:] / np.where(found, column[..., 0], 1.0)[..., None]
        left[..., j + 1 :, j + 1 :] -= factor[..., :, None] * column[..., None, 1:]
    return found
