"""Gaussians in moment form on arrays: mean (..., n), covariance (..., n, n), singular ones too.

Rounding leaves a variance that ought to be zero at up to about 10⁻¹⁴ of the summands that it was
computed from (`ROUNDING`): by this bound zeros are told from small variances. A measurement of d
components of a belief N(m, P) is z = H x + v, v ~ N(0, noise); S = H P Hᵀ + noise is the covariance
of its residual z − H m.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import roots, solving, step
from pgm.kernels.arrays import LAST_PLACES, LOG_2PI, Array, inner, multiply, transpose
from pgm.kernels.dense import Rounded, Stack, StackRoot

# The part of what is summed up that rounding leaves where the sum ought to be zero.
ROUNDING = 1e-14


class Update(NamedTuple):
    """The belief N(mean, cov) after a measurement, and the measurement's log-density (...).

    `square` (...) is rᵀ S⁻¹ r of the measurement's residual r = z − H mean.
    `lower` (..., d, d) is the lower triangular root L of S = L Lᵀ, NaN where S is indefinite. A
    measured component that the components before it determine adds nothing to the density. `left`
    (..., d) has the distance of each such component from the value determined, and zero for all
    other components; it is None if none is determined.
    """

    mean: Array
    cov: Array
    log_density: Array
    square: Array
    lower: Array
    left: Array | None


def update(
    mean: Array, cov: Array, matrix: Array, residual: Array, noise: Array, *, exact: bool = True
) -> Update:
    """Condition N(mean, cov) on a measurement z = H x + v, v ~ N(0, noise), residual z − H mean.

    The mean is m + G (z − H m) with the gain G = P Hᵀ S⁺; the covariance is (I − GH) P (I − GH)ᵀ +
    G noise Gᵀ. H is `matrix` (..., d, n), `residual` (..., d), `noise` (..., d, d). With `exact`,
    for a noise that may be singular, pivots of S and variances of the result are compared with the
    summands that they are computed from, and are zero where they are only rounding. Without it,
    pivots of S are compared with the diagonal of S alone, and variances of the result stay.
    """
    belief, slope, error = Stack(cov, True), Stack(matrix), Stack(noise, True)
    cross, ahead = step.crossed(belief, slope, error)
    predictive = ahead.array
    lower = roots.root(predictive, spread(matrix, cov, noise) if exact else None)
    root, off = StackRoot(lower), Stack.column(residual)
    gain = step.gain(root, cross)
    after = step.given(Stack.column(mean), belief, slope, off, error, root, gain)
    left = root.left(off) if root.fixed.any() else None
    dimension = residual.shape[-1] - root.fixed.sum(axis=-1)
    log_density = -0.5 * (after.square + dimension * LOG_2PI) - after.volume
    posterior = after.cov.array
    if exact:
        # 1 − GH is rounded itself, which leaves about 1e-32 of what is certain now.
        keep = (gain @ slope).one_minus().array
        left_over = ROUNDING * spread(keep, cov, np.zeros_like(cov))
        prior = np.diagonal(cov, axis1=-2, axis2=-1)
        posterior = certain(posterior, np.maximum(left_over, ROUNDING**2 * prior))
    return Update(after.mean.vector, posterior, log_density, after.square, lower, left)


def squares(cov: Array, gain: Array, matrix: Array, noise: Array) -> Array:
    """The covariance (I − G H) P (I − G H)ᵀ + G noise Gᵀ after an update, (..., n, n).

    P is `cov` (..., n, n), G any gain, `gain` (..., n, d), H `matrix` (..., d, n), and `noise`
    (..., d, d).
    """
    found = step.squares(Stack(cov, True), Stack(gain), Stack(matrix), Stack(noise, True))
    result: Array = found.array
    return result


def predict(cov: Array, matrix: Array, noise: Array) -> Array:
    """The covariance F P Fᵀ + noise, (..., d, d), of y = F x + b + e, F being `matrix`."""
    found: Array = step.predict(Stack(cov, True), Stack(matrix), Stack(noise)).array
    return found


def spread(matrix: Array, cov: Array, noise: Array) -> Array:
    """The sums of the sizes of all terms in the variances of F P Fᵀ + noise, (..., d).

    They are the diagonal of |F| |P| |F|ᵀ + noise, F being `matrix` (..., d, n), P `cov`
    (..., n, n): a variance that is far smaller may be rounding.
    """
    size = np.abs(matrix)
    summed: Array = (multiply(size, np.abs(cov)) * size).sum(axis=-1)
    return summed + np.diagonal(noise, axis1=-2, axis2=-1)


def certain(cov: Array, rounding: Array) -> Array:
    """Covariances (..., n, n), with zero rows and columns for variances of at most `rounding`.

    `rounding` (..., n) has a bound for each variance.
    """
    open_ = np.diagonal(cov, axis1=-2, axis2=-1) > rounding
    if open_.all():
        return cov
    return np.where(open_[..., None] & open_[..., None, :], cov, 0.0)


class Conditional(NamedTuple):
    """An affine Gaussian, p(x | y): x = F y + b + e, e ~ N(0, cov), F = matrix, b = offset.

    For x of n and y of d components F is (..., n, d), b (..., n) and cov (..., n, n).
    """

    matrix: Array
    offset: Array
    cov: Array


def reverse(
    mean: Array, cov: Array, matrix: Array, noise: Array, forward_mean: Array, forward_cov: Array
) -> Conditional:
    """Bayes' rule for y = A x + c + w, w ~ N(0, noise): p(x | y) from x ~ N(mean, cov).

    A is `matrix` (..., d, n), `noise` (..., d, d), m `mean` (..., n) and P `cov` (..., n, n). The
    prediction of y is N(m_y, P_y), m_y = `forward_mean` (..., d), P_y = `forward_cov` (..., d, d).
    With the gain G = P Aᵀ P_y⁺ the result is x = G y + (m − G m_y) + e: its matrix is G, its offset
    m − G m_y, and its covariance, that of the noise e, is computed as (I − GA) P (I − GA)ᵀ +
    G noise Gᵀ, which subtracts nothing from P.
    """
    # The rest is right for any gain: only what is no more than rounding has to go.
    later = Rounded(forward_cov, spread(matrix, cov, noise), 0.1 * ROUNDING)
    parts = Stack.column(mean), Stack(cov, True), Stack(matrix), Stack(noise, True)
    found = step.reverse(*parts, Stack.column(forward_mean), later)
    return Conditional(found.gain.array, found.offset.vector, found.cov.array)


def push(mean: Array, cov: Array, conditional: Conditional) -> tuple[Array, Array]:
    """The mean (..., d) and covariance (..., d, d) of y for x ~ N(mean, cov) and p(y | x).

    `conditional` is p(y | x), that is y = F x + b + e; x is of n components, y of d.
    """
    matrix, offset, noise = conditional
    pushed = step.push(
        *(Stack.column(mean), Stack(cov, True)), Stack(matrix), Stack.column(offset), Stack(noise)
    )
    return pushed[0].vector, pushed[1].array


def pushed_with(mean: Array, cov: Array, conditional: Conditional) -> tuple[Array, Array]:
    """The moments of y and x as one vector, (..., d + n) and (..., d + n, d + n).

    x ~ N(mean, cov) is of n components, and `conditional` is p(y | x), as of `push`.
    """
    own_mean, own_cov = push(mean, cov, conditional)
    cross = conditional.matrix @ cov
    upper = np.concatenate([own_cov, cross], axis=-1)
    lower = np.concatenate([transpose(cross), cov], axis=-1)
    return np.concatenate([own_mean, mean], axis=-1), np.concatenate([upper, lower], axis=-2)


def log_density(residual: Array, cov: Array) -> Array:
    """The log-density ln N(residual; 0, cov), (...), of residuals (..., n).

    NaN where `cov` (..., n, n) is singular or indefinite.
    """
    found = step.innovation(Stack.column(residual), Stack(cov, True))
    value = -0.5 * (found.square + residual.shape[-1] * LOG_2PI) - found.volume
    return np.where(found.share > 0.0, value, np.nan)


def principal_axes(cov: Array) -> tuple[Array, Array]:
    """The variances along the principal axes of covariances (..., 2, 2), and an axis's angle.

    The variances (..., 2) are the eigenvalues, the larger first, negative ones as zero; the angle
    (...), in (−π/2, π/2], is that of the axis of the larger one, against the first component.
    """
    values, vectors = np.linalg.eigh(cov)
    angle = np.arctan2(vectors[..., 1, 1], vectors[..., 0, 1])
    turned = np.where(angle > 0.5 * np.pi, angle - np.pi, angle)
    return np.maximum(values[..., ::-1], 0.0), np.where(
        angle <= -0.5 * np.pi, angle + np.pi, turned
    )


def kl(difference: Array, cov: Array, other_cov: Array) -> Array:
    """KL(N(μ, cov) ‖ N(μ′, other_cov)) in nats, (...), for μ′ − μ = difference (..., n).

    NaN where either covariance is singular or indefinite.
    """
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


def entropy(cov: Array) -> Array:
    """The entropy −∫ p ln p of a Gaussian in nats, (...); NaN where its covariance is singular."""
    lower = roots.root(cov)
    singular = roots.determined(lower).any(axis=-1)
    value = 0.5 * (cov.shape[-1] * (1.0 + LOG_2PI) + solving.log_determinant(lower))
    return np.where(singular, np.nan, value)


def mutual_information(cov: Array, cross: Array, other_cov: Array) -> Array:
    """The mutual information of two parts of a Gaussian in nats, (...).

    `cov` (..., n, n) and `other_cov` (..., m, m) are the covariances of the parts, `cross`
    (..., n, m) that between them. It is −½ Σ ln(1 − ρ²) over their canonical correlations ρ: ∞
    where one part determines a direction of the other but for a part in 10¹³, and nothing is
    subtracted where they are nearly independent. NaN where a covariance is indefinite or infinite.
    """
    one, other = roots.root(cov), roots.root(other_cov)
    half = _whitened(one, cross)
    white = _whitened(other, transpose(half))
    improper = np.asarray(np.isnan(white).any(axis=(-2, -1), keepdims=True))
    white = np.where(improper, 0.0, white)
    correlations = np.linalg.svd(white, compute_uv=False)
    left = np.maximum(1.0 - correlations**2, 0.0)
    certain = (left < roots.NEGLIGIBLE).any(axis=-1)
    with np.errstate(divide="ignore"):
        found = 0.5 * (-np.log1p(-(np.minimum(correlations, 1.0) ** 2))).sum(axis=-1)
    return np.where(improper[..., 0, 0], np.nan, np.where(certain, np.inf, found))


def _whitened(lower: Array, values: Array) -> Array:
    """L⁻¹ times values (..., n, m); zero of components that others determine."""
    found = solving.solve_lower(lower, values)
    return np.where(roots.determined(lower)[..., None], 0.0, found)


def marginal_error(mean: Array, other: Array, std: Array) -> Array:
    """The largest |mean − other| / s of two arrays of means (T, ..., n) of T steps, as (...).

    The largest is over the first and the last axis, those of steps and components. s is the
    standard deviation `std` (T, ..., n), or max(|mean|, 1) where `std` is zero.
    """
    unit = np.where(std > 0.0, std, np.maximum(np.abs(mean), 1.0))
    largest: Array = (np.abs(mean - other) / unit).max(axis=(0, -1), initial=0.0)
    return largest


def moved(mean: Array, other: Array, std: Array) -> Array:
    """How far an iteration has moved means from `other` to `mean`, m′ to m, (T, ..., n) both.

    The result (...) is the largest (|m − m′| − 32 ε max(|m|, |m′|))₊ / s over the T steps and the n
    components. s is the standard deviation `std` (T, ..., n), or max(|m|, 1) where that is zero. ε
    is the rounding unit of float64; the term with ε takes rounding off the move, since otherwise
    means of 10⁸ standard deviations would never settle.
    """
    unit = np.where(std > 0.0, std, np.maximum(np.abs(mean), 1.0))
    rounding = LAST_PLACES * np.maximum(np.abs(mean), np.abs(other))
    left = np.maximum(np.abs(mean - other) - rounding, 0.0)  # NaN stays
    largest: Array = (left / unit).max(axis=(0, -1), initial=0.0)
    return largest
