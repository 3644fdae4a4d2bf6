"""Entropies, divergences and mutual information, against scipy's and sums by hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import pgm

RAIN, WET, DAY = pgm.Discrete("rain", 2), pgm.Discrete("wet", 3), pgm.Discrete("day", 2)
A, B = pgm.variables("a b", ("p", "q"))


@pytest.mark.parametrize("seed", range(5))
def test_tables(seed):
    rng = np.random.default_rng(seed)
    values = rng.exponential(size=(2, 3, 2)) * (rng.random((2, 3, 2)) > 0.2)
    table = pgm.Table((RAIN, WET, DAY), values, -700.0)
    p = values / values.sum()
    assert_allclose(table.entropy(), stats.entropy(p.ravel()), rtol=1e-13)
    q = rng.exponential(size=(3, 2, 2))
    other = pgm.Table((WET, DAY, RAIN), q)
    due = stats.entropy(p.ravel(), q.transpose(2, 0, 1).ravel())
    assert_allclose(table.kl(other), due, rtol=1e-13)
    told = table.marginal(RAIN).entropy() + table.marginal(WET, DAY).entropy() - table.entropy()
    assert_allclose(table.mutual_information(RAIN), told, atol=1e-14)
    assert_allclose(table.mutual_information(DAY, WET), told, atol=1e-14)


def test_stacks_zeros_and_independence():
    table = pgm.Table(RAIN, [[0.5, 0.5], [1.0, 0.0]], lead=2)
    assert_allclose(table.entropy(), [np.log(2.0), 0.0])
    assert pgm.Table(RAIN, [0.5, 0.5]).kl(pgm.Table(RAIN, [1.0, 0.0])) == np.inf
    assert pgm.Table(RAIN, [1.0, 0.0]).kl(pgm.Table(RAIN, [0.5, 0.5])) == pytest.approx(np.log(2))
    apart = pgm.Table(RAIN, [0.3, 0.7]) * pgm.Table(DAY, [0.1, 0.9])
    assert abs(apart.mutual_information(DAY)) < 1e-15


def test_small_entries_and_nearly_independent_parts():
    """References in 60 digits; what is told is never negative, and never beyond ln(size)."""
    for values, due in (
        ([[1.0, 0.0], [0.0, 1e-200]], 4.605e-198),
        ([[1.0, 1e-160], [0.0, 1e-170]], 3.674e-168),
        ([[1.0, 1e-250], [1e-250, 1e-240]], 5.526e-238),
        ([[0.25, 0.25 + 1e-9], [0.25 - 1e-9, 0.25]], 2.8e-34),
    ):
        found = pgm.Table((RAIN, DAY), values).mutual_information(RAIN)
        assert 0.0 <= found < max(10.0 * due, 1e-25)
    rng = np.random.default_rng(0)
    for _ in range(100):
        apart = np.outer(rng.random(2), rng.random(2))
        assert 0.0 <= pgm.Table((RAIN, DAY), apart).mutual_information(RAIN) < 1e-30
    faint = pgm.Table(RAIN, [1e100, 1e-300])
    assert pgm.Table(RAIN, [0.5, 0.5]).kl(faint) == pytest.approx(-np.log(2.0) + 200 * np.log(10))
    stacked = pgm.Table((RAIN, DAY), np.ones((3, 2, 2)), lead=3)
    assert stacked.mutual_information(DAY).shape == (3,)


def test_entries_further_apart_than_numbers():
    """Marginals of 1e-500 beside one, and a probability of e^-1435 where the other has none."""
    table = pgm.Table((RAIN, DAY), [[1e300, 1e-300], [1e-300, 1e-200]])
    assert table.mutual_information(RAIN) == 0.0
    least = pgm.Table(RAIN, [1e300, 5e-324])
    assert least.kl(pgm.Table(RAIN, [1.0, 0.0])) == np.inf
    assert least.kl(pgm.Table(RAIN, [1.0, 1.0])) == pytest.approx(np.log(2.0))


def test_tables_over_nothing():
    assert pgm.Table((), 2.0).kl(pgm.Table((), 3.0)) == pgm.Table((), 2.0).entropy() == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_gaussians(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 4))
    cov = root @ root.T
    both = pgm.Gaussian((A, B), np.zeros(4), cov)
    assert_allclose(both.entropy(), stats.multivariate_normal(cov=cov).entropy(), rtol=1e-10)
    told = both.marginal(A).entropy() + both.marginal(B).entropy() - both.entropy()
    assert_allclose(both.mutual_information(A), told, rtol=1e-8)
    assert_allclose(both.mutual_information(B), told, rtol=1e-8)


def test_faint_and_certain_relations():
    """Nothing is subtracted: half of ρ² is what a faint correlation tells."""
    a, b = pgm.variables("u v")
    rho = 1e-7
    faint = pgm.Gaussian((a, b), [0.0, 0.0], [[1.0, rho], [rho, 1.0]])
    assert faint.mutual_information(a) == pytest.approx(0.5 * rho**2, rel=1e-9)
    certain = pgm.Gaussian((a, b), [0.0, 0.0], [[1e12, 1e6], [1e6, 1.0]])
    assert certain.mutual_information(b) == np.inf
    # A component that says nothing new takes nothing away.
    cov = np.array([[1.0, 1.0, 0.6], [1.0, 1.0, 0.6], [0.6, 0.6, 1.0]])
    pair = pgm.Variable("pair", ("p", "q"))
    found = pgm.Gaussian((pair, a), np.zeros(3), cov).mutual_information(a)
    assert found == pytest.approx(-0.5 * np.log(1.0 - 0.36))


def test_what_is_refused():
    a, b = pgm.variables("u v")
    both = pgm.Gaussian((a, b), [0.0, 0.0], np.eye(2))
    table = pgm.Table((RAIN, WET), np.ones((2, 3)))
    for wrong in ((), (a, b)):
        with pytest.raises(pgm.ModelError, match="of some variables of the scope"):
            both.mutual_information(*wrong)
    with pytest.raises(pgm.ModelError, match="day is not in the scope"):
        table.mutual_information(DAY)
    with pytest.raises(pgm.ModelError, match="KL compares tables of the same variables"):
        table.kl(pgm.Table(RAIN, [1.0, 1.0]))
    with pytest.raises(pgm.ModelError, match="do not broadcast"):
        pgm.Table(RAIN, np.ones((3, 2)), lead=3).kl(pgm.Table(RAIN, np.ones((2, 2)), lead=2))
    with pytest.raises(pgm.ModelError, match="leading axes"):
        pgm.Gaussian(a, np.zeros((3, 1)), 1.0).kl(pgm.Gaussian(a, np.zeros((2, 1)), 1.0))
    with pytest.raises(pgm.NumericalError, match="no entropy, since a covariance is singular"):
        pgm.Gaussian(a, 0.0, 0.0).entropy()
    with pytest.raises(pgm.NumericalError):
        pgm.Table(RAIN, [0.0, 0.0]).entropy()
