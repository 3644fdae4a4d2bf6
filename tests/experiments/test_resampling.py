"""Systematic resampling keeps particles in proportion to their weights."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments.resampling import resampled


class Fixed:
    """Draws one number, again and again."""

    def __init__(self, value):
        self.value = value

    def random(self, shape):
        return np.full(shape, self.value)


def test_resampling_keeps_each_particle_in_proportion():
    weight = np.array([[0.5, 0.25, 0.25, 0.0], [0.0, 0.0, 0.0, 1.0], [0.1, 0.2, 0.3, 0.4]])
    picks = np.array([resampled(weight, np.random.default_rng(k)) for k in range(400)])
    assert picks.shape == (400, 3, 4)
    count = (picks[..., None] == np.arange(4)).sum(axis=2)  # runs of 4 particles
    # A comb of 4 teeth takes 4 w of each, rounded up or down, and 4 w on average.
    assert (np.abs(count - 4 * weight) < 1.0).all()
    assert_allclose(count.mean(axis=0), 4 * weight, atol=0.1)


@pytest.mark.parametrize("offset", [0.0, 0.5, 1.0 - 2.0**-53])
def test_rounding_loses_no_particle(offset):
    """Weights whose sum is not 1 to the last digit, a particle without weight at the end."""
    weight = np.random.default_rng(0).random((2, 100_003))
    weight[:, -1] = 0.0
    weight /= weight.sum(axis=1, keepdims=True)
    picks = resampled(weight * [[1.0 - 1e-15], [1.0 + 1e-15]], Fixed(offset))
    assert picks.shape == weight.shape
    assert (np.diff(picks, axis=1) >= 0).all()
    assert picks.min() >= 0
    assert picks.max() < weight.shape[1] - 1
    expected = weight.shape[1] * weight
    count = np.stack([np.bincount(row, minlength=weight.shape[1]) for row in picks])
    assert (np.abs(count - expected) < 1.0 + 1e-6).all()
