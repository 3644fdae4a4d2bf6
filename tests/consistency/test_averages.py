"""Averages and their bands against scipy's χ², on a right model and on a wrong one."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

import pgm
from models.networks import fix, point
from pgm import consistency


@pytest.mark.parametrize("confidence", [0.9, 0.99])
def test_the_band_of_a_mean(confidence):
    low, high = consistency.mean_band(3, 200, confidence)
    total = chi2(600)
    assert_allclose([total.cdf(200 * low), total.sf(200 * high)], 0.5 * (1 - confidence), rtol=1e-9)


def test_degrees_of_freedom_that_differ_are_summed():
    squares = np.array([[1.0, np.nan, 4.0], [3.0, np.nan, np.nan], [5.0, 2.0, np.nan]])
    dof = np.array([[2, 0, 6], [2, 0, 0], [4, 2, 0]])
    found = consistency.average(squares, dof, axis=0, confidence=0.9)
    assert_allclose(found.value, [3.0, 2.0, 4.0])
    np.testing.assert_array_equal(found.dof, [8, 2, 6])
    np.testing.assert_array_equal(found.count, [3, 1, 1])
    assert_allclose(found.low, chi2([8, 2, 6]).ppf(0.05) / [3, 1, 1])
    assert_allclose(found.high, chi2([8, 2, 6]).ppf(0.95) / [3, 1, 1])
    np.testing.assert_array_equal(found.inside, [True, True, True])
    assert_allclose(found.expected, [8 / 3, 2, 6])
    each = found.per_dof()
    assert_allclose(each.value, [9 / 8, 1.0, 4 / 6])
    assert_allclose(each.high, chi2([8, 2, 6]).ppf(0.95) / [8, 2, 6])
    assert_allclose(each.expected, 1.0)
    np.testing.assert_array_equal(consistency.average(squares, 2, axis=0).dof, [6, 2, 2])
    everything = consistency.average(squares, dof)
    assert_allclose(everything.value, 3.0)
    assert_allclose([everything.low, everything.high], chi2(16).ppf([0.005, 0.995]) / 5)


def test_a_mean_of_nothing_is_nan_and_not_inside():
    found = consistency.average(np.full((3, 2), np.nan), 2, axis=0)
    assert np.isnan([found.value, found.low, found.high]).all()
    assert not found.inside.any()
    assert np.isnan(found.overall().value)


def test_overall_is_the_mean_of_all_in_the_band_of_means_that_move_as_one():
    rng = np.random.default_rng(1)
    same = np.repeat(rng.chisquare(3, size=(4000, 50, 1)), 20, axis=-1)
    bands = [consistency.average(run, 3, axis=0, confidence=0.9).overall() for run in same]
    inside = np.array([band.inside for band in bands])
    assert abs(inside.mean() - 0.9) < 4 * np.sqrt(0.09 / 4000)
    narrow = [consistency.average(run, 3, confidence=0.9).inside for run in same[:200]]
    assert np.mean(narrow) < 0.5
    squares = np.array([[1.0, np.nan], [2.0, 9.0]])
    assert_allclose(consistency.average(squares, 2, axis=0).overall().value, 4.0)


@pytest.mark.parametrize("kind", ["filter", "smoother"])
def test_a_right_model_is_in_the_bands(right, truth, kind):
    belief = right.filtered[point] if kind == "filter" else right[point]
    found = consistency.anees(belief, truth, confidence=1 - 1e-3 / 41)
    assert found.value.shape == (41,)
    np.testing.assert_array_equal(found.count, 300)
    assert found.inside.all()
    assert consistency.anees(belief, truth, confidence=0.999).overall().inside
    # A right model leaves a narrow band now and then.
    assert 0.6 < consistency.anees(belief, truth, confidence=0.8).inside.mean() < 0.97


def test_innovations_of_a_right_model_are_in_the_bands_even_all_together(right):
    innovations = right.innovations[fix]
    assert consistency.nis(innovations) is innovations.nis
    found = consistency.anis(innovations, confidence=1 - 1e-3 / 40)
    assert not found.inside[0]  # nothing was read at step 0
    assert found.inside[1:].all()
    every = consistency.average(innovations.nis, innovations.dof, confidence=0.999)
    assert every.inside
    assert every.count == 300 * 40
    assert every.high - every.low < 0.15


def test_a_wrong_model_is_detected(wrong, truth):
    assert (
        consistency.anees(wrong[point], truth, confidence=0.999).value[1:]
        > chi2(600).ppf(0.9995) / 300
    ).all()
    assert not consistency.anees(wrong[point], truth).overall().inside
    assert not consistency.anis(wrong.innovations[fix]).overall().inside


def test_a_belief_without_steps_has_one_average():
    x = pgm.Variable("x", components=("a", "b"))
    draws = np.random.default_rng(0).normal(size=(500, 2))
    found = consistency.anees(pgm.Gaussian(x, draws, np.eye(2)), np.zeros(2), confidence=0.999)
    assert found.count == 500
    assert found.inside
    one = consistency.anees(pgm.Gaussian(x, draws, np.eye(2)), np.zeros(2), ("b",))
    assert_allclose(one.value, np.mean(draws[:, 1] ** 2))
    assert one.dof == 500


def test_refusals():
    with pytest.raises(pgm.ModelError, match="degrees of freedom"):
        consistency.average(np.zeros((3, 2)), np.zeros(3))
    with pytest.raises(pgm.ModelError, match="between 0 and 1"):
        consistency.average([1.0], 1, confidence=1.0)
    with pytest.raises(pgm.ModelError, match="between 0 and 1"):
        consistency.mean_band(1, 1, 95)
    with pytest.raises(pgm.ModelError, match="one confidence, not 2"):
        consistency.mean_band(1, 1, [0.9, 0.99])
    for dof in (0, -3, 2.5, True, "2", np.nan):
        with pytest.raises(pgm.ModelError, match=r"degrees of freedom of each = .* whole number"):
            consistency.mean_band(dof, 3)
        with pytest.raises(pgm.ModelError, match=r"how many are averaged = .* whole number"):
            consistency.mean_band(3, dof)
    for none in (0, -2, np.nan, np.inf, [1, 0]):
        with pytest.raises(pgm.ModelError, match="degrees of freedom above 0"):
            consistency.average([1.0, 2.0], none)
    with pytest.raises(pgm.ModelError, match="normalised errors must be numbers"):
        consistency.average("much", 1)
    with pytest.raises(pgm.ModelError, match=r"posterior.innovations\[z\]"):
        consistency.anis(np.zeros(3))
