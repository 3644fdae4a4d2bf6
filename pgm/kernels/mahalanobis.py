"""Squared Mahalanobis distances νᵀ S⁻¹ ν of innovations ν ~ N(0, S), and chi-square limits."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from pgm.kernels import step, written
from pgm.kernels.arrays import Array, Integers, components_last, quiet
from pgm.kernels.dense import Runs, Stack
from pgm.kernels.numbers import Matrix
from pgm.kernels.roots import NEGLIGIBLE

# Components up to which one covariance is for lines of Python.
_FEW = 6


def square_within(probability: float, dimension: Integers) -> Array:
    """The chi-square quantiles q: νᵀ S⁻¹ ν is below q with the probability `probability`.

    `dimension` has the numbers of components of ν, one for each quantile, in any shape.
    """
    from scipy.special import chdtri  # here, since it is slow to import

    return np.asarray(chdtri(dimension, 1.0 - probability), dtype=np.float64)


def squares(residual: Array, cov: Array) -> Array | float:
    """The squared distances νᵀ S⁻¹ ν, (*batch), of innovations ν ~ N(0, S).

    ν is `residual` (d, *batch), S `cov` (d, d, *batch). A component that earlier components
    determine, its pivot in S being at most 10⁻¹³ of its variance, adds nothing. The square is NaN
    where S is indefinite.
    """
    if cov.ndim == 2:
        one: float | None = _one(len(cov))(residual, cov) if len(cov) <= _FEW else None
        if one is not None:
            return one
    else:
        with quiet():  # of what is not regular
            found = step.innovation(Runs(residual[:, None]), Runs(cov, True))
        if (found.share > NEGLIGIBLE).all():
            many: Array = found.square
            return many
    parts = Stack.column(components_last(residual, 1)), Stack(components_last(cov, 2), True)
    careful: Array = step.innovation(*parts).square
    return careful


@lru_cache(maxsize=64)
def _one(size: int) -> Callable[[Array, Array], float | None]:
    """The function `squares` of one regular S of d components; None where it is not regular."""

    def body(residual: Matrix, cov: Matrix) -> tuple[list[Any], Any]:
        found = step.innovation(residual, cov)
        return [found.square], found.share > NEGLIGIBLE

    return written.function({"residual": (size,), "cov": (size, size)}, body)
