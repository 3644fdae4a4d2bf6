"""Block tridiagonal equations, such as the normal equations of a chain, solved as a band matrix."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import (
    Array,
    room,
)


class Tridiagonal(NamedTuple):
    """The symmetric equations Aₖ₋₁ᵀ xₖ₋₁ + Dₖ xₖ + Aₖ xₖ₊₁ = rₖ of the steps k = 1 to N of a chain.

    The first step has no term before, the last none after. There are R runs: D = `diagonal`
    (N, R, n, n), A = `above` (N − 1, R, n, n) and r = `right` (N, R, n). The whole matrix, of N n
    rows, is to be positive definite in each run.
    """

    diagonal: Array
    above: Array
    right: Array


def solve_tridiagonal(system: Tridiagonal) -> Array:
    """The solution x, (N, R, n); NaN in runs whose whole matrix is not positive definite."""
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
