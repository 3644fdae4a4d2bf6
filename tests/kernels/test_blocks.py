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
    message = np.full(3, 1.0 / 3.0)
    for row, weight in zip(rows[-2::-1], weights[::-1], strict=True):
        message = matrix @ (weight * message)
        message /= message.sum()
        np.testing.assert_allclose(row / row.sum(), message, rtol=1e-9)
        assert row.sum() > 1e-100
