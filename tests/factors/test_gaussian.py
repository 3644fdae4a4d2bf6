"""Gaussians in moment form, against scipy, quadrature and geometry."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

import pgm
from pgm import Gaussian
from tests.dense import algebra, definite, random_covariance, vectors

A = pgm.Variable("a")
B = pgm.Variable("b", components=("east", "north"))
X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
COV = np.array([[4.0, 1.5, -0.3], [1.5, 2.0, 0.2], [-0.3, 0.2, 0.5]])


@algebra
@given(vectors(3), vectors(3), definite(3), definite(3))
def test_divergence_is_the_closed_form(mean, other, cov, other_cov):
    scope = (A, B)
    found = Gaussian(scope, mean, cov).kl(Gaussian(scope, other, other_cov))
    inverse = np.linalg.inv(other_cov)
    shift = other - mean
    expected = 0.5 * (
        np.linalg.slogdet(other_cov)[1]
        - np.linalg.slogdet(cov)[1]
        - 3
        + np.trace(inverse @ cov)
        + shift @ inverse @ shift
    )
    assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    assert found >= -1e-12


def test_divergence_is_the_integral():
    p, q = Gaussian(A, 0.3, 0.8), Gaussian(A, -0.5, 2.0)

    def integrand(x):
        log_p, log_q = norm(0.3, np.sqrt(0.8)).logpdf(x), norm(-0.5, np.sqrt(2.0)).logpdf(x)
        return np.exp(log_p) * (log_p - log_q)

    assert_allclose(p.kl(q), quad(integrand, -15, 15)[0], rtol=1e-9)


def test_divergence_is_the_mean_of_log_ratios():
    p = Gaussian(B, [1.0, -1.0], [[1.0, 0.6], [0.6, 2.0]])
    q = Gaussian(B, [0.0, 0.5], [[2.0, -0.3], [-0.3, 1.0]])
    x = np.random.default_rng(0).multivariate_normal(p.mean, p.cov, size=100_000)
    ratio = multivariate_normal(p.mean, p.cov).logpdf(x) - multivariate_normal(
        q.mean, q.cov
    ).logpdf(x)
    assert abs(p.kl(q) - ratio.mean()) < 5 * ratio.std() / np.sqrt(x.shape[0])


def test_divergence_wraps_angles_and_nothing_else():
    here = Gaussian(X, [0.0, 7.0, 3.1], COV)
    there = Gaussian(X, [0.0, 7.0, -3.1], COV)
    near = Gaussian(X, [0.0, 7.0, 3.1 + (2 * np.pi - 6.2)], COV)
    assert_allclose(here.kl(there), here.kl(near), rtol=1e-9)
    assert_allclose(here.kl(Gaussian(X, [0, 7, 3.1 + 6 * np.pi], COV)), 0.0, atol=1e-12)
    east = Gaussian(X, [2 * np.pi, 7.0, 3.1], COV)
    assert_allclose(here.kl(east), 0.5 * (2 * np.pi) ** 2 * np.linalg.inv(COV)[0, 0], rtol=1e-9)


@algebra
@given(vectors(3), definite(3), vectors(3))
def test_log_density_is_that_of_scipy(mean, cov, x):
    found = Gaussian((A, B), mean, cov).log_density(x)
    assert_allclose(found, multivariate_normal(mean, cov).logpdf(x), rtol=1e-9, atol=1e-9)


def test_log_density_wraps_angles():
    belief = Gaussian(X, [1.0, 2.0, 3.0], COV)
    x = np.array([[0.0, 2.5, 3.3], [0.0, 2.5, 3.3 - 2 * np.pi], [0.0, 2.5, 3.3 + 8 * np.pi]])
    expected = multivariate_normal(belief.mean, COV).logpdf(x[0])
    assert_allclose(belief.log_density(x), np.full(3, expected), rtol=1e-9)


def test_log_density_and_divergence_of_batches():
    rng = np.random.default_rng(0)
    mean, cov = rng.normal(size=(5, 1, 2)), random_covariance(rng, 2, lead=(4,)) + np.eye(2)
    batch, other = Gaussian(B, mean, cov), Gaussian(B, [0.0, 1.0], np.eye(2))
    assert batch.mean.shape == (5, 4, 2)
    x = rng.normal(size=2)
    for i, j in np.ndindex(5, 4):
        single = Gaussian(B, mean[i, 0], cov[j])
        assert_allclose(batch.log_density(x)[i, j], single.log_density(x))
        assert_allclose(batch.kl(other)[i, j], single.kl(other))
        assert_allclose(other.kl(batch)[i, j], other.kl(single))


@pytest.mark.parametrize("cov", [np.zeros((2, 2)), np.ones((2, 2))])
def test_singular_covariances_have_no_density_or_divergence(cov):
    flat, round_ = Gaussian(B, [0, 0], cov), Gaussian(B, [0, 0], np.eye(2))
    for ask in (lambda: flat.log_density([0, 0]), lambda: flat.kl(round_), lambda: round_.kl(flat)):
        with pytest.raises(pgm.NumericalError, match="singular"):
            ask()


@algebra
@given(st.floats(-100, 100))
def test_wrapping_turns_angles_alone(heading):
    belief = Gaussian(X, [50.0, -50.0, heading], COV)
    wrapped = belief.wrapped()
    assert_allclose(wrapped.mean[:2], belief.mean[:2])
    assert_allclose(np.exp(1j * wrapped.mean[2]), np.exp(1j * heading), atol=1e-12)
    assert -np.pi <= wrapped.mean[2] < np.pi
    assert_allclose(wrapped.cov, COV)
    assert belief.mean[2] == heading


def test_marginals_are_blocks_in_the_order_asked_for():
    mean, cov = np.arange(4.0), random_covariance(np.random.default_rng(0), 4, lead=(6,))
    joint = Gaussian((A, B, pgm.Variable("c")), mean, cov, steps=range(6))
    marginal = joint.marginal(pgm.Variable("c"), A)
    assert marginal.scope == (pgm.Variable("c"), A)
    assert_allclose(marginal.mean, np.broadcast_to([3.0, 0.0], (6, 2)))
    assert_allclose(marginal.cov, cov[:, [[3], [0]], [3, 0]])
    np.testing.assert_array_equal(marginal.steps, range(6))
    with pytest.raises(pgm.ModelError, match="not in the scope"):
        joint.marginal(X)


def test_a_marginal_has_each_variable_once():
    with pytest.raises(pgm.ModelError, match="twice"):
        Gaussian((A, B), np.zeros(3), np.eye(3)).marginal(A, A)


def test_standard_deviations_and_angles():
    belief = Gaussian((A, X), np.zeros(4), np.diag([4.0, 0.0, 1.0, 9.0]))
    assert_allclose(belief.std, [2.0, 0.0, 1.0, 3.0])
    np.testing.assert_array_equal(belief.angles, [False, False, False, True])


def test_python_numbers_are_scalars():
    belief = Gaussian(A, 2, 4)
    assert belief.mean.shape == (1,)
    assert belief.cov.shape == (1, 1)


@pytest.mark.parametrize(
    ("mean", "cov", "words"),
    [
        ([0.0], np.eye(2), "shape"),
        ([0.0, 0.0, 0.0], np.eye(2), "shape"),
        ([0.0, 0.0], np.eye(3), "shape"),
        ([0.0, 0.0], [1.0, 1.0, 1.0], "shape"),
        ([0.0, np.nan], np.eye(2), "mean has entries that are NaN"),
        ([0.0, 0.0], [[1.0, 0.0], [0.0, np.inf]], "NaN or infinite"),
        ([0.0, 0.0], [[1.0, 0.1], [0.0, 1.0]], "not symmetric"),
        ([0.0, 0.0], [[1.0, 2.0], [2.0, 1.0]], "negative"),
        ([0.0, 0.0], [[1.0, 0.0], [0.0, -1e-3]], "negative"),
    ],
)
def test_malformed_gaussians_are_refused(mean, cov, words):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        Gaussian(B, mean, cov)
    assert "(b)" in str(caught.value)


@pytest.mark.parametrize(
    "cov",
    [
        np.diag([1e6, -1e-5]),  # metres of a map and radians of a gyroscope
        [[1e6, 2.0], [2.0, 1e-6]],  # a correlation of 2
        [1e12 * np.eye(2), -np.eye(2)],  # one run of two
    ],
)
def test_the_units_of_one_component_do_not_excuse_another(cov):
    with pytest.raises(pgm.ModelError, match="negative"):
        Gaussian(B, [0.0, 0.0], cov)


def test_leading_axes_must_broadcast():
    with pytest.raises(pgm.ModelError):
        Gaussian(A, np.zeros((2, 1)), np.ones((3, 1, 1)))


def test_scopes_must_fit():
    with pytest.raises(pgm.ModelError, match="twice"):
        Gaussian((A, A), np.zeros(2), np.eye(2))
    with pytest.raises(pgm.ModelError, match="variables"):
        Gaussian("a", np.zeros(1), np.eye(1))
    with pytest.raises(pgm.ModelError, match="one scope"):
        Gaussian(A, 0, 1).kl(Gaussian(pgm.Variable("c"), 0, 1))


@pytest.mark.parametrize("x", [[1.0], [1.0, 2.0, 3.0]])
def test_values_must_have_the_scopes_components(x):
    with pytest.raises(pgm.ModelError):
        Gaussian(B, [0, 0], np.eye(2)).log_density(x)


def test_a_gaussian_is_immutable_and_keeps_no_one_elses_arrays():
    mean, cov, steps = np.zeros((2, 1)), np.ones((2, 1, 1)), np.arange(2)
    belief = Gaussian(A, mean, cov, steps=steps)
    mean[0], cov[0], steps[0] = 7.0, 7.0, 7
    assert belief.mean[0] == 0.0
    assert belief.cov[0] == 1.0
    with pytest.raises(AttributeError, match="immutable"):
        belief.mean = mean
    for part in (belief.mean, belief.cov, belief.wrapped().mean, belief.marginal(A).cov):
        with pytest.raises(ValueError, match="read-only"):
            part[...] = 1.0


def test_steps_are_immutable_too():
    steps = np.arange(2)
    belief = Gaussian(A, np.zeros((2, 1)), 1.0, steps=steps)
    steps[0] = 7
    np.testing.assert_array_equal(belief.steps, [0, 1])
    with pytest.raises(ValueError, match="read-only"):
        belief.steps[0] = 7


def test_repr_tells_scope_and_batch():
    assert repr(Gaussian((A, B), np.zeros(3), np.eye(3))).splitlines()[0] == "Gaussian(a, b)"
    assert "(4,)" in repr(Gaussian(A, np.zeros((4, 1)), 1.0))
