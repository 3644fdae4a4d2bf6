"""The rules themselves: weights, moments, and what random rules draw."""

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


def linearise(rule, function, n, mean=None, cov=None, child=Y, step=None):
    cpd = pgm.NonlinearGaussianCPD(child, state(n), function, np.eye(child.dimension))
    at = pgm.Gaussian(
        state(n), np.zeros(n) if mean is None else mean, np.eye(n) if cov is None else cov
    )
    return rule(bound_function(cpd, step=step), at)


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
    "rule", [pgm.Unscented(), pgm.Unscented(alpha=0.3), pgm.Cubature(), pgm.MonteCarlo(50)]
)
@pytest.mark.parametrize("n", [1, 2, 5])
def test_weights_add_up_to_one(rule, n):
    s, weights, cov_weights, _ = rule.points(n, "y", 3)
    assert s.shape == (weights.size, n)
    assert cov_weights.shape == weights.shape
    assert_allclose(weights.sum(), 1.0)


def test_monte_carlo_points_are_standard_normal():
    s = pgm.MonteCarlo(20_000).points(3, "y", 0).points
    assert (np.abs(s.mean(axis=0)) < 5 / np.sqrt(20_000)).all()
    assert (np.abs(np.cov(s.T) - np.eye(3)) < 5 * np.sqrt(2 / 20_000)).all()
    assert (np.abs((s**4).mean(axis=0) - 3) < 5 * np.sqrt(96 / 20_000)).all()


def test_monte_carlo_points_are_keyed_by_seed_cpd_and_step():
    draw = pgm.MonteCarlo(10, seed=1).points(3, "y", 4).points
    assert_array_equal(draw, pgm.MonteCarlo(10, seed=1).points(3, "y", 4).points)
    for rule, name, step in [
        (pgm.MonteCarlo(10, seed=2), "y", 4),
        (pgm.MonteCarlo(10, seed=1), "z", 4),
        (pgm.MonteCarlo(10, seed=1), "y", 5),
        (pgm.MonteCarlo(10, seed=1), "y", 3),
    ]:
        other = rule.points(3, name, step).points
        # Not one number in common, so no stretch of the stream is used twice.
        assert not np.isin(other, draw).any()


@pytest.mark.parametrize("samples", [10, 11, 13])
@pytest.mark.parametrize(
    "steps", [np.arange(7), np.array([5, 5, 2, 9]), np.array([[0, 1], [1, 0]]), np.array([3])]
)
def test_one_call_for_many_steps_is_many_calls(steps, samples):
    rule = pgm.MonteCarlo(samples, seed=3)
    together = rule.points(3, "y", steps).points
    assert together.shape == (*steps.shape, samples, 3)
    for k in np.ndindex(steps.shape):
        assert_array_equal(together[k], rule.points(3, "y", int(steps[k])).points)


def test_many_steps_are_linearised_in_one_call():
    rng = np.random.default_rng(0)
    steps = np.array([[4, 4], [0, 0], [7, 7]])  # sightings by runs
    mean, cov = rng.normal(size=(3, 2, 3)), random_covariance(rng, 3, lead=(3, 2))
    rule = pgm.MonteCarlo(20, seed=3)
    cpd = pgm.NonlinearGaussianCPD(Y, state(3), curved, np.eye(2))
    batch = rule(bound_function(cpd, lead=2, step=steps), pgm.Gaussian(state(3), mean, cov))
    for k in np.ndindex(3, 2):
        single = linearise(rule, curved, 3, mean[k], cov[k], step=int(steps[k]))
        assert_allclose(batch.F[k], single.F, atol=1e-9)
        assert_allclose(batch.b[k], single.b, atol=1e-9)
        assert_allclose(batch.cov[k], single.cov, atol=1e-9)


@pytest.mark.parametrize(("n", "enough"), [(1, 4), (3, 8)])
def test_too_few_samples_are_refused(n, enough):
    linearise(pgm.MonteCarlo(enough), curved, n)
    with pytest.raises(pgm.LinearisationError, match=f"ask for {enough}") as caught:
        linearise(pgm.MonteCarlo(enough - 1), curved, n)
    assert "y" in str(caught.value)


@pytest.mark.parametrize("arguments", [(0,), (-5,), (10, -1)])
def test_malformed_monte_carlo_is_refused(arguments):
    with pytest.raises(pgm.LinearisationError, match="MonteCarlo"):
        pgm.MonteCarlo(*arguments)


def test_rules_are_values():
    assert pgm.Unscented() == pgm.Unscented(None, 2.0, 0.0)
    assert pgm.MonteCarlo(10) != pgm.MonteCarlo(10, seed=1)
    assert len({pgm.Cubature(), pgm.Cubature(), pgm.Taylor()}) == 2
    with pytest.raises(AttributeError):
        pgm.Unscented().alpha = 1.0
    for rule in (pgm.Unscented(), pgm.Cubature()):
        with pytest.raises(ValueError, match="read-only"):
            rule.points(2, "y", None).points[0] = 1.0
