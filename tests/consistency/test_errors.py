"""Errors and normalised errors against direct computation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm import consistency

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
rng = np.random.default_rng(0)
ROOTS = rng.normal(size=(4, 5, 3, 3))
COVS = ROOTS @ ROOTS.swapaxes(-1, -2) + 0.1 * np.eye(3)
BELIEF = pgm.Gaussian(x, rng.normal(size=(4, 5, 3)), COVS, steps=np.arange(5))


def test_errors_of_angles_are_wrapped():
    belief = pgm.Gaussian(x, [0.0, 0.0, 3.1], np.eye(3))
    assert_allclose(consistency.error(belief, [1.0, -1.0, -3.1]), [-1.0, 1.0, 6.2 - 2 * np.pi])


def test_nees_is_the_mahalanobis_distance():
    truth = BELIEF.mean + rng.normal(size=BELIEF.mean.shape)
    difference = BELIEF.mean - truth
    due = np.einsum("...i,...ij,...j->...", difference, np.linalg.inv(COVS), difference)
    assert_allclose(consistency.nees(BELIEF, truth), due, rtol=1e-9)


def test_nees_of_components_is_that_of_their_marginal_in_any_order():
    truth = BELIEF.mean + rng.normal(size=BELIEF.mean.shape)
    difference = (BELIEF.mean - truth)[..., [2, 0]]
    inverse = np.linalg.inv(COVS[..., [[2], [0]], [2, 0]])
    due = np.einsum("...i,...ij,...j->...", difference, inverse, difference)
    assert_allclose(consistency.nees(BELIEF, truth, ("heading", "east")), due, rtol=1e-9)


def test_whole_turns_change_no_statistic():
    truth = BELIEF.mean + rng.uniform(-1.0, 1.0, size=BELIEF.mean.shape)
    turned = truth + 2.0 * np.pi * np.array([0, 0, 1]) * rng.integers(-3, 4, size=(4, 5, 1))
    assert np.abs(turned - truth).max() > 6.0
    for statistic in (
        consistency.nees,
        consistency.rmse,
        lambda *given: consistency.rmse_over_time(*given).high,
        lambda *given: consistency.anees(*given).value,
        lambda *given: consistency.coverage(*given, [0.2, 0.5, 0.9]).actual,
    ):
        assert_allclose(statistic(BELIEF, turned), statistic(BELIEF, truth), rtol=1e-9)


def test_rmse_of_some_components():
    truth = BELIEF.mean + np.array([3.0, 4.0, 0.5])
    assert_allclose(consistency.rmse(BELIEF, truth, ("east", "north")), 5.0)
    assert_allclose(consistency.rmse(BELIEF, truth, ("heading",)), 0.5)


def test_rmse_over_time_and_its_percentiles():
    runs, steps = 101, 3
    sizes = np.arange(runs)[:, None] * np.array([1.0, 2.0, 0.5])
    mean = np.zeros((runs, steps, 3))
    belief = pgm.Gaussian(x, mean, np.eye(3), steps=np.arange(1, 4))
    truth = mean.copy()
    truth[..., 0], truth[..., 1] = 0.6 * sizes, -0.8 * sizes
    found = consistency.rmse_over_time(belief, truth, ("east", "north"), percentiles=(10, 80))
    np.testing.assert_array_equal(found.steps, [1, 2, 3])
    assert found.runs == runs
    assert_allclose(found.low, [10.0, 20.0, 5.0])
    assert_allclose(found.median, [50.0, 100.0, 25.0])
    assert_allclose(found.high, [80.0, 160.0, 40.0])
    # Σ k² for k = 0 … 100 is 338350.
    assert_allclose(found.rms, np.sqrt(338350 / 101) * np.array([1.0, 2.0, 0.5]))
    total = consistency.rmse(belief, truth, ("east", "north"))
    assert_allclose(np.sqrt(np.mean(found.rms**2)), total)


def test_kl_of_one_dimension_and_across_the_turn():
    a, b = (pgm.Variable(name, components=("t",), angles=("t",)) for name in "ab")
    p, q = pgm.Gaussian(a, [3.1], [[0.04]]), pgm.Gaussian(a, [-3.1], [[0.09]])
    offset = 6.2 - 2 * np.pi
    due = np.log(0.3 / 0.2) + (0.04 + offset**2) / (2 * 0.09) - 0.5
    assert_allclose(consistency.kl(p, q), due, rtol=1e-12)
    with pytest.raises(pgm.ModelError, match="scope"):
        consistency.kl(p, pgm.Gaussian(b, [0.0], [[1.0]]))


def test_refusals():
    with pytest.raises(pgm.ModelError, match=r"shape \(2,\)"):
        consistency.error(BELIEF, [0.0, 0.0])
    with pytest.raises(pgm.ModelError, match="leading axes"):
        consistency.error(BELIEF, np.zeros((3, 3)))
    with pytest.raises(pgm.ModelError, match="up"):
        consistency.rmse(BELIEF, BELIEF.mean, ("up",))
    with pytest.raises(pgm.ModelError, match="tuple of names"):
        consistency.nees(BELIEF, BELIEF.mean, "east")
    with pytest.raises(pgm.NumericalError, match="singular"):
        consistency.nees(pgm.Gaussian(x, np.zeros(3), np.diag([1.0, 0.0, 1.0])), np.zeros(3))
    with pytest.raises(pgm.ModelError, match="percentiles"):
        consistency.rmse_over_time(BELIEF, BELIEF.mean, percentiles=(95, 5))
    with pytest.raises(pgm.ModelError, match="over time"):
        consistency.rmse_over_time(pgm.Gaussian(x, np.zeros(3), np.eye(3)), np.zeros(3))


def test_a_singular_component_does_not_spoil_the_others():
    belief = pgm.Gaussian(x, np.zeros(3), np.diag([1.0, 0.0, 4.0]))
    assert_allclose(consistency.nees(belief, [1.0, 0.0, 1.0], ("east", "heading")), 1.25)
