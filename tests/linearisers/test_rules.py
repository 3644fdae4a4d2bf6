"""The rules themselves: weights and moments."""

import itertools
import math

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, unscented_transform
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from tests.dense import bound_function, random_covariance

NAMES = ("east", "north", "heading", "v", "omega", "bias")
Y = pgm.Variable("y", components=("first", "second"))


def state(n):
    return pgm.Variable("x", components=NAMES[:n])


def curved(x):
    return np.stack([np.sin(x[..., 0]) * x[..., -1], np.exp(0.3 * x[..., -1])], axis=-1)


def linearise(rule, function, n, mean=None, cov=None, child=Y):
    cpd = pgm.NonlinearGaussianCPD(child, state(n), function, np.eye(child.dimension))
    at = pgm.Gaussian(
        state(n), np.zeros(n) if mean is None else mean, np.eye(n) if cov is None else cov
    )
    return rule(bound_function(cpd), at)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_the_default_weights_are_the_reports(n):
    # (4.31–4.33) with λ = n − 1, κ = 0, β = 2, so α² = (2n − 1)/n.
    s, mean_weights, cov_weights, centred = pgm.Unscented().points(n, "y", None)
    lam, alpha_square = n - 1, (2 * n - 1) / n
    assert centred
    assert_allclose(mean_weights[0], lam / (n + lam))
    assert_allclose(cov_weights[0], lam / (n + lam) + 1 - alpha_square + 2)
    for weights in (mean_weights, cov_weights):
        assert_allclose(weights[1:], 0.5 / (n + lam))
    assert (mean_weights >= 0).all()
    assert (cov_weights > 0).all()
    arm = np.sqrt(n + lam) * np.eye(n)
    assert_allclose(s, np.concatenate([np.zeros((1, n)), arm, -arm]))


@pytest.mark.parametrize(("n", "expected"), [(1, 2.0), (3, 16 / 3), (6, 67 / 6)])
def test_the_default_variance_of_a_square(n, expected):
    square = pgm.Variable("square")
    affine = linearise(pgm.Unscented(), lambda x: x[..., -1:] ** 2, n, child=square)
    assert_allclose(affine.F, 0.0, atol=1e-12)
    assert_allclose(affine.b, 1.0)
    assert_allclose(affine.cov, expected)


@pytest.mark.parametrize("beta", [0.0, 2.0])
@pytest.mark.parametrize(("alpha", "kappa"), [(1.0, 0.0), (0.5, 0.0), (0.1, 1.0), (1.3, -0.5)])
@pytest.mark.parametrize("n", [1, 3, 4])
def test_the_unscented_transform_is_filterpys(n, alpha, beta, kappa):
    rng = np.random.default_rng(n)
    mean, cov = rng.normal(size=n), random_covariance(rng, n) + 0.1 * np.eye(n)
    points = MerweScaledSigmaPoints(n, alpha=alpha, beta=beta, kappa=kappa)
    sigmas = points.sigma_points(mean, cov)
    value, spread = unscented_transform(curved(sigmas), points.Wm, points.Wc)
    affine = linearise(pgm.Unscented(alpha, beta, kappa), curved, n, mean, cov)
    assert_allclose(affine.F @ mean + affine.b, value, rtol=1e-8, atol=1e-8)
    assert_allclose(affine.F @ cov @ affine.F.T + affine.cov, spread, rtol=1e-7, atol=1e-7)
    cross = ((sigmas - mean) * points.Wc[:, None]).T @ (curved(sigmas) - value)
    assert_allclose(affine.F @ cov, cross.T, rtol=1e-7, atol=1e-7)


def test_a_tiny_alpha_keeps_its_digits():
    # Weights of a million cancel; α → 0 is a second-order expansion.
    square = pgm.Variable("square")
    affine = linearise(pgm.Unscented(alpha=1e-3), lambda x: x[..., -1:] ** 2, 3, child=square)
    assert_allclose(affine.b, 1.0, atol=1e-6)
    assert_allclose(affine.cov, 2.0, atol=1e-4)


@pytest.mark.parametrize("rule", [pgm.Unscented(0.0), pgm.Unscented(1.0, kappa=-3.0)])
def test_points_without_spread_are_refused(rule):
    with pytest.raises(pgm.LinearisationError, match="must be positive"):
        rule.points(3, "y", None)
    with pytest.raises(pgm.LinearisationError, match="must be positive"):
        pgm.Unscented(-1.0)


