"""Covariances of the noise of a stream's rows, some of which may be unknown."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats
from pgm.errors import EvidenceError
from pgm.factors.arrays import covariance_fault, diagonal, symmetrised
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array, Mask, deviation, symmetric, transpose


def of_variances(table: Array) -> Array:
    """Covariances (n, d, d) of components that are not correlated, of variances (n, d) or NaN."""
    negative = np.flatnonzero((table < 0.0).any(axis=1))
    if negative.size:
        row = int(negative[0])
        raise EvidenceError(f"variances, row {row}: {table[row].tolist()}; 0 or more was due")
    return closed(diagonal(table))


def of_covariances(given: npt.ArrayLike, rows: int, names: Sequence[str]) -> Array:
    """Covariances (n, d, d) as they are given, checked row by row."""
    size = len(names)
    cov = as_floats(given, "cov", EvidenceError, missing=True).copy()
    if cov.size == 0 and rows == 0:
        cov = cov.reshape(0, size, size)
    if cov.shape != (rows, size, size):
        raise EvidenceError(
            f"cov has shape {cov.shape}; {(rows, size, size)} was due, a matrix over "
            f"{listed(names)} for each stamp; variances of each, {(rows, size)}, are variances="
        )
    if found := faults(cov):
        row, fault = next(iter(found.items()))
        raise EvidenceError(
            f"cov, row {row}: {cov[row].tolist()} {fault}; NaN is a variance that is unknown, and "
            "0 a covariance of what is not correlated"
        )
    return closed(symmetric(cov))


def faults(cov: Array) -> dict[int, str]:
    """Why rows (n, d, d) are no covariances of the components whose variances are no NaN."""
    proper = _proper(cov)
    if covariance_fault(symmetrised(proper)) is None:
        return {}
    each = {row: covariance_fault(symmetrised(matrix)) for row, matrix in enumerate(proper)}
    return {row: fault for row, fault in each.items() if fault}


def closed(cov: Array) -> Array:
    """Covariances (n, d, d), NaN in the rows and columns of variances that are unknown."""
    return np.where(_both(~np.isnan(_diagonal(cov))), cov, np.nan)


def turned(cov: Array, turns: Array) -> Array:
    """T P Tᵀ of covariances and rotations (n, d, d); unknown and infinite variances stay so.

    It is the square of T L, where P = L Lᵀ: where one variance is far smaller than others, T P Tᵀ
    could be indefinite by rounding.
    """
    moved = (turns != np.eye(cov.shape[-1])).any(axis=(1, 2))
    known = _both(np.isfinite(_diagonal(cov))) & moved[:, None, None]
    finite = np.where(known, cov, 0.0)
    unit = deviation(finite)
    unit = np.where(unit > 0.0, unit, 1.0)
    # A triangular root is none of a matrix that is singular in the ten digits of a file.
    values, axes = np.linalg.eigh(finite / unit[:, :, None] / unit[:, None, :])
    root = turns @ (unit[:, :, None] * axes * np.sqrt(values.clip(0.0))[:, None, :])
    return np.where(known, root @ transpose(root), cov)


def correlation(cov: Array, one: int, other: int) -> Array:
    """The size of the correlation of two components, (n,); 0 where it is unknown."""
    deviations = np.sqrt(cov[:, one, one]) * np.sqrt(cov[:, other, other])
    between = np.abs(cov[:, one, other])
    met = (between > 0.0) & (deviations > 0.0)
    found: Array = np.divide(between, deviations, out=np.zeros(len(cov)), where=met)
    return found


def correlated(cov: Array) -> list[tuple[int, int]]:
    """The pairs of components that have a covariance, other than 0, in some row."""
    met = ((cov != 0.0) & ~np.isnan(cov)).any(axis=0)
    return [(j, k) for j, k in combinations(range(len(met)), 2) if met[j, k]]


def _proper(cov: Array) -> Array:
    """Covariances without the unknown variances, and without infinite ones, which are alone."""
    variances = _diagonal(cov)
    proper = np.where(_both(~np.isnan(variances)), cov, 0.0)
    np.einsum("nii->ni", proper)[variances == np.inf] = 0.0
    return proper


def _diagonal(cov: Array) -> Array:
    return np.diagonal(cov, axis1=1, axis2=2)


def _both(components: Mask) -> Mask:
    """The mask (n, d, d) of pairs of which both components are in a mask (n, d)."""
    pairs: Mask = components[:, :, None] & components[:, None, :]
    return pairs
