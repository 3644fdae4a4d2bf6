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
    assert_allclose(found.gaussian().cov, found.cov)
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
    with pytest.raises(pgm.ModelError, match="leading axes"):
        mixture((3,))[0, 1]
    with pytest.raises(pgm.ModelError):
        mixture((3,))["a"]
    assert_allclose(mixture((3, 2))[..., 0].mean, mixture((3, 2)).mean[:, 0])


@pytest.mark.parametrize("seed", range(5))
def test_modes_are_where_a_fine_grid_has_them(seed):
    rng = np.random.default_rng(seed)
    x = pgm.Variable("x")
    parts = pgm.Gaussian(x, rng.uniform(0, 10, (4, 1)), rng.uniform(0.1, 2.0, (4, 1, 1)))
    found = pgm.GaussianMixture(rng.dirichlet(np.ones(4)), parts)
    at = np.linspace(-3, 13, 160001)
    density = found.log_density(at[:, None])
    inner = (density[1:-1] > density[:-2]) & (density[1:-1] > density[2:])
    due = at[1:-1][inner]
    assert_allclose(np.sort(found.modes()[:, 0]), due, atol=2e-4)
    assert (np.diff(found.log_density(found.modes())) <= 0.0).all()


def test_modes_that_are_one_are_told_once():
    close = pgm.Gaussian(X, [[0.0, 0.0], [0.5, 0.0], [9.0, 0.0]], np.eye(2))
    found = pgm.GaussianMixture([0.3, 0.3, 0.4], close).modes()
    assert_allclose(found, [[0.25, 0.0], [9.0, 0.0]], atol=1e-6)
    none = pgm.GaussianMixture([0.5, 0.5, 0.0], close).modes()
    assert_allclose(none, [[0.25, 0.0]], atol=1e-6)
    with pytest.raises(pgm.ModelError, match="axes of runs"):
        mixture((2,)).modes()
    with pytest.raises(pgm.NumericalError, match="singular"):
        pgm.GaussianMixture([0.5, 0.5], pgm.Gaussian(X, np.zeros((2, 2)), 0.0)).modes()