@pytest.mark.parametrize("n", [1, 3, 6])
def test_cubature_points(n):
    s, weights, cov_weights, centred = pgm.Cubature().points(n, "y", None)
    assert not centred
    assert s.shape == (2 * n, n)
    assert_allclose(weights, 1 / (2 * n))
    assert_allclose(cov_weights, weights)
    assert_allclose(np.linalg.norm(s, axis=-1), np.sqrt(n))
    assert_allclose(weights @ s, 0.0, atol=1e-15)
    assert_allclose(weights * s.T @ s, np.eye(n), atol=1e-12)


@pytest.mark.parametrize(
    "rule",
    [
        pgm.Unscented(),
        pgm.Unscented(alpha=0.3),
        pgm.Cubature(),
        pgm.GaussHermite(),
        pgm.MonteCarlo(50),
        pgm.QuasiMonteCarlo(50),
    ],
)
@pytest.mark.parametrize("n", [1, 2, 5])
def test_weights_add_up_to_one(rule, n):
    s, weights, cov_weights, _ = rule.points(n, "y", 3)
    assert s.shape == (weights.size, n)
    assert cov_weights.shape == weights.shape
    assert_allclose(weights.sum(), 1.0)


def exact_moment(exponents):
    """E[Π sᵢ^eᵢ] of N(0, I): (e − 1)!! for even exponents, else none."""
    return np.prod([0 if e % 2 else math.prod(range(e - 1, 0, -2)) for e in exponents])


@pytest.mark.parametrize(("order", "n"), [(2, 1), (2, 4), (3, 3), (5, 2), (7, 1)])
def test_gauss_hermite_moments(order, n):
    s, weights, cov_weights, _ = pgm.GaussHermite(order).points(n, "y", None)
    assert s.shape == (order**n, n)
    assert_array_equal(cov_weights, weights)
    assert (weights > 0).all()
    for exponents in itertools.product(range(2 * order), repeat=n):
        moment = weights @ np.prod(s ** np.array(exponents), axis=-1)
        scale = weights @ np.prod(np.abs(s) ** np.array(exponents), axis=-1)
        assert_allclose(moment, exact_moment(exponents), atol=1e-12 * scale)
    # Of degree 2p it is wrong by p!, the square of the Hermite polynomial that is zero at all p.
    assert_allclose(
        exact_moment([2 * order]) - weights @ s[:, 0] ** (2 * order), math.factorial(order)
    )


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_an_odd_gauss_hermite_rule_has_its_centre_first(order):
    rule = pgm.GaussHermite(order).points(3, "y", None)
    origins = (rule.points == 0.0).all(axis=-1)
    assert rule.centred == (order % 2 == 1)
    assert origins[0] == rule.centred
    assert origins.sum() == rule.centred


def test_gauss_hermite_in_one_dimension_is_the_unscented_rule():
    # Three points at 0 and ±√3, weights 2/3 and 1/6: λ = 2.
    hermite = pgm.GaussHermite(3).points(1, "y", None)
    unscented = pgm.Unscented(alpha=1.0, beta=0.0, kappa=2.0).points(1, "y", None)
    assert_allclose(np.sort(hermite.points, axis=0), np.sort(unscented.points, axis=0))
    assert_allclose(hermite.mean_weights, unscented.mean_weights)


@pytest.mark.parametrize("order", [1, 0, -3, 101, 2.5, "3", None])
def test_malformed_orders_are_refused(order):
    with pytest.raises(pgm.LinearisationError, match=r"GaussHermite\(order=.*from 2 to 100"):
        pgm.GaussHermite(order)


def test_a_product_of_too_many_points_is_refused():
    pgm.GaussHermite(100).points(3, "y", None)
    with pytest.raises(pgm.LinearisationError, match=r"5\^9 points.*CPD of y.*lower the order"):
        pgm.GaussHermite(5).points(9, "y", None)
    with pytest.raises(pgm.LinearisationError, match=r"100\^4 points"):
        pgm.GaussHermite(100).points(4, "y", None)


def test_rules_are_values():
    assert pgm.Unscented() == pgm.Unscented(None, 2.0, 0.0)
    assert pgm.GaussHermite() == pgm.GaussHermite(3) != pgm.GaussHermite(5)
    assert pgm.MonteCarlo(10) != pgm.MonteCarlo(10, seed=1)
    assert pgm.MonteCarlo(10) != pgm.MonteCarlo(10, antithetic=True)
    assert pgm.MonteCarlo(16) != pgm.QuasiMonteCarlo(16)
    assert len({pgm.Cubature(), pgm.Cubature(), pgm.Taylor()}) == 2
    with pytest.raises(AttributeError):
        pgm.Unscented().alpha = 1.0
    for rule in (pgm.Unscented(), pgm.Cubature(), pgm.GaussHermite()):
        with pytest.raises(ValueError, match="read-only"):
            rule.points(2, "y", None).points[0] = 1.0
