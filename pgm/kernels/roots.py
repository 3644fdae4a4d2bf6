"""Roots of symmetric positive semidefinite matrices, and what their pivots say.

A root is a lower triangular L with A = L Lᵀ. Where a component is determined by those before it,
its column in L is zero; a matrix and the same matrix in other units have the same zero columns.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import (
    Array,
    Mask,
    apply,
    by_runs,
    components_first,
    components_last,
    variances,
)

# A pivot below this part of its diagonal entry is rounding: the component is determined.
NEGLIGIBLE = 1e-13
# A pivot this far below zero, as a part of its diagonal entry, is no rounding: A is indefinite.
INDEFINITE = 1e-9


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
    """The root by columns, with zero columns of determined components (Higham, 2002, section 10.3).

    A pivot below the `negligible` part of the scale is zero, and so is its column. A matrix is
    indefinite, and its root NaN, where a pivot is clearly negative, or where a component whose
    pivot is zero still varies with a later one.
    """
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
    """The mask of components that earlier ones determine (a zero pivot), (..., n)."""
    fixed: Mask = np.diagonal(lower, axis1=-2, axis2=-1) == 0.0
    return fixed


def smallest_pivot(lower: Array) -> float:
    """The smallest L_ii² / P_ii over the stack, P = L Lᵀ."""
    pivots = np.diagonal(lower, axis1=-2, axis2=-1)
    total = np.einsum("...ij,...ij->...i", lower, lower)
    return float((pivots * pivots / np.where(total > 0.0, total, 1.0)).min(initial=1.0))


def is_regular(cov: Array, least: float) -> bool:
    """Whether each component keeps over `least` of its variance given the earlier ones."""
    pivots = np.diagonal(root(cov), axis1=-2, axis2=-1)
    variance = variances(cov)
    return bool(((pivots * pivots > least * variance) | (variance == 0.0)).all())


def is_proper(lower: Array) -> bool:
    """Whether every root of the stack exists (its matrix was semidefinite and finite)."""
    return not np.isnan(np.diagonal(lower, axis1=-2, axis2=-1).sum())
