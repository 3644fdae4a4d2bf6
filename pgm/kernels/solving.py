"""Linear equations, gains and determinants of covariances, by their roots.

A root L (..., n, n), L Lᵀ = P, is lower triangular, with a zero column for each *determined*
component, whose variance given those before it is zero (`roots`). Equations are solved over the
other components; of a singular P the solution is one of many, and a gain C P⁺ is the same for all
of them where the rows of C lie in its range.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import (
    Array,
    Mask,
    multiply,
    transpose,
    variances,
)
from pgm.kernels.roots import NEGLIGIBLE, determined, root

# From this many matrices on, one vectorised operation a column beats one LAPACK call a matrix.
_MANY = 16


def _regular(lower: Array, fixed: Mask) -> Array:
    """The root with ones for its zero pivots, which `fixed` (..., n) marks: a regular matrix."""
    if not fixed.any():
        return lower
    return lower + fixed[..., None] * np.eye(lower.shape[-1])


def solve_lower(lower: Array, right: Array) -> Array:
    """The Y with L Y = B, (..., n, m), in the rows of all components that are not determined.

    L is `lower` (..., n, n), B `right` (..., n, m). The row j of a determined component is what
    earlier components leave of B there: B_j − Σ_k L_jk Y_k, k < j.
    """
    return _solve(_regular(lower, determined(lower)), right, range(lower.shape[-1]))


def solve_upper(lower: Array, right: Array) -> Array:
    """The X with Lᵀ X = B, (..., n, m); rows of determined components are zero, B unused there.

    L is the lower triangular `lower` (..., n, n), B `right` (..., n, m).
    """
    fixed = determined(lower)
    if fixed.any():
        right = np.where(fixed[..., None], 0.0, right)
    return _solve(transpose(_regular(lower, fixed)), right, range(lower.shape[-1])[::-1])


def _solve(triangle: Array, right: Array, order: range) -> Array:
    """The X with T X = B, (..., n, m), for regular triangular matrices T (..., n, n).

    Where they are many, rows of X are solved for in the order given: 0 to n − 1 for lower T, n − 1
    to 0 for upper T.
    """
    if triangle.size < _MANY * len(order) ** 2:
        return np.asarray(np.linalg.solve(triangle, right), dtype=np.float64)
    batch = triangle.shape[:-2]
    if right.shape[:-2] != batch:
        batch = np.broadcast_shapes(batch, right.shape[:-2])
        right = np.broadcast_to(right, (*batch, *right.shape[-2:]))
    solution = right.copy(order="K")  # in memory as the right side is
    for done, j in enumerate(order):
        row = solution[..., j, :]
        for k in order[:done]:
            row -= triangle[..., j, k, None] * solution[..., k, :]
        row /= triangle[..., j, j, None]
    return solution


def solve(lower: Array, right: Array) -> Array:
    """A solution X of L Lᵀ X = B, (..., n, m), for a B in the range of L Lᵀ."""
    return solve_upper(lower, solve_lower(lower, right))


def regression(cross: Array, cov: Array) -> Array:
    """The gain C P⁺ of a cross-covariance C, (..., m, n), by eigenvalues of P = `cov` (..., n, n).

    P⁺ is D⁻¹ R⁺ D⁻¹, with D the diagonal matrix of standard deviations and R⁺ the pseudo-inverse of
    the correlations, so that what counts as zero does not depend on units.
    """
    variance = variances(cov)
    unit = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    correlation = cov / (unit[..., :, None] * unit[..., None, :])
    inverse = np.linalg.pinv(correlation, rcond=NEGLIGIBLE, hermitian=True)
    found: Array = (cross / unit[..., None, :]) @ inverse / unit[..., None, :]
    return found


def whiten(lower: Array, residual: Array) -> Array:
    """The whitened residual: the s (..., n) with L s = r, for r = `residual` (..., n).

    It is zero in determined components.
    """
    white = solve_lower(lower, residual[..., None])[..., 0]
    return np.where(determined(lower), 0.0, white)


def log_determinant(lower: Array) -> Array:
    """The value ln |L Lᵀ| over the components that are not determined, (...): 2 Σ ln L_jj."""
    pivots = np.diagonal(lower, axis1=-2, axis2=-1)
    fixed = pivots == 0.0
    if fixed.any():
        pivots = np.where(fixed, 1.0, pivots)
    total: Array = np.log(pivots).sum(axis=-1)
    return 2.0 * total


def left_open(cov: Array) -> Array | None:
    """The matrix I − L L⁺ of a covariance L Lᵀ, (..., n, n), with zero rows where L has a pivot.

    Noise e of this covariance obeys (I − L L⁺) e = 0: a row for each determined component. None if
    no covariance has any.
    """
    lower = root(cov)
    fixed = determined(lower)
    if not fixed.any():
        return None
    eye = np.eye(lower.shape[-1])
    explained = np.where(fixed[..., None], 0.0, solve_lower(lower, eye + 0.0 * lower))
    return np.where(fixed[..., None], eye - multiply(lower, explained), 0.0)
