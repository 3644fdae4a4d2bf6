"""One Gaussian at a time: mean (n,) and covariance (n, n), by LAPACK itself.

What is special is left to the general kernels: where a pivot is nearly lost, the answer is None.
"""

from __future__ import annotations

from functools import lru_cache
from math import log

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dtrtrs

from pgm.kernels import roots
from pgm.kernels.angles import wrap
from pgm.kernels.arrays import LOG_2PI, Array, Index, symmetric
from pgm.kernels.roots import NEGLIGIBLE
from pgm.kernels.straight import checking, predicting, updating

# Below this part of its diagonal entry a pivot of a predictive covariance is left to `moments`.
NEARLY_SINGULAR = 1e-6


def root(cov: Array) -> Array | None:
    """The lower triangular L with P = L Lᵀ; None where a pivot is negligible, or there is none."""
    lower, fault = dpotrf(cov, 1)
    if fault:
        return None
    for pivot, entry in zip(lower.diagonal().tolist(), cov.diagonal().tolist(), strict=True):
        if not pivot * pivot > NEGLIGIBLE * entry:
            return None
    found: Array = lower
    return found


def is_regular(cov: Array, before: Array, least: float) -> bool:
    """Whether no component is determined to `least` by those before it, nor against another time.

    Neither the share of its variance that those before it leave open, nor its variance beside that
    of an earlier covariance is smaller. Components without a variance now and then do not count.
    """
    written = checking(len(cov), least)
    if written is not None and written(cov, before):
        return True
    fell = np.diagonal(cov) < least * np.diagonal(before)
    return not fell.any() and roots.is_regular(cov, least)


def predict(cov: Array, matrix: Array, noise: Array) -> Array:
    """The covariance of F x + b + n."""
    written = predicting(len(noise), len(cov))
    if written is not None:
        return written(cov, matrix, noise)
    spread: Array = matrix.dot(cov).dot(matrix.T)
    spread += noise
    return symmetric(spread)


def extend(
    mean: Array,
    cov: Array,
    child: slice,
    parents: Index,
    matrix: Array,
    value: Array,
    noise: Array,
) -> None:
    """Write the child y = F x + b + n, of mean value, into a joint that it is a part of."""
    cross = matrix.dot(cov[parents])
    mean[child] = value
    cov[child] = cross
    cov[:, child] = cross.T
    cov[child, child] = symmetric(cross[:, parents].dot(matrix.T) + noise)


def update(
    mean: Array, cov: Array, matrix: Array, residual: Array, noise: Array
) -> tuple[Array, Array, float] | None:
    """Condition on a reading z = H x + n of residual z − H mean: moments and log-density.

    With S = H P Hᵀ + noise and G = P Hᵀ S⁻¹ the covariance is (I − GH) P (I − GH)ᵀ + G noise Gᵀ;
    None where S is nearly singular.
    """
    written = updating(len(mean), len(residual), NEARLY_SINGULAR)
    if written is not None:
        return written(mean, cov, matrix, residual, noise)
    cross = matrix.dot(cov)
    predictive = cross.dot(matrix.T)
    predictive += noise
    lower, gain, fault = dposv(predictive, cross, 1)
    if fault:
        return None
    volume = 0.0
    for pivot, entry in zip(lower.diagonal().tolist(), predictive.diagonal().tolist(), strict=True):
        if not pivot * pivot > NEARLY_SINGULAR * entry:
            return None
        volume += log(pivot)
    white = dtrtrs(lower, residual, 1)[0]
    gain = gain.T
    keep = identity(len(mean)) - gain.dot(matrix)
    posterior = keep.dot(cov).dot(keep.T)
    posterior += gain.dot(noise).dot(gain.T)
    log_density = -0.5 * (float(white.dot(white)) + len(residual) * LOG_2PI) - volume
    return mean + gain.dot(residual), symmetric(posterior), log_density


@lru_cache(maxsize=64)
def identity(size: int) -> Array:
    """The identity, made once."""
    eye = np.eye(size)
    eye.flags.writeable = False
    return eye


def divide(slope: Array, lower: Array) -> Array:
    """The F with F L = J, from Jᵀ (n, d)."""
    found: Array = dtrtrs(lower, slope, 1, 1)[0].T
    return found


def difference_points(mean: Array, cov: Array) -> tuple[Array, Array]:
    """Where central differences want the function, (4n, n), and their steps, (n, 1).

    As `differences.jacobian`: steps are max(10⁻² std, 10⁻⁴, 10⁻⁹ |x|).
    """
    variances, values = cov.diagonal().tolist(), mean.tolist()
    step = [
        (x + h) - x  # the step that is taken in floating point
        for x, h in (
            (x, max(1e-2 * max(p, 0.0) ** 0.5, 1e-4, 1e-9 * abs(x)))
            for x, p in zip(values, variances, strict=True)
        )
    ]
    steps = np.array(step)
    return mean + _stencil(mean.size) * steps, steps[:, None]


@lru_cache(maxsize=64)
def _stencil(size: int) -> Array:
    offsets = np.eye(size)[:, None, :] * np.array([1.0, -1.0, 2.0, -2.0])[:, None]
    stencil: Array = offsets.reshape(4 * size, size)
    return stencil


def differences(values: Array, steps: Array, angles: list[int]) -> Array:
    """The Jacobian (d, n) from values (4n, d) at the points of `difference_points`."""
    each = values.reshape(steps.size, 4, -1)
    near, far = each[:, 0] - each[:, 1], each[:, 2] - each[:, 3]
    for k in angles:
        near[:, k], far[:, k] = wrap(near[:, k]), wrap(far[:, k])
    slopes: Array = ((8.0 * near - far) / (12.0 * steps)).T
    return slopes
