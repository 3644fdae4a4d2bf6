"""Shapes of generalised Pareto distributions, of draws whose shapes are known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from pgm.kernels import pareto


@pytest.mark.parametrize("shape", [-0.3, 0.2, 0.5, 0.9])
def test_the_shape_and_scale_of_drawn_values(shape):
    drawn = np.random.default_rng(1).random(4000)
    values = np.sort(2.0 * ((1.0 - drawn) ** -shape - 1.0) / shape)
    assert_allclose([each[0] for each in pareto._fitted(values[None])], (shape, 2.0), atol=0.1)


@pytest.mark.parametrize("shape", [0.1, 0.4, 0.8])
def test_the_tail_of_ratios(shape):
    """Ratios U^(−k) have the shape k, and keep their order and their largest."""
    logs = -shape * np.log(np.random.default_rng(2).random(20_000))
    found, fitted = pareto.smoothed(logs)
    assert abs(fitted - shape) < 0.1
    tail = logs > np.sort(logs)[-426]  # 3 √20,000 of them
    assert found.max() <= 0.0
    assert_allclose(found[~tail], (logs - logs.max())[~tail])
    assert (np.argsort(found[tail]) == np.argsort(logs[tail])).all()


def test_the_variance_of_a_ratio_with_a_heavy_tail_falls():
    rng = np.random.default_rng(3)
    raw, smooth = [], []
    for _ in range(200):
        logs = -0.6 * np.log(rng.random(1000))
        for each, where in ((logs - logs.max(), raw), (pareto.smoothed(logs)[0], smooth)):
            weights = np.exp(each)
            where.append(1.0 / np.square(weights / weights.sum()).sum())
    assert np.std(smooth) < np.std(raw)


def test_few_and_equal_ratios():
    assert pareto.smoothed(np.zeros(1000))[1] == -np.inf
    assert pareto.smoothed(np.arange(6.0))[1] == np.inf
    assert pareto.smoothed(np.zeros(6))[1] == -np.inf
    one = np.zeros(1000)
    one[3] = 800.0
    assert pareto.smoothed(one)[1] > 0.7
