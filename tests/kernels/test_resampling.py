"""Resampling draws in proportion to the weights, exactly as many as asked for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pgm.kernels.resampling import RESAMPLERS, indices, systematic

EVERY = pytest.mark.parametrize("name", list(RESAMPLERS))


@EVERY
def test_counts_are_unbiased(name):
    rng = np.random.default_rng(3)
    weights = np.array([0.0, 0.31, 0.02, 0.0, 0.45, 0.07, 0.15, 0.0])
    count, repeats = 7, 20_000
    drawn = np.array([RESAMPLERS[name](weights, count, rng) for _ in range(repeats)])
    error = drawn.std(axis=0) / np.sqrt(repeats)
    assert (np.abs(drawn.mean(axis=0) - count * weights) <= 4.0 * error + 1e-12).all()


@EVERY
@given(
    weights=st.lists(st.floats(0.0, 1e300) | st.just(5e-324), min_size=1, max_size=30),
    count=st.integers(1, 50),
    seed=st.integers(0, 2**32),
)
def test_as_many_are_drawn_as_asked_for_and_none_of_no_weight(name, weights, count, seed):
    weights = np.array(weights)
    if not weights.any() or not np.isfinite(weights.sum()):
        return
    counts = RESAMPLERS[name](weights, count, np.random.default_rng(seed))
    assert counts.sum() == count
    assert (counts >= 0).all()
    assert not counts[weights == 0.0].any()
    assert len(indices(counts)) == count


@EVERY
@pytest.mark.parametrize(
    "weights",
    [
        np.array([1e-300, 1.0, 1e-320]),
        np.ones(10**6),
        np.array([0.0, 0.0, 5e-324]),
        np.r_[1.0, np.full(9999, 1e-17)],
        np.random.default_rng(1).random(10**5).astype(np.float32),
    ],
    ids=["tiny", "a million", "subnormal", "one huge", "float32"],
)
def test_rounding_loses_none(name, weights):
    for count in (1, 3, 1000, 10**5):
        counts = RESAMPLERS[name](weights, count, np.random.default_rng(count))
        assert counts.sum() == count
        assert not counts[weights == 0.0].any()


@given(
    weights=st.lists(st.floats(1e-6, 1.0), min_size=1, max_size=30),
    count=st.integers(1, 100),
    seed=st.integers(0, 2**32),
)
def test_systematic_counts_are_next_to_their_expectation(weights, count, seed):
    expected = count * np.array(weights) / np.sum(weights)
    counts = systematic(np.array(weights), count, np.random.default_rng(seed))
    assert (np.abs(counts - expected) < 1.0 + 1e-9).all()


@pytest.mark.parametrize("name", ["systematic", "stratified", "residual"])
@pytest.mark.parametrize("count", [3, 100, 300, 1000, 49_999])
def test_equal_weights_are_drawn_once_each(name, count):
    """However rounding leaves them, and whole multiples as often: nothing is left to chance."""
    rng = np.random.default_rng(count)
    for weights in (np.full(count, 1.0 / count), np.exp(np.full(count, -np.log(count)))):
        assert (RESAMPLERS[name](weights, count, rng) == 1).all()
        assert (RESAMPLERS[name](weights, 3 * count, rng) == 3).all()


@EVERY
def test_seeds_reproduce(name):
    weights = np.random.default_rng(0).random(100)
    one, other = (RESAMPLERS[name](weights, 50, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(one, other)


@EVERY
def test_no_more_variance_than_independent_draws(name):
    rng = np.random.default_rng(4)
    weights = np.array([0.31, 0.02, 0.45, 0.07, 0.15])
    drawn = np.array([RESAMPLERS[name](weights, 20, rng) for _ in range(20_000)])
    independent = 20 * weights * (1.0 - weights)
    assert (drawn.var(axis=0) <= 1.06 * independent).all()
