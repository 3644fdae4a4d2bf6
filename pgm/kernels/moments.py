"""Gaussians in moment form on arrays: mean (..., n), covariance (..., n, n), singular ones too."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import along_runs, pseudoinverse, roots
from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Index,
    apply,
    block,
    by_runs,
    contiguous,
    distinct,
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
    """What a reading makes of a belief.

    Attributes
    ----------
    mean, cov : ndarray
        The belief given the reading.
    log_density : ndarray
        Of the reading; a component that an exact model determines adds nothing.
    lower : ndarray
        The root of the reading's predictive covariance; NaN where that is indefinite.
    left : ndarray or None
        (..., D): how far each determined component is from what the model says it is; None
        where nothing is determined.
    """

    mean: Array
    cov: Array
    log_density: Array
    lower: Array
    left: Array | None


def update(
    mean: Array, cov: Array, matrix: Array, residual: Array, noise: Array, *, exact: bool = True
) -> Update:
    """Condition N(mean, cov) on a reading z = H x + n, n ~ N(0, noise), residual z − H mean.

    The covariance is (I − GH) P (I − GH)ᵀ + G noise Gᵀ, a sum of semidefinite terms, with the
    gain G = P Hᵀ S⁺ and S = H P Hᵀ + noise. `exact` says whether the noise is singular, so that
    zeros have to be told from their rounding.
    """
    if not exact and _many(mean, cov, matrix, residual, noise):
        with np.errstate(invalid="ignore", divide="ignore"):  # then nothing is found
            found = along_runs.update(
                _by_component(mean),
                _by_component(cov),
                _by_component(matrix),
                _by_component(residual),
                _by_component(noise),
            )
        if found is not None:
            return Update(
                _by_run(found.mean),
                _by_run(found.cov),
                _by_run(found.log_density),
                _by_run(found.lower),
                None,
            )
    size = residual.shape[-1]
    cross = times_symmetric(matrix, cov)
    predictive = times_transposed(cross, matrix) + noise
    lower = roots.root(predictive, spread(matrix, cov, noise) if exact else None)
    fixed = roots.determined(lower)
    white = roots.solve_lower(lower, np.concatenate([residual[..., None], cross], axis=-1))
    gain = contiguous(transpose(roots.solve_upper(lower, white[..., 1:])))
    white_residual = white[..., 0]
    left = None
    dimension: int | Array = size
    if fixed.any():
        left = np.where(fixed, np.abs(white_residual), 0.0)
        white_residual = np.where(fixed, 0.0, white_residual)
        dimension = size - fixed.sum(axis=-1)
    log_density = -0.5 * (
        inner(white_residual, white_residual) + roots.log_determinant(lower) + dimension * LOG_2PI
    )
    keep = one_minus(multiply(gain, matrix))
    posterior = make_symmetric(sandwich(keep, cov) + sandwich(gain, noise))
    if exact:
        # 1 − GH is rounded itself, which leaves about 1e-32 of what is certain now.
        left_over = ROUNDING * spread(keep, cov, np.zeros_like(cov))
        prior = np.diagonal(cov, axis1=-2, axis2=-1)
        posterior = certain(posterior, np.maximum(left_over, ROUNDING**2 * prior))
    return Update(mean + apply(gain, residual), posterior, log_density, lower, left)


def spread(matrix: Array, cov: Array, noise: Array) -> Array:
    """The size of the numbers that are added up to the variances of F P Fᵀ + noise, (..., d)."""
    size = np.abs(matrix)
    summed: Array = (multiply(size, np.abs(cov)) * size).sum(axis=-1)
    return summed + np.diagonal(noise, axis1=-2, axis2=-1)


def certain(cov: Array, rounding: Array) -> Array:
    """A covariance without the components whose variance is no more than rounding, (..., n)."""
    open_ = np.diagonal(cov, axis1=-2, axis2=-1) > rounding
    if open_.all():
        return cov
    return np.where(open_[..., None] & open_[..., None, :], cov, 0.0)


def _many(mean: Array, cov: Array, matrix: Array, vector: Array, noise: Array) -> bool:
    """Whether these are of many runs, the only leading axis, in the layout that goes along them."""
    parts = mean, cov, matrix, vector, noise
    return (
        by_runs(cov)
        and cov.strides[0] > 0  # one covariance of all runs, 1 × 1, looks like any layout
        and [part.ndim for part in parts] == [2, 3, 3, 2, 3]
        and all(len(part) == len(cov) for part in parts)
    )


def _by_component(array: Array) -> Array:
    """Runs last; one run where broadcasting has made it stand for all."""
    if array.strides[0] == 0:
        array = array[:1]
    return array.transpose(*range(1, array.ndim), 0)


def _by_run(array: Array) -> Array:
    """Runs first."""
    return array.transpose(-1, *range(array.ndim - 1))


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
    gain = pseudoinverse.gain(cross, forward_cov, lower)
    keep = one_minus(multiply(gain, matrix))
    rest = make_symmetric(sandwich(keep, cov) + sandwich(gain, noise))
    return Conditional(gain, mean - apply(gain, forward_mean), rest)


def push(mean: Array, cov: Array, conditional: Conditional) -> tuple[Array, Array]:
    """Moments of F x + b + n for x ~ N(mean, cov)."""
    matrix, offset, noise = conditional
    return apply(matrix, mean) + offset, make_symmetric(sandwich(matrix, cov) + noise)


def predict(mean: Array, cov: Array, conditional: Conditional) -> tuple[Array, Array]:
    """`push`, with zeros told from their rounding where the noise leaves components out."""
    matrix, offset, noise = conditional
    full = (np.diagonal(distinct(noise), axis1=-2, axis2=-1) != 0.0).all()
    if full and distinct(matrix).ndim == 3 and _many(mean, cov, matrix, offset, noise):
        found = along_runs.predict(
            _by_component(mean),
            _by_component(cov),
            _by_component(matrix),
            _by_component(offset),
            _by_component(noise),
        )
        return _by_run(found[0]), _by_run(found[1])
    result, result_cov = push(mean, cov, conditional)
    if not full:
        result_cov = certain(result_cov, ROUNDING * spread(matrix, cov, noise))
    return result, result_cov


def log_density(residual: Array, cov: Array) -> Array:
    """The log-density ln N(residual; 0, cov), (...); NaN where it does not exist."""
    lower = roots.root(cov)
    singular = roots.determined(lower).any(axis=-1)
    white = roots.solve_lower(lower, residual[..., None])[..., 0]
    value = -0.5 * (
        inner(white, white) + roots.log_determinant(lower) + residual.shape[-1] * LOG_2PI
    )
    return np.where(singular, np.nan, value)


def principal_axes(cov: Array) -> tuple[Array, Array]:
    """Variances along the axes of (..., 2, 2), the larger first, and the angle of the first."""
    values, vectors = np.linalg.eigh(cov)
    return np.maximum(values[..., ::-1], 0.0), np.arctan2(vectors[..., 1, 1], vectors[..., 0, 1])


def kl(difference: Array, cov: Array, other_cov: Array) -> Array:
    """KL(N(μ, cov) ‖ N(μ', other_cov)) for μ' − μ = difference (8.4); NaN where it is undefined."""
    lower, other = roots.root(cov), roots.root(other_cov)
    singular = (roots.determined(lower) | roots.determined(other)).any(axis=-1)
    white = roots.solve_lower(other, difference[..., None])[..., 0]
    ratio = roots.solve_lower(other, lower)
    value = 0.5 * (
        roots.log_determinant(other)
        - roots.log_determinant(lower)
        - difference.shape[-1]
        + np.einsum("...ij,...ij->...", ratio, ratio)
        + inner(white, white)
    )
    return np.where(singular, np.nan, value)


def extend(
    mean: Array,
    cov: Array,
    child: slice,
    parents: Index,
    matrix: Array,
    offset: Array,
    noise: Array,
) -> None:
    """Write the child y = F x + b + n into a joint of which it is a part, in place.

    The joint's covariance must be zero where its components are not yet written.
    """
    inside = block(cov, parents, parents)
    part = Conditional(matrix, offset, noise)
    mean[..., child], own = predict(mean[..., parents], inside, part)
    cross = multiply(matrix, cov[..., parents, :])
    variances = np.diagonal(own, axis1=-2, axis2=-1)
    cross = np.where(variances[..., None] > 0.0, cross, 0.0)
    cov[..., child, :] = cross
    cov[..., :, child] = transpose(cross)
    cov[..., child, child] = own


def marginal_error(mean: Array, other: Array, std: Array) -> Array:
    """The largest |mean − other| in standard deviations over the last axis and the first.

    Where the deviation is zero, as a part of the mean's size.
    """
    unit = np.where(std > 0.0, std, np.maximum(np.abs(mean), 1.0))
    largest: Array = (np.abs(mean - other) / unit).max(axis=(0, -1), initial=0.0)
    return largest
