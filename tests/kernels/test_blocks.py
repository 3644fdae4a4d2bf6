"""Sweeps of one long run of few states in blocks, against the recursion step by step."""

import numpy as np
import pytest

from pgm.kernels.markov import Blocks


@pytest.mark.parametrize("steps", [26, 200, 40_001])
def test_backward_messages_of_unlikely_measurements(steps):
    """A last block of one step is all padding, during which the others are scaled as ever."""
    rng = np.random.default_rng(0)
    matrix = rng.dirichlet(np.ones(3), 3)
    weights = np.where(rng.random((steps, 3)) < 0.1, 1.0, 1e-4)
    rows = np.empty((steps + 1, 3))
    Blocks(matrix, weights).backward(rows)
    message, due = np.full(3, 1.0 / 3.0), []
    for weight in weights[::-1]:
        message = matrix @ (weight * message)
        message /= message.sum()
        due.append(message)
    sums = rows[:-1].sum(axis=1, keepdims=True)
    np.testing.assert_allclose(rows[:-1] / sums, due[::-1], rtol=1e-9)
    assert sums.min() > 1e-100
