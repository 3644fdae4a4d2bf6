"""Errors and normalised errors against direct computation and scipy's χ²."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

import pgm
from pgm import consistency

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
rng = np.random.default_rng(0)
ROOTS = rng.normal(size=(4, 5, 3, 3))
COVS = ROOTS @ ROOTS.swapaxes(-1, -2) + 0.1 * np.eye(3)
BELIEF = pgm.Gaussian(x, rng.normal(size=(4, 5, 3)), COVS)


def test_errors_of_angles_are_wrapped():
    belief = pgm.Gaussian(x, [0.0, 0.0, 3.1], np.eye(3))
    assert_allclose(consistency.error(belief, [1.0, -1.0, -3.1]), [-1.0, 1.0, 6.2 - 2 * np.pi])


def test_nees_is_the_mahalanobis_distance():
    truth = BELIEF.mean + rng.normal(size=BELIEF.mean.shape)
    difference = BELIEF.mean - truth
    due = np.einsum("...i,...ij,...j->...", difference, np.linalg.inv(COVS), difference)
    assert_allclose(consistency.nees(BELIEF, truth), due, rtol=1e-9)


def test_rmse_of_some_components():
    truth = BELIEF.mean + np.array([3.0, 4.0, 0.5])
    assert_allclose(consistency.rmse(BELIEF, truth, ("east", "north")), 5.0)
    assert_allclose(consistency.rmse(BELIEF, truth, ("heading",)), 0.5)


@pytest.mark.parametrize("confidence", [0.9, 0.99])
def test_the_band_of_a_mean(confidence):
    low, high = consistency.mean_band(3, 200, confidence)
    total = chi2(600)
    assert_allclose([total.cdf(200 * low), total.sf(200 * high)], 0.5 * (1 - confidence), rtol=1e-9)


def test_refusals():
    with pytest.raises(pgm.ModelError, match=r"shape \(2,\)"):
        consistency.error(BELIEF, [0.0, 0.0])
    with pytest.raises(pgm.ModelError, match="up"):
        consistency.rmse(BELIEF, BELIEF.mean, ("up",))
    with pytest.raises(pgm.NumericalError, match="singular"):
        consistency.nees(pgm.Gaussian(x, np.zeros(3), np.diag([1.0, 0.0, 1.0])), np.zeros(3))
