"""Mixtures of Gaussians."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import pgm

X = pgm.Variable("x", components=("a", "b"))


def mixture(lead=()):
    rng = np.random.default_rng(0)
    root = rng.normal(size=(*lead, 3, 2, 2))
    weights = rng.dirichlet(np.ones(3), size=lead)
    parts = pgm.Gaussian(X, rng.normal(size=(*lead, 3, 2)), root @ root.swapaxes(-1, -2))
    return pgm.GaussianMixture(weights, parts)


def test_density_and_moments():
    found, points = mixture(), np.random.default_rng(1).normal(size=(7, 2))
    parts = zip(found.weights, found.components.mean, found.components.cov, strict=True)
    due = sum(w * stats.multivariate_normal(m, c).pdf(points) for w, m, c in parts)
    assert_allclose(found.log_density(points), np.log(due))
    drawn = found.sample(200000, rng=2)
    assert_allclose(drawn.mean(axis=0), found.mean, atol=0.02)
    assert_allclose(np.cov(drawn.T), found.cov, rtol=0.03, atol=0.02)
    assert_allclose(found.gaussian.cov, found.cov)
    assert_allclose(found.std**2, np.diagonal(found.cov))


def test_runs():
    found = mixture((4, 5))
    assert found.lead == (4, 5)
    assert found.mean.shape == (4, 5, 2)
    one = found[2, 3]
    assert_allclose(found.mean[2, 3], one.mean)
    assert_allclose(found.cov[2, 3], one.cov)
    assert_allclose(found.log_density([0.3, 0.1])[2, 3], one.log_density([0.3, 0.1]))
    drawn = found.sample(20000, rng=0)
    assert drawn.shape == (20000, 4, 5, 2)
    assert_allclose(drawn.mean(axis=0), found.mean, atol=0.1)
    assert found[1:3].lead == (2, 5)


def test_angles_are_on_the_branch_of_the_likeliest():
    bearing = pgm.Variable("bearing", components=("t",), angles=("t",))
    found = pgm.GaussianMixture([0.4, 0.6], pgm.Gaussian(bearing, [[3.1], [-3.1]], [[0.01]]))
    assert_allclose(found.mean, -0.6 * 3.1 + 0.4 * (3.1 - 2 * np.pi))
    assert found.std < 0.2


def test_shows_its_likeliest_first():
    text = str(mixture())
    assert text.startswith("GaussianMixture(x: 3 Gaussians)")
    assert "all" in text
    alone = pgm.Gaussian(X, [1.0, 2.0], np.eye(2))
    stacked = pgm.Gaussian(X, [[1.0, 2.0]], np.eye(2))
    assert str(pgm.GaussianMixture([1.0], stacked)) == str(alone)


@pytest.mark.parametrize(
    ("weights", "parts", "words"),
    [
        ([0.5, 0.5], pgm.Gaussian(X, [0.0, 0.0], np.eye(2)), "do not fit"),
        ([0.5, 0.6], pgm.Gaussian(X, np.zeros((2, 2)), np.eye(2)), "sum is one"),
        ([-0.5, 1.5], pgm.Gaussian(X, np.zeros((2, 2)), np.eye(2)), "not negative"),
        ([0.5, 0.5], "parts", "components"),
    ],
)
def test_what_does_not_fit_is_refused(weights, parts, words):
    with pytest.raises(pgm.ModelError, match=words):
        pgm.GaussianMixture(weights, parts)


def test_one_run_too_many_is_refused():
    with pytest.raises(pgm.ModelError, match="axes of runs"):
        mixture((3,))[0, 1]
