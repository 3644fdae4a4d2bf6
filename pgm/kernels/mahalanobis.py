"""Squared Mahalanobis distances νᵀ S⁻¹ ν of innovations, and their chi-square limits."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import (
    Array,
    Integers,
)
from pgm.kernels.roots import NEGLIGIBLE


def square_within(probability: float, dimension: Integers) -> Array:
    """The squared length, in deviations, within which a normal vector is with a probability."""
    from scipy.special import chdtri  # here, since it is slow to import

    return np.asarray(chdtri(dimension, 1.0 - probability), dtype=np.float64)


def squares(residual: Array, cov: Array) -> Array:
    """The value νᵀ S⁻¹ ν of stacked innovations ν (k, d, *batch), S (k, d, d, *batch).

    Components are eliminated one after another, all of the stack at once.
    """
    size = residual.shape[1]
    if size == 1:
        return _share(residual[:, 0], cov[:, 0, 0], cov[:, 0, 0])
    residual, cov = residual.copy(), cov.copy()
    diagonal = np.einsum("kii...->ki...", cov).copy()
    total = np.zeros(residual[:, 0].shape)
    for j in range(size):
        pivot, left = cov[:, j, j].copy(), residual[:, j].copy()
        total = total + _share(left, pivot, diagonal[:, j])
        if j + 1 == size:
            break
        proper = pivot > NEGLIGIBLE * diagonal[:, j]
        factor = cov[:, j + 1 :, j] / np.where(proper, pivot, np.inf)[:, None]
        residual[:, j + 1 :] -= factor * left[:, None]
        cov[:, j + 1 :, j + 1 :] -= factor[:, :, None] * cov[:, None, j, j + 1 :]
    return total


def _share(left: Array, pivot: Array, diagonal: Array) -> Array:
    """The component's term ν_j² / L_jj²; zero if earlier components determine it."""
    proper = pivot > NEGLIGIBLE * diagonal
    if proper.all():
        return left * left / pivot
    return np.where(proper, left * left / np.where(proper, pivot, 1.0), 0.0)
