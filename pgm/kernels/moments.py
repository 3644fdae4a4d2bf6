"""Gaussians in moment form on arrays: mean (..., n), covariance (..., n, n), singular ones too."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import roots, solving
from pgm.kernels.arrays import (
    LAST_PLACES,
    LOG_2PI,
    Array,
    apply,
    contiguous,
    inner,
    make_symmetric,
    multiply,
    one_minus,
    sandwich,
    times_symmetric,
    times_transposed,
    transpose,
)

# The part of what was summed up that rounding leaves of a zero.
ROUNDING = 1e-14


class Update(NamedTuple):
    """The moments of a belief after a measurement; see `gaussian.Update`.

    Here `lower` is the root of S, NaN where that is indefinite.
    """

    mean: Array
    cov: Array
    log_density: Array
    lower: Array
    left: Array | None


def update(
    mean: Array, cov: Array, matrix: Array, residual: Array, noise: Array, *, exact: bool = True
) -> Update:
    """Condition N(mean, cov) on a measurement z = H x + n, n ~ N(0, noise), residual z − H mean.

    The formulas are those of `gaussian.update`; here the batch axes come first.
    """
    size = residual.shape[-1]
    cross = times_symmetric(matrix, cov)
    predictive = times_transposed(cross, matrix) + noise
    lower = roots.root(predictive, spread(matrix, cov, noise) if exact else None)
    fixed = roots.determined(lower)
    white = solving.solve_lower(lower, np.concatenate([residual[..., None], cross], axis=-1))
    gain = contiguous(transpose(solving.solve_upper(lower, white[..., 1:])))
    white_residual = white[..., 0]
    left = None
    dimension: int | Array = size
    if fixed.any():
        left = np.where(fixed, np.abs(white_residual), 0.0)
        white_residual = np.where(fixed, 0.0, white_residual)
        dimension = size - fixed.sum(axis=-1)
    log_density = -0.5 * (
        inner(white_residual, white_residual) + solving.log_determinant(lower) + dimension * LOG_2PI
    )
    keep, posterior = joseph(cov, gain, matrix, noise)
    if exact:
        # 1 − GH is rounded itself, which leaves about 1e-32 of what is certain now.
        left_over = ROUNDING * spread(keep, cov, np.zeros_like(cov))
        prior = np.diagonal(cov, axis1=-2, axis2=-1)
        posterior = certain(posterior, np.maximum(left_over, ROUNDING**2 * prior))
    return Update(mean + apply(gain, residual), posterior, log_density, lower, left)


def joseph(cov: Array, gain: Array, matrix: Array, noise: Array) -> tuple[Array, Array]:
    """The factor I − G H and the covariance (I − G H) P (I − G H)ᵀ + G noise Gᵀ, for any gain."""
    keep = one_minus(multiply(gain, matrix))
    return keep, make_symmetric(sandwich(keep, cov) + sandwich(gain, noise))


def spread(matrix: Array, cov: Array, noise: Array) -> Array:
    """The size of the summands of the variances of F P Fᵀ + noise, (..., d)."""
    size = np.abs(matrix)
    summed: Array = (multiply(size, np.abs(cov)) * size).sum(axis=-1)
    return summed + np.diagonal(noise, axis1=-2, axis2=-1)


def certain(cov: Array, rounding: Array) -> Array:
    """A covariance without the components whose variance is no more than rounding, (..., n)."""
    open_ = np.diagonal(cov, axis1=-2, axis2=-1) > rounding
    if open_.all():
        return cov
    return np.where(open_[..., None] & open_[..., None, :], cov, 0.0)


class Conditional(NamedTuple):
    """x given y as an affine Gaussian: x = F y + b + n, n ~ N(0, cov)."""

    matrix: Array
    offset: Array
    cov: Array


def reverse(
    mean: Array, cov: Array, matrix: Array, noise: Array, forward_mean: Array, forward_cov: Array
) -> Conditional:
    """Bayes' rule for y = A x + c + n: x given y, from x ~ N(mean, cov) and y's own moments.

    Gain G = P Aᵀ (P_y)⁺; the rest is (I − GA) P (I − GA)ᵀ + G noise Gᵀ, which does not subtract.
    """
    cross = transpose(times_symmetric(matrix, cov))
    # The rest is right for any gain: only what is no more than rounding has to go.
    lower = roots.root(forward_cov, spread(matrix, cov, noise), negligible=0.1 * ROUNDING)
    gain = solving.gain(cross, lower, forward_cov)
    _, rest = joseph(cov, gain, matrix, noise)
    return Conditional(gain, mean - apply(gain, forward_mean), rest)


def push(mean: Array, cov: Array, conditional: Conditional) -> tuple[Array, Array]:
    """Moments of F x + b + n for x ~ N(mean, cov)."""
    matrix, offset, noise = conditional
    return apply(matrix, mean) + offset, make_symmetric(sandwich(matrix, cov) + noise)


def log_density(residual: Array, cov: Array) -> Array:
    """The log-density ln N(residual; 0, cov), (...); NaN where it does not exist."""
    lower = roots.root(cov)
    singular = roots.determined(lower).any(axis=-1)
    white = solving.solve_lower(lower, residual[..., None])[..., 0]
    value = -0.5 * (
        inner(white, white) + solving.log_determinant(lower) + residual.shape[-1] * LOG_2PI
    )
    return np.where(singular, np.nan, value)


def principal_axes(cov: Array) -> tuple[Array, Array]:
    """Variances along the axes of (..., 2, 2), the larger first, whose angle is in (−π/2, π/2]."""
    values, vectors = np.linalg.eigh(cov)
    angle = np.arctan2(vectors[..., 1, 1], vectors[..., 0, 1])
    turned = np.where(angle > 0.5 * np.pi, angle - np.pi, angle)
    return np.maximum(values[..., ::-1], 0.0), np.where(
        angle <= -0.5 * np.pi, angle + np.pi, turned
    )


def kl(difference: Array, cov: Array, other_cov: Array) -> Array:
    """KL(N(μ, cov) ‖ N(μ', other_cov)) for μ' − μ = difference (8.4); NaN where it is undefined."""
    lower, other = roots.root(cov), roots.root(other_cov)
    singular = (roots.determined(lower) | roots.determined(other)).any(axis=-1)
    white = solving.solve_lower(other, difference[..., None])[..., 0]
    ratio = solving.solve_lower(other, lower)
    value = 0.5 * (
        solving.log_determinant(other)
        - solving.log_determinant(lower)
        - difference.shape[-1]
        + np.einsum("...ij,...ij->...", ratio, ratio)
        + inner(white, white)
    )
    return np.where(singular, np.nan, value)


def marginal_error(mean: Array, other: Array, std: Array) -> Array:
    """The largest |mean − other| over the last axis and the first, in deviations or sizes."""
    unit = np.where(std > 0.0, std, np.maximum(np.abs(mean), 1.0))
    largest: Array = (np.abs(mean - other) / unit).max(axis=(0, -1), initial=0.0)
    return largest


def moved(mean: Array, other: Array, std: Array) -> Array:
    """How far means move in an iteration, by `marginal_error`; rounding counts as zero.

    The largest (|m − m′| − 32 ε max(|m|, |m′|))₊ / s over the last axis and the first. Without the
    rounding, which is no move, means of 10⁸ deviations would never settle.
    """
    unit = np.where(std > 0.0, std, np.maximum(np.abs(mean), 1.0))
    rounding = LAST_PLACES * np.maximum(np.abs(mean), np.abs(other))
    left = np.maximum(np.abs(mean - other) - rounding, 0.0)  # NaN stays
    largest: Array = (left / unit).max(axis=(0, -1), initial=0.0)
    return largest
