"""Covariances as users give them: a variance, the variance of each component, or a matrix."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.boundary import as_floats
from pgm.errors import ModelError
from pgm.factors.scope import Scope, dimension, labels, listed
from pgm.kernels.arrays import Array
from pgm.kernels.checks import covariance_fault, symmetrised


def as_covariance(
    scope: Scope, value: Any, what: str, *, runs: bool = True, flat: bool = False, **about: Any
) -> Array:
    """A copy of a covariance over a scope as matrices, (..., n, n), checked.

    The number of axes says what is given, never their length: none is one variance for every
    component, one holds the variance of each, two or more end in matrices.

    Parameters
    ----------
    scope : tuple of Variable
        n components.
    value : array_like
        (), (n,) or (..., n, n).
    what : str
        The covariance, for messages.
    runs : bool
        Whether matrices may have leading axes.
    flat : bool
        Whether variances may be infinite, of components that are independent of all others.
    """
    given = as_floats(value, what, **about)
    size = dimension(scope)
    cov = matrices(given, size).copy()
    if cov.shape[-2:] != (size, size) or (cov.ndim > 2 and not runs):
        due = _due(scope, given.ndim, runs)
        raise ModelError(f"{what} has shape {given.shape}; {due}", **about)
    cov = symmetrised(cov)
    proper = _closed(cov, what, **about) if flat and (cov == np.inf).any() else cov
    if fault := covariance_fault(proper):
        raise ModelError(f"{what} {fault}", **about)
    return cov


def matrices(cov: Array, size: int) -> Array:
    """Diagonal matrices of a variance, or of a vector of variances; matrices as they are."""
    if cov.ndim == 0:
        cov = np.full(size, cov)
    return diagonal(cov) if cov.ndim == 1 else cov


def diagonal(variances: Array) -> Array:
    """Diagonal matrices (..., n, n) of variances (..., n), which may be infinite."""
    size = variances.shape[-1]
    return np.where(np.eye(size, dtype=bool), variances[..., None], 0.0)


def _due(scope: Scope, axes: int, runs: bool) -> str:
    """The shapes that a covariance may have, in words."""
    size = dimension(scope)
    due = (
        f"its {size} components ({listed(labels(scope))}) need ({size}, {size}), the "
        f"variances ({size},), or one variance for all of them"
    )
    if runs and axes > 1:
        due += "; variances (..., n) of each run are matrices as cov[..., None] * np.eye(n)"
    return due


def _closed(cov: Array, what: str, **about: Any) -> Array:
    """The covariance with variances of one for the infinite ones, of independent components."""
    size = cov.shape[-1]
    open_ = np.diagonal(cov, axis1=-2, axis2=-1) == np.inf
    infinite = open_[..., None] & np.eye(size, dtype=bool)
    met = (open_[..., None] | open_[..., None, :]) & ~infinite
    if (cov[met] != 0.0).any():
        raise ModelError(
            f"{what}: a component of infinite variance has a covariance with another one; it must "
            "be 0",
            **about,
        )
    if not (open_ == open_.reshape(-1, size)[0]).all():
        raise ModelError(
            f"{what} is infinite in other components in some runs than in others; give all runs "
            "the same ones",
            **about,
        )
    return np.where(infinite, 1.0, cov)
