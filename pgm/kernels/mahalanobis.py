"""Squared Mahalanobis distances νᵀ S⁻¹ ν of innovations ν ~ N(0, S), and chi-square limits."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import (
    Array,
    Integers,
)
from pgm.kernels.roots import NEGLIGIBLE


def square_within(probability: float, dimension: Integers) -> Array:
    """The chi-square quantiles q: νᵀ S⁻¹ ν is below q with the probability `probability`.

    `dimension` has the numbers of components of ν, one for each quantile, in any shape.
    """
    from scipy.special import chdtri  # here, since it is slow to import

    return np.asarray(chdtri(dimension, 1.0 - probability), dtype=np.float64)


def squares(residual: Array, cov: Array) -> Array:
    """The squared distances νᵀ S⁻¹ ν, (k, *batch), of k stacked innovations ν ~ N(0, S).

    ν is `residual` (k, d, *batch), S `cov` (k, d, d, *batch). Components are eliminated one after
    another, in the whole stack at once. A component that earlier components determine, its pivot in
    S being at most 10⁻¹³ of its variance, adds nothing.
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
    """The term `left`² / `pivot` of one component in the squared distances, (k, *batch).

    `left` is the component of the innovation less its mean given the earlier components, `pivot`
    its variance given them, and `diagonal` its whole variance, (k, *batch) each. The term is zero
    where earlier components determine this one.
    """
    proper = pivot > NEGLIGIBLE * diagonal
    if proper.all():
        return left * left / pivot
    return np.where(proper, left * left / np.where(proper, pivot, 1.0), 0.0)
