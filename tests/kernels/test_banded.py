"""Block tridiagonal systems against dense ones."""

import numpy as np
import pytest

from pgm.kernels import tridiagonal
from pgm.kernels.tridiagonal import Tridiagonal


def system(rng, count, runs, size):
    """A random positive definite one."""
    diagonal = np.zeros((count, runs, size, size))
    above = np.zeros((count - 1, runs, size, size))
    for k in range(count):
        for run in range(runs):
            root = rng.normal(size=(2 * size, 2 * size))
            pair = root @ root.T
            diagonal[k, run] += pair[:size, :size]
            if k + 1 < count:
                diagonal[k + 1, run] += pair[size:, size:]
                above[k, run] = pair[:size, size:]
    return Tridiagonal(diagonal, above, rng.normal(size=(count, runs, size)))


def dense(s, run):
    count, _, size = s.right.shape
    matrix = np.zeros((count, size, count, size))
    for k in range(count):
        matrix[k, :, k] = s.diagonal[k, run]
        if k + 1 < count:
            matrix[k, :, k + 1] = s.above[k, run]
            matrix[k + 1, :, k] = s.above[k, run].T
    return matrix.reshape(count * size, -1)


@pytest.mark.parametrize("count", [1, 2, 3, 21])
@pytest.mark.parametrize(("runs", "size"), [(1, 3), (2, 1), (4, 2)])
def test_the_solution_is_that_of_the_dense_system(count, runs, size):
    s = system(np.random.default_rng(count), count, runs, size)
    before = [part.copy() for part in s]
    found = tridiagonal.solve_tridiagonal(s)
    for run in range(runs):
        due = np.linalg.solve(dense(s, run), s.right[:, run].ravel())
        np.testing.assert_allclose(found[:, run].ravel(), due, rtol=1e-8, atol=1e-8)
    for part, was in zip(s, before, strict=True):
        assert np.array_equal(part, was)


@pytest.mark.parametrize("k", [0, 1, 4])
def test_what_is_not_positive_definite_is_nan(k):
    s = system(np.random.default_rng(0), 5, 2, 2)
    s.diagonal[k, 1] = 0.0
    found = tridiagonal.solve_tridiagonal(s)
    assert np.isnan(found[:, 1]).all()
    assert np.isfinite(found[:, 0]).all()
