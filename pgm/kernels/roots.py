"""Roots of symmetric positive semidefinite matrices, and normal densities by them.

A root is a lower triangular L with A = L Lᵀ. Where a component is determined by those before it,
its column in L is zero; a matrix and the same matrix in other units have the same zero columns. To
the density such a component adds nothing, which is that of the others. Points stand along the last
axis but one, (..., S, d), so that one root (..., d, d) serves all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Integers,
    Mask,
    apply,
    by_runs,
    components_first,
    components_last,
    deviation,
    room,
    symmetric,
    transpose,
    variances,
)

# A pivot below this part of its diagonal entry is rounding: the component is determined.
NEGLIGIBLE = 1e-13
# A pivot this far below zero, as a part of its diagonal entry, is no rounding: A is indefinite.
INDEFINITE = 1e-9
# From this many matrices on, one vectorised operation a column beats one LAPACK call a matrix.
_MANY = 16
# A share of the variances beyond which a negative eigenvalue is visible in float64.
_VISIBLE = 1e-12


def root(matrix: Array, scale: Array | None = None, negligible: float = NEGLIGIBLE) -> Array:
    """The lower triangular root of stacked matrices; NaN where one is indefinite or not finite.

    A pivot below the `negligible` part of the scale, (..., n), is rounding: of the diagonal, or of
    larger matrices of which this is a difference.
    """
    diagonal = variances(matrix) if scale is None else scale
    if by_runs(matrix):
        along = regular_root(components_first(matrix, 2), negligible, components_first(diagonal, 1))
        if along is not None:
            return components_last(along, 2)
        return _semidefinite_root(matrix, diagonal, negligible)
    try:
        lower = np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return _semidefinite_root(matrix, diagonal, negligible)
    pivots = np.diagonal(lower, axis1=-2, axis2=-1)
    if (pivots * pivots > negligible * diagonal).all():
        return lower
    return _semidefinite_root(matrix, diagonal, negligible)


def regular_root(matrix: Array, least: float, scale: Array | None = None) -> Array | None:
    """The roots of matrices (n, n, *batch), whose batch stands together in memory.

    None where a pivot is not above the `least` part of the diagonal, or of the scale, (n, *batch).
    """
    lower = np.zeros_like(matrix)
    with np.errstate(invalid="ignore", divide="ignore"):  # such pivots are not proper: see below
        for j in range(len(matrix)):
            column = matrix[j:, j]
            if j:
                column = column - np.einsum("ik...,k...->i...", lower[j:, :j], lower[j, :j])
            pivot = np.sqrt(column[0], out=lower[j, j, ...])
            np.divide(column[1:], pivot, out=lower[j + 1 :, j])
    pivots = np.einsum("ii...->i...", lower)
    scale = np.einsum("ii...->i...", matrix) if scale is None else scale
    return lower if (pivots * pivots > least * scale).all() else None


def _semidefinite_root(matrix: Array, diagonal: Array, negligible: float) -> Array:
    size = matrix.shape[-1]
    lower = np.zeros_like(matrix)
    indefinite = ~np.isfinite(matrix).all(axis=(-2, -1)) | (diagonal < 0.0).any(axis=-1)
    scale = np.sqrt(np.maximum(diagonal, 0.0))
    for j in range(size):
        column = matrix[..., j:, j] - apply(lower[..., j:, :j], lower[..., j, :j])
        pivot = column[..., 0]
        proper = pivot > negligible * diagonal[..., j]
        allowed = scale[..., j:] * scale[..., j, None]
        # A determined component may not vary with a later one: |A_ij| ≤ √(pivot A_ii).
        stray = (np.abs(column) > np.sqrt(INDEFINITE) * allowed).any(axis=-1)
        indefinite |= (pivot < -INDEFINITE * diagonal[..., j]) | (~proper & stray)
        divisor = np.sqrt(np.where(proper, pivot, 1.0))
        lower[..., j:, j] = np.where(proper[..., None], column / divisor[..., None], 0.0)
    lower[indefinite] = np.nan
    return lower


def determined(lower: Array) -> Mask:
    """The mask of components that those before them determine, (..., n), by a root."""
    fixed: Mask = np.diagonal(lower, axis1=-2, axis2=-1) == 0.0
    return fixed


def _regular(lower: Array, fixed: Mask) -> Array:
    if not fixed.any():
        return lower
    return lower + fixed[..., None] * np.eye(lower.shape[-1])


def solve_lower(lower: Array, right: Array) -> Array:
    """The Y with L Y = B, (..., n, m); in determined rows what is left of B."""
    return _solve(_regular(lower, determined(lower)), right, range(lower.shape[-1]))


def solve_upper(lower: Array, right: Array) -> Array:
    """The X with Lᵀ X = B, (..., n, m), zero in rows of determined components."""
    fixed = determined(lower)
    if fixed.any():
        right = np.where(fixed[..., None], 0.0, right)
    return _solve(transpose(_regular(lower, fixed)), right, range(lower.shape[-1])[::-1])


def _solve(triangle: Array, right: Array, order: range) -> Array:
    """Solve with regular triangular matrices; row by row, in this order, where they are many."""
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
    """Some X with L Lᵀ X = B, (..., n, m), for a B in the range of L Lᵀ."""
    return solve_upper(lower, solve_lower(lower, right))


def regression(cross: Array, cov: Array) -> Array:
    """The gain C P⁺ of a cross-covariance C, (..., m, n), P⁺ in units of deviations."""
    variance = variances(cov)
    unit = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    correlation = cov / (unit[..., :, None] * unit[..., None, :])
    inverse = np.linalg.pinv(correlation, rcond=NEGLIGIBLE, hermitian=True)
    found: Array = (cross / unit[..., None, :]) @ inverse / unit[..., None, :]
    return found


def gain(cross: Array, lower: Array, cov: Array | None = None) -> Array:
    """C P⁺ for P = L Lᵀ and a cross-covariance C, (..., m, n), whose rows lie in the range of P.

    With P itself, by `regression` where its root was lost to rounding.
    """
    result = transpose(solve(lower, transpose(cross)))
    if cov is not None:
        lost = np.isnan(lower).any(axis=(-2, -1))
        if lost.any():
            result[lost] = regression(cross[lost], cov[lost])
    return result


def whiten(lower: Array, residual: Array) -> Array:
    """L⁻¹ r, (..., n), zero in determined components."""
    white = solve_lower(lower, residual[..., None])[..., 0]
    return np.where(determined(lower), 0.0, white)


def log_determinant(lower: Array) -> Array:
    """The value ln |L Lᵀ| over the components that are not determined, (...)."""
    pivots = np.diagonal(lower, axis1=-2, axis2=-1)
    fixed = pivots == 0.0
    if fixed.any():
        pivots = np.where(fixed, 1.0, pivots)
    total: Array = np.log(pivots).sum(axis=-1)
    return 2.0 * total


def smallest_pivot(lower: Array) -> float:
    """The smallest share of a component that those before it leave open, over the stack."""
    pivots = np.diagonal(lower, axis1=-2, axis2=-1)
    total = np.einsum("...ij,...ij->...i", lower, lower)
    return float((pivots * pivots / np.where(total > 0.0, total, 1.0)).min(initial=1.0))


def is_regular(cov: Array, least: float) -> bool:
    """Whether no component of some variance is determined to `least` by those before it."""
    pivots = np.diagonal(root(cov), axis1=-2, axis2=-1)
    variance = variances(cov)
    return bool(((pivots * pivots > least * variance) | (variance == 0.0)).all())


def is_proper(lower: Array) -> bool:
    """Whether every root of the stack exists (its matrix was semidefinite and finite)."""
    return not np.isnan(np.diagonal(lower, axis1=-2, axis2=-1).sum())


def semidefinite(cov: Array, largest: float) -> Array:
    """Covariances without the asymmetry and the negative eigenvalues that rounding has left.

    Eigenvalues are in units of the variances; one that is `largest` below zero is no rounding.
    """
    cov = symmetric(cov)
    unit = deviation(cov)
    unit = np.where(unit > 0.0, unit, 1.0)
    scaled = cov / unit[..., None] / unit[..., None, :]
    if not np.isfinite(scaled).all():
        return cov
    values, axes = np.linalg.eigh(scaled)
    least = values.min(axis=-1, initial=0.0)
    blurred = (least < -_VISIBLE) & (least > -largest)
    if not blurred.any():
        return cov
    kept = (axes * np.maximum(values, 0.0)[..., None, :]) @ axes.mT
    return np.where(blurred[..., None, None], kept * unit[..., None] * unit[..., None, :], cov)


class Tridiagonal(NamedTuple):
    """The symmetric equations Aₖ₋₁ᵀ xₖ₋₁ + Dₖ xₖ + Aₖ xₖ₊₁ = rₖ, for stacks with the steps k first.

    D (N, R, n, n) is positive definite as a whole.
    """

    diagonal: Array
    above: Array
    right: Array


def solve_tridiagonal(system: Tridiagonal) -> Array:
    """The solution, (N, R, n); NaN in runs whose system is not positive definite."""
    from scipy.linalg.lapack import dpbsv  # here, since LAPACK is slow to import

    steps, runs, size = system.right.shape
    solution = room((steps, runs), (size,))
    band = np.zeros((steps, size, 2 * size))
    for run in range(runs):
        # Column (k, j) of the matrix, from its diagonal entry down.
        for j in range(size):
            band[:, j, : size - j] = system.diagonal[:, run, j:, j]
            band[:-1, j, size - j : 2 * size - j] = system.above[:, run, j, :]
        columns = band.reshape(steps * size, 2 * size).T
        right = np.array(system.right[:, run]).reshape(-1)
        _, found, failed = dpbsv(columns, right, lower=1)
        solution[:, run] = np.nan if failed else found.reshape(steps, size)
    return solution


# The part of a point and of the mean by which what users compute may take it off a subspace.
INEXACT = 1e-9
# The part of its deviation by which a component may differ from what those before it determine:
# three times what a root takes for zero.
SLACK = 3.0 * NEGLIGIBLE**0.5


def draw(mean: Array, lower: Array, white: Array) -> Array:
    """Points of N(mean, L Lᵀ), (..., d), for white noise."""
    return mean + apply(lower, white)


def whitened(lower: Array, residual: Array) -> tuple[Array, Array | None]:
    """White residuals, (..., S, d), zero where determined; and what is left there."""
    white = transpose(solve_lower(lower, transpose(residual)))
    fixed = determined(lower)
    if not fixed.any():
        return white, None
    return _without(fixed, white), _without(~fixed, white)


def whitener(lower: Array) -> Array | None:
    """L⁻¹, by which many residuals are whitened at once; None where a component is determined."""
    if determined(lower).any():
        return None
    return solve_lower(lower, np.broadcast_to(np.eye(lower.shape[-1]), lower.shape))


def _without(gone: Mask, vectors: Array) -> Array:
    return np.where(gone[..., None, :], 0.0, vectors)


def log_density(lower: Array, white: Array) -> Array:
    """The log-density −½ (|s|² + ln |2π L Lᵀ|) of the open components, (..., S), at white s."""
    fixed = determined(lower)
    dimension: int | Integers = lower.shape[-1]
    if fixed.any():
        dimension = dimension - fixed.sum(axis=-1)
    constant = log_determinant(lower) + dimension * LOG_2PI
    value: Array = -0.5 * ((white * white).sum(axis=-1) + constant[..., None])
    return value


def off(lower: Array, left: Array, error: Array) -> Mask:
    """Whether residuals (..., S, d), wrong by at most `error`, leave the subspace of the noise."""
    # What is left depends linearly on the residuals: by this matrix.
    spread = np.abs(solve_lower(lower, np.broadcast_to(np.eye(lower.shape[-1]), lower.shape)))
    deviations = np.sqrt((lower * lower).sum(axis=-1))
    allowed = error @ transpose(spread) + SLACK * deviations[..., None, :]
    far: Mask = (np.abs(left) > allowed).any(axis=-1)
    return far


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
    proper = pivot > NEGLIGIBLE * diagonal
    if proper.all():
        return left * left / pivot
    return np.where(proper, left * left / np.where(proper, pivot, 1.0), 0.0)
