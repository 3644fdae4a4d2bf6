"""How much of variances is left open, by components before them, by all others, or by measurements.

Covariances P of components first are (n, n, *batch), the batch being () or that of runs. The
arithmetic is that of `step`; for one small covariance it is lines of Python (`written`), for a
batch it goes along rows of runs, or, of many components, matrix by matrix with LAPACK (`dense`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pgm.kernels import step, written
from pgm.kernels.arrays import Array, components_last, quiet
from pgm.kernels.dense import Runs, Stack
from pgm.kernels.numbers import Matrix

# Components up to which one covariance is for lines of Python, and from which on a batch is for
# LAPACK.
_FEW, _MANY = 6, 16


def open_share(cov: Array) -> float:
    """The least share of a component's variance that the components before it leave open.

    It is the variance of component i given those before it, L_ii² for P = L Lᵀ, divided by P_ii;
    the least over all components and the whole batch, at most 1, of `cov` P. Components without a
    variance do not count, and of what is not positive definite the share is zero.
    """
    if cov.size == len(cov) ** 2 and 0 < len(cov) <= _FEW:
        found = _one(len(cov))(cov.reshape(cov.shape[:2]))
        return found if found is not None else 0.0
    return float(np.min(step.open_share(*_varying(cov)), initial=1.0))


def inflation(cov: Array) -> Array:
    """The sums of the variance inflation factors of covariances, (*batch).

    The factor of a component is its variance divided by its variance given all other components;
    that of a component without a variance is one. The sum is infinite where a covariance is not
    positive definite.
    """
    matrix, varies = _varying(cov)
    with quiet():  # of what is singular
        regular = matrix.independent(varies)
        root = regular.root()
        found = step.inflation(regular, root)
    return np.where(root.share > 0.0, found, np.inf)


def least_left(before: Array, after: Array) -> float:
    """The smallest ratio of a variance in `after` to the same component's in `before`, at most 1.

    Both are covariances (n, n, *batch); the smallest is over all components and the batch. A
    component with a variance of zero after, or none above zero before, does not count.
    """
    was, left = (np.einsum("ii...->i...", cov) for cov in (before, after))
    counts = (left != 0.0) & (was > 0.0)
    return float((left[counts] / was[counts]).min(initial=1.0))


def _varying(cov: Array) -> tuple[Any, Any]:
    """Covariances as matrices of the fastest kind, and which components have a variance."""
    if len(cov) < _MANY:
        return Runs(cov), np.einsum("ii...->i...", cov) != 0.0
    last = components_last(cov, 2)
    return Stack(last), np.einsum("...ii->...i", last) != 0.0


@lru_cache(maxsize=64)
def _one(size: int) -> Callable[[Array], float | None]:
    """The function `open_share` of one covariance of n components."""

    def body(cov: Matrix) -> tuple[list[Any], Any]:
        return [step.open_share(cov, [variance != 0.0 for variance in cov.diagonal])], True

    return written.function({"cov": (size, size)}, body)
