"""How much of the variances of many runs is left open; the last axis of all arrays is the runs.

Each operation on a component goes along a contiguous row of runs; of more than a few components
LAPACK is faster, matrix by matrix. Symmetric matrices are factorised as U D Uᵀ, with U unit lower
triangular and D the diagonal of pivots: a pivot is the variance of a component given those before
it.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array

# Components from which on matrices that are all positive definite are LAPACK's.
_MANY = 16


def open_share(cov: Array) -> float:
    """The least share of a component's variance that the components before it leave open.

    The share of component i is its variance given the components before it, divided by its whole
    variance: L_ii² / P_ii for P = L Lᵀ. The least is over all components and runs, and at most 1.
    `cov` is P, (n, n, runs), and is overwritten; components without a variance do not count.
    """
    variances = np.einsum("iir->ir", cov)
    variances[variances == 0.0] = 1.0
    whole = np.abs(variances)
    lower = _roots(cov)
    if lower is not None:
        return float((np.einsum("rii->ir", lower) ** 2 / whole).min(initial=1.0))
    return float((_eliminate(cov) / whole).min(initial=1.0))


def inflation(cov: Array) -> Array:
    """The sum of the variance inflation factors of each covariance (n, n, runs), as (runs,).

    The factor of a component is its variance divided by its variance given all other components.
    The sum is tr C⁻¹ for the correlations C, and with C = U D Uᵀ it is Σ_k Σ_i (U⁻¹)²_ki / D_k.
    `cov` is overwritten; the factor of a component without a variance is one, and the sum is
    infinite where C is not positive definite.
    """
    size = len(cov)
    own = np.einsum("iir->ir", cov)
    unit = np.sqrt(np.abs(own))
    unit[unit == 0.0] = 1.0
    cov /= unit
    cov /= unit[:, None]
    np.einsum("iir->ir", cov)[...] = 1.0
    lower = _roots(cov)
    if lower is not None:
        inverse = np.linalg.inv(lower)
        found: Array = np.einsum("rij,rij->r", inverse, inverse)
        return found
    total = np.zeros(cov.shape[-1])
    rows: list[list[Array]] = []  # of U⁻¹, up to the one on its diagonal
    with np.errstate(all="ignore"):  # of what is singular; see below
        pivots = _eliminate(cov)
        for k in range(size):
            row = [-cov[k, i] for i in range(k)]
            for i in range(k):
                for j in range(i + 1, k):
                    row[i] = row[i] - cov[k, j] * rows[j][i]
            rows.append(row)
            total += (1.0 + sum(part * part for part in row)) / pivots[k]
    total[~(pivots > 0.0).all(axis=0)] = np.inf
    return total


def least_left(before: Array, after: Array) -> float:
    """The smallest ratio of a variance in `after` to the same component's in `before`, at most 1.

    Both are covariances (n, n, runs); the smallest is over all components and runs. A component
    with a variance of zero after, or none above zero before, does not count.
    """
    was, left = (np.einsum("iir->ir", cov) for cov in (before, after))
    counts = (left != 0.0) & (was > 0.0)
    return float((left[counts] / was[counts]).min(initial=1.0))


def _roots(cov: Array) -> Array | None:
    """The lower triangular roots of many components' matrices, (runs, n, n), of `cov` (n, n, runs).

    None of few components, and where a matrix is not positive definite.
    """
    if len(cov) < _MANY:
        return None
    try:
        return np.asarray(np.linalg.cholesky(np.moveaxis(cov, -1, 0)), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None


def _eliminate(matrix: Array) -> Array:
    """Factorise symmetric A = U D Uᵀ in place; returns the pivots D, (d, runs).

    `matrix` A (d, d, runs) becomes U below the diagonal, D on it and D Uᵀ above.
    """
    for j in range(1, len(matrix)):
        for k in range(j):
            part = matrix[j, k]
            for i in range(k):
                part -= matrix[j, i] * matrix[i, k]
            matrix[k, j] = part  # U D, which the symmetric half has room for
            part /= matrix[k, k]
            matrix[j, j] -= part * matrix[k, j]
    size, _, runs = matrix.shape
    return matrix.reshape(size * size, runs)[:: size + 1]
