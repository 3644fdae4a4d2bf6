"""Linear programmes about the differences of numbers."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array

from pgm.kernels.arrays import Array, Integers


def least(cost: Array, minus: Integers, limit: Array, end: float | None = None) -> Array:
    """Numbers x in [0, end] that cost least, x_i − x_j − s_k <= limit.

    Parameters
    ----------
    cost : ndarray
        (n + slacks,): of the numbers, then of the slacks s, which are 0 or more.
    minus : ndarray of int
        (M, 3): i, j, and the slack that each condition has; −1 for none.
    limit : ndarray
        (M,).
    end : float, optional
        No bound above without.

    Returns
    -------
    ndarray
        (n + slacks,), at a vertex.
    """
    slacks = int(minus[:, 2].max(initial=-1)) + 1
    first = len(cost) - slacks
    row = np.arange(len(minus))
    has = minus[:, 2] >= 0
    rows = np.concatenate([row, row, row[has]])
    columns = np.concatenate([minus[:, 0], minus[:, 1], first + minus[has, 2]])
    signs = np.repeat([1.0, -1.0, -1.0], [len(row), len(row), int(has.sum())])
    less = csr_array((signs, (rows, columns)), shape=(len(minus), len(cost)))
    bounds = [(0.0, end)] * first + [(0.0, None)] * slacks
    found = linprog(cost, A_ub=less, b_ub=limit, bounds=bounds, method="highs-ds")  # type: ignore[call-overload]
    x: Array = found.x
    return x
