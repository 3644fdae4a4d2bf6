"""Roots of symmetric positive semidefinite matrices, and what their pivots say.

A root is a lower triangular L with A = L Lᵀ; its *pivots* are the L_jj², the variance of each
component given those before it. A component whose pivot is zero is *determined* by those before it,
and its column in L is zero; a matrix and the same matrix in other units have the same zero columns.
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
    """The lower triangular root (..., n, n); NaN where a matrix is indefinite or not finite.

    A pivot of at most `negligible` times `scale` (..., n) is rounding: it and its column are zero.
    `scale` is the sum of the sizes of the terms that the diagonal was summed from; if None, it is
    the diagonal itself.
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
    """The lower roots (n, n, *batch) of positive definite matrices (n, n, *batch), or None.

    None is returned if a pivot, of any matrix, is at most `least` times its entry of `scale`
    (n, *batch), which stands for the diagonal of the matrices if it is None. The function is fast
    where the batch axes are contiguous in memory.
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
    """The root (..., n, n), found column by column, with a zero column for a determined component.

    Source: Higham (2002), section 10.3.

    A pivot of at most `negligible` times `diagonal` (..., n) is zero, and so is its column. A
    matrix counts as indefinite, and its root is NaN, where it is not finite, where a pivot is
    clearly negative, or where a component whose pivot is zero still varies with a later one.
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
    """The mask of determined components, (..., n), from a root: those with a zero pivot."""
    fixed: Mask = np.diagonal(lower, axis1=-2, axis2=-1) == 0.0
    return fixed


def smallest_pivot(lower: Array) -> float:
    """The smallest L_ii² / P_ii, P = L Lᵀ, of roots (..., n, n) in the stack; at most 1."""
    pivots = np.diagonal(lower, axis1=-2, axis2=-1)
    total = np.einsum("...ij,...ij->...i", lower, lower)
    return float((pivots * pivots / np.where(total > 0.0, total, 1.0)).min(initial=1.0))


def is_regular(cov: Array, least: float, lower: Array | None = None) -> bool:
    """Whether each component's pivot is more than `least` times the component's variance.

    All covariances (..., n, n) of the stack are to pass; a component without a variance passes, an
    indefinite matrix does not. `lower` are their roots, where these are known.
    """
    pivots = np.diagonal(root(cov) if lower is None else lower, axis1=-2, axis2=-1)
    variance = variances(cov)
    certain = (variance == 0.0) & (pivots == 0.0)
    return bool(((pivots * pivots > least * variance) | certain).all())


def is_proper(lower: Array) -> bool:
    """Whether no root of the stack is NaN: each matrix was semidefinite and finite."""
    return not np.isnan(np.diagonal(lower, axis1=-2, axis2=-1).sum())
