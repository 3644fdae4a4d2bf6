"""Checks of arrays that users give, at the public boundary."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array, transpose

# How far matrices may be from symmetric, relative to the entries' scale: solvers of Lyapunov's
# equation and the like leave some 1e-9.
ASYMMETRY = 1e-8
# The fault of a covariance that passes, but has no root (`roots.root`).
IMPROPER = (
    "its covariance is singular but for errors of up to 1e-10 of the variances, too large to be "
    "told from an indefinite one; give it in all digits, or set its negative eigenvalues to 0"
)


def symmetrised(matrix: Array) -> Array:
    """The symmetric part of matrices that are all but symmetric, entries against √|a_ii a_jj|."""
    if is_symmetric(matrix) or not np.isfinite(matrix).all():
        return matrix
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = _scaled(matrix)
        other = transpose(scaled)
        scale = np.maximum(np.maximum(np.abs(scaled), np.abs(other)), 1.0)
        fits = np.abs(scaled - other) <= ASYMMETRY * scale
    return 0.5 * matrix + 0.5 * transpose(matrix) if fits.all() else matrix


def is_symmetric(matrix: Array) -> bool:
    """Whether stacked matrices are symmetric to the last digit."""
    if matrix.ndim == 2 and matrix.tobytes() == matrix.T.tobytes():
        return True  # of a small one this is known in a fraction of the time
    return bool((matrix == transpose(matrix)).all())


def covariance_fault(cov: Array) -> str | None:
    """The fault that keeps stacked matrices, `symmetrised`, from being covariances; or None."""
    if not np.isfinite(cov).all():
        return "has entries that are NaN or infinite"
    variances = np.diagonal(cov, axis1=-2, axis2=-1)
    if (variances < 0.0).any():
        return f"has the negative variance {variances.min():.3g}"
    if not is_symmetric(cov):
        return "is not symmetric"
    with np.errstate(over="ignore"):
        scaled = _scaled(cov)
    if not np.isfinite(scaled).all():
        return "is indefinite: a covariance is far larger than the variances allow"
    smallest = np.linalg.eigvalsh(scaled).min(initial=0.0)
    if smallest < -1e-10:
        return (
            f"is indefinite: scaled to unit variances it has the negative eigenvalue {smallest:.3g}"
        )
    return None


def _scaled(matrix: Array) -> Array:
    size = np.abs(np.diagonal(matrix, axis1=-2, axis2=-1))
    unit = np.sqrt(np.where(size > 0.0, size, 1.0))
    return matrix / unit[..., None] / unit[..., None, :]
