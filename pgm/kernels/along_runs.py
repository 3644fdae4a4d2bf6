"""Predictions and updates of many runs, on arrays whose last axis is the runs.

One operation goes along rows of runs, one component at a time; nothing is checked or dispatched in
between. `moments` has the same mathematics for any shape.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import LOG_2PI, Array
from pgm.kernels.roots import NEGLIGIBLE

# A B and A Bᵀ, the latter the faster one.
_PRODUCT, _TIMES_TRANSPOSED = "ijr,jkr->ikr", "ijr,kjr->ikr"


def predict(
    mean: Array, cov: Array, matrix: Array, offset: Array, noise: Array
) -> tuple[Array, Array]:
    """Moments of F x + b + n.

    Parameters
    ----------
    mean, cov : ndarray
        Of x, (n, runs) and (n, n, runs), the latter exactly symmetric.
    matrix, offset, noise : ndarray
        F (d, n, runs), b (d, runs) and the covariance of n, (d, d, runs or 1).
    """
    result_cov = np.empty((len(matrix), len(matrix), cov.shape[-1]))
    push(cov, matrix, noise, result_cov)
    result: Array = np.einsum("ijr,jr->ir", matrix, mean)
    result += offset
    return result, result_cov


def push(cov: Array, matrix: Array, noise: Array, out: Array) -> None:
    """Put the covariance F P Fᵀ + noise into `out`, (d, d, runs)."""
    half = np.einsum(_TIMES_TRANSPOSED, matrix, cov)
    np.einsum(_TIMES_TRANSPOSED, half, matrix, out=out)
    out += noise
    _mirror(out)


def update(
    mean: Array,
    cov: Array,
    matrix: Array,
    residual: Array,
    noise: Array,
    out: tuple[Array, Array] | None = None,
) -> tuple[Array, Array, Array, Array] | None:
    """A regular `moments.update`: mean, covariance, log-density and root; None if one is singular.

    Parameters
    ----------
    mean, cov : ndarray
        (n, runs), (n, n, runs), the covariance exactly symmetric.
    matrix, residual, noise : ndarray
        H (d, n, runs), z − H mean (d, runs), and (d, d, runs or 1).
    out : tuple of ndarray, optional
        Where the mean and the covariance go.
    """
    size, runs, height = len(cov), cov.shape[-1], len(residual)
    result, result_cov = (np.empty((size, runs)), np.empty_like(cov)) if out is None else out
    # [r, P Hᵀ], then [r, P Hᵀ] L⁻ᵀ, a row of the reading at a time.
    white = np.empty((1 + size, height, runs))
    white[0] = residual
    cross = np.einsum(_TIMES_TRANSPOSED, cov, matrix, out=white[1:])
    lower: Array = np.einsum(_PRODUCT, matrix, cross)
    lower += noise
    least = NEGLIGIBLE * np.einsum("iir->ir", lower)
    # [1 − G H, G] and [(1 − G H) P, G noise]; their product is the covariance.
    factor, spread = np.empty((2, size, size + height, runs))
    keep, gain = factor[:, :size], factor[:, size:]
    for j in range(height):
        for k in range(j):
            lower[k, j] = 0.0
            for i in range(k):
                lower[j, k] -= lower[j, i] * lower[k, i]
            lower[j, k] /= lower[k, k]
            lower[j, j] -= lower[j, k] * lower[j, k]
            white[:, j] -= white[:, k] * lower[j, k]
        if not (lower[j, j] > least[j]).all():
            return None
        np.sqrt(lower[j, j], out=lower[j, j])
        white[:, j] /= lower[j, j]
    for j in reversed(range(height)):
        column = white[1:, j]
        for k in range(j + 1, height):
            column = column - gain[:, k] * lower[k, j]
        np.divide(column, lower[j, j], out=gain[:, j])
    np.einsum(_PRODUCT, gain, matrix, out=keep)
    np.negative(keep, out=keep)
    for i in range(size):
        keep[i, i] += 1.0
    np.einsum(_TIMES_TRANSPOSED, keep, cov, out=spread[:, :size])
    if noise.shape[-1] == 1:
        np.matmul(noise[..., 0], gain, out=spread[:, size:])
    else:
        np.einsum(_PRODUCT, gain, noise, out=spread[:, size:])
    np.einsum(_TIMES_TRANSPOSED, spread, factor, out=result_cov)
    _mirror(result_cov)
    np.einsum("ijr,jr->ir", gain, residual, out=result)
    result += mean
    log_density: Array = np.einsum("ir,ir->r", white[0], white[0])
    log_density *= -0.5
    log_density -= 0.5 * height * LOG_2PI
    for j in range(height):
        log_density -= np.log(lower[j, j])
    return result, result_cov, log_density, lower


def root(matrix: Array) -> Array | None:
    """The Cholesky factor of (n, n, runs); None if one is singular, indefinite or not finite."""
    lower = np.zeros_like(matrix)
    for j in range(len(matrix)):
        column = matrix[j:, j]
        for k in range(j):
            column = column - lower[j:, k] * lower[j, k]
        if not (column[0] > NEGLIGIBLE * matrix[j, j]).all():
            return None
        lower[j, j] = np.sqrt(column[0])
        np.divide(column[1:], lower[j, j], out=lower[j + 1 :, j])
    return lower


def divide(matrix: Array, lower: Array) -> Array:
    """The F with F L = J for J (d, n, runs)."""
    result = np.empty_like(matrix)
    for j in reversed(range(len(lower))):
        column = matrix[:, j]
        for k in range(j + 1, len(lower)):
            column = column - result[:, k] * lower[k, j]
        np.divide(column, lower[j, j], out=result[:, j])
    return result


def _mirror(matrix: Array) -> None:
    """Make the lower triangle what the upper one is."""
    for i in range(1, len(matrix)):
        matrix[i, :i] = matrix[:i, i]
