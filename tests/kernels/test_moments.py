"""Gaussians in moment form, against dense joint densities, singular ones included."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from pgm.kernels import gaussian, moments, roots
from tests.dense import (
    Joint,
    algebra,
    definite,
    linear_joint,
    matrices,
    random_covariance,
    vectors,
)

ranks = pytest.mark.parametrize("rank", [0, 1, 2, 3])
noise_ranks = pytest.mark.parametrize("noise_rank", [0, 1, 2])


def reading(rank, noise_rank, seed=0):
    """Draw a belief over three components, a sensor of two, and a reading it may give."""
    rng = np.random.default_rng(seed)
    mean, cov = rng.normal(size=3), random_covariance(rng, 3, rank)
    matrix, noise = rng.normal(size=(2, 3)), random_covariance(rng, 2, noise_rank)
    joint = linear_joint(
        [("x", {}, mean, cov), ("z", {"x": matrix}, np.zeros(2), noise)],
    )
    value = rng.multivariate_normal(*joint.marginal("z"), method="eigh")
    return mean, cov, matrix, noise, value, joint


@ranks
@noise_ranks
@pytest.mark.parametrize("seed", range(3))
def test_an_update_conditions_the_joint(rank, noise_rank, seed):
    mean, cov, matrix, noise, value, joint = reading(rank, noise_rank, seed)
    update = moments.update(mean, cov, matrix, value - matrix @ mean, noise)
    posterior, log_density = joint.given({"z": value})
    assert_allclose(update.mean, posterior.marginal("x")[0], atol=1e-6)
    assert_allclose(update.cov, posterior.marginal("x")[1], atol=1e-6)
    assert_allclose(update.cov, update.cov.T)
    if rank + noise_rank >= 2:  # the reading has a density
        assert_allclose(update.log_density, log_density, atol=1e-7)
        assert update.left is None
    else:
        assert_allclose(update.left, 0.0, atol=1e-7)


@algebra
@given(vectors(3), definite(3), matrices(2, 3), definite(2), vectors(2))
def test_an_update_is_the_kalman_filters(mean, cov, matrix, noise, value):
    update = moments.update(mean, cov, matrix, value - matrix @ mean, noise)
    S = matrix @ cov @ matrix.T + noise
    gain = cov @ matrix.T @ np.linalg.inv(S)
    assert_allclose(update.mean, mean + gain @ (value - matrix @ mean), atol=1e-7)
    assert_allclose(update.cov, cov - gain @ S @ gain.T, atol=1e-7)
    density = multivariate_normal(matrix @ mean, S).logpdf(value)
    assert_allclose(update.log_density, density, atol=1e-8)
    assert_allclose(update.lower, np.linalg.cholesky(S), atol=1e-9)


def test_an_exact_sensor_leaves_no_variance():
    cov = random_covariance(np.random.default_rng(0), 2)
    update = moments.update(
        np.zeros(2), cov, np.array([[1.0, 0.0]]), np.array([3.0]), np.zeros((1, 1))
    )
    assert_allclose(update.mean, [3.0, 3.0 * cov[0, 1] / cov[0, 0]])
    assert_allclose(update.cov[0], 0.0, atol=1e-15)
    assert_allclose(update.cov[1, 1], cov[1, 1] - cov[0, 1] ** 2 / cov[0, 0])


def test_what_is_certain_adds_nothing_to_the_density():
    # Two exact sensors of one component: the second only repeats the first.
    mean, cov = np.zeros(1), np.eye(1)
    once = moments.update(mean, cov, np.ones((1, 1)), np.ones(1), np.zeros((1, 1)))
    twice = moments.update(mean, cov, np.ones((2, 1)), np.ones(2), np.zeros((2, 2)))
    assert_allclose(twice.log_density, once.log_density)
    assert_allclose(twice.log_density, multivariate_normal(0, 1).logpdf(1.0))
    assert_allclose(twice.mean, [1.0])
    assert_allclose(twice.cov, 0.0, atol=1e-15)
    assert_allclose(twice.left, [0.0, 0.0], atol=1e-15)
    known = moments.update(mean, 0 * cov, np.ones((1, 1)), np.zeros(1), np.zeros((1, 1)))
    assert known.log_density == 0.0


@pytest.mark.parametrize("correlation", [0.0, 0.99, 0.999, 0.99999])
def test_rounding_is_never_taken_for_a_reading(correlation):
    # Three exact sensors of two components: the third is determined by the others.
    rng = np.random.default_rng(0)
    cov = np.array([[1.0, correlation], [correlation, 1.0]])
    matrix = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]) + np.zeros((300, 3, 2))
    matrix[:, 2] = rng.normal(size=(300, 2))
    x = rng.multivariate_normal(np.zeros(2), cov, size=300)
    value = np.einsum("kij,kj->ki", matrix, x)
    update = moments.update(np.zeros((300, 2)), cov, matrix, value, np.zeros((3, 3)))
    assert_allclose(update.mean, x, atol=1e-8)
    assert_allclose(update.log_density, multivariate_normal(np.zeros(2), cov).logpdf(x), rtol=1e-6)


def test_what_is_left_tells_a_contradiction():
    cov = np.diag([1.0, 0.0])
    update = moments.update(np.zeros(2), cov, np.eye(2), np.array([0.5, 0.25]), np.zeros((2, 2)))
    assert_allclose(update.left, [0.0, 0.25])
    both = moments.update(
        np.zeros(1), np.eye(1), np.ones((2, 1)), np.array([1.0, 4.0]), np.zeros((2, 2))
    )
    assert_allclose(both.left, [0.0, 3.0])
    # What contradicts is told by `left`, and the density is that of the rest.
    assert_allclose(both.log_density, multivariate_normal(0, 1).logpdf(1.0))


def test_a_huge_prior_costs_no_digits():
    # One reading of a vague belief, then the belief is the reading's.
    update = moments.update(
        np.zeros(2), 1e12 * np.eye(2), np.eye(2), np.array([3.0, -1.0]), np.diag([1e-4, 1e-2])
    )
    assert_allclose(update.mean, [3.0, -1.0], rtol=1e-9)
    assert_allclose(np.diag(update.cov), [1e-4, 1e-2], rtol=1e-6)
    assert (np.linalg.eigvalsh(update.cov) > 0).all()


def test_an_indefinite_prediction_is_nan():
    update = moments.update(np.zeros(1), np.eye(1), np.eye(1), np.ones(1), np.array([[-2.0]]))
    assert np.isnan(update.log_density)


@pytest.mark.parametrize("lead", [(3,), (40,)])
@pytest.mark.parametrize("rank", [1, 3])
@pytest.mark.parametrize("noise_rank", [0, 2])
def test_a_batch_is_its_singles(lead, rank, noise_rank):
    singles = [reading(rank, noise_rank, seed) for seed in range(lead[0])]
    mean, cov, matrix, noise, value = (
        np.stack(part) for part in list(zip(*singles, strict=True))[:5]
    )
    residual = value - np.einsum("kij,kj->ki", matrix, mean)
    batch = moments.update(mean, cov, matrix, residual, noise)
    back = moments.reverse(mean, cov, matrix, noise, *pushed(mean, cov, matrix, noise))
    for k in range(*lead):
        one = moments.update(mean[k], cov[k], matrix[k], residual[k], noise[k])
        assert_allclose(batch.mean[k], one.mean, atol=1e-8)
        assert_allclose(batch.cov[k], one.cov, atol=1e-8)
        assert_allclose(batch.log_density[k], one.log_density, rtol=1e-8)
        forward = pushed(mean[k], cov[k], matrix[k], noise[k])
        one_back = moments.reverse(mean[k], cov[k], matrix[k], noise[k], *forward)
        assert_allclose(back.cov[k], one_back.cov, atol=1e-8)


def pushed(mean, cov, matrix, noise):
    return moments.push(mean, cov, moments.Conditional(matrix, np.zeros(2), noise))


@ranks
@noise_ranks
@pytest.mark.parametrize("seed", range(3))
def test_forward_then_reverse_is_bayes_rule(rank, noise_rank, seed):
    mean, cov, matrix, noise, value, joint = reading(rank, noise_rank, seed)
    forward_mean, forward_cov = pushed(mean, cov, matrix, noise)
    assert_allclose(forward_mean, joint.marginal("z")[0], atol=1e-12)
    assert_allclose(forward_cov, joint.marginal("z")[1], atol=1e-12)
    back = moments.reverse(mean, cov, matrix, noise, forward_mean, forward_cov)
    # x given y, times y's marginal, is the joint again.
    assert_allclose(back.matrix @ forward_cov, joint.cross("x", "z"), atol=1e-6)
    again = moments.push(forward_mean, forward_cov, back)
    assert_allclose(again[0], mean, atol=1e-6)
    assert_allclose(again[1], cov, atol=1e-6)
    # And at a value that y may take, it is the conditional.
    posterior, _ = joint.given({"z": value})
    assert_allclose(back.matrix @ value + back.offset, posterior.marginal("x")[0], atol=1e-6)
    assert_allclose(back.cov, posterior.marginal("x")[1], atol=1e-6)


def test_log_density_and_divergence():
    rng = np.random.default_rng(0)
    cov, other = random_covariance(rng, 3, lead=(30,)), random_covariance(rng, 3, lead=(30,))
    offset = rng.normal(size=(30, 3))
    found = moments.log_density(offset, cov)
    divergence = moments.kl(offset, cov, other)
    for k in range(30):
        assert_allclose(found[k], multivariate_normal(np.zeros(3), cov[k]).logpdf(offset[k]))
        inverse = np.linalg.inv(other[k])
        expected = 0.5 * (
            np.trace(inverse @ cov[k])
            + offset[k] @ inverse @ offset[k]
            - 3
            + np.linalg.slogdet(other[k])[1]
            - np.linalg.slogdet(cov[k])[1]
        )
        assert_allclose(divergence[k], expected, rtol=1e-8)


@pytest.mark.parametrize("cov", [np.zeros((2, 2)), np.ones((2, 2)), np.diag([1.0, -1.0])])
def test_no_density_without_a_regular_covariance(cov):
    assert np.isnan(moments.log_density(np.zeros(2), cov))
    assert np.isnan(moments.kl(np.zeros(2), cov, np.eye(2)))
    assert np.isnan(moments.kl(np.zeros(2), np.eye(2), cov))


@pytest.mark.parametrize("parents", [slice(0, 2), np.array([3, 0])])
def test_extending_writes_the_child_into_the_joint(parents):
    # A chain x (2) -> y (1), after an unrelated w (1): the vector is (x, y, w).
    rng = np.random.default_rng(0)
    start = random_covariance(rng, 3, 2)
    mean, cov = np.zeros(4), np.zeros((4, 4))
    old = np.array([0, 1, 3])
    mean[old], cov[old[:, None], old] = rng.normal(size=3), start
    matrix, offset, noise = rng.normal(size=(1, 2)), np.ones(1), np.array([[0.3]])
    whole = np.zeros((1, 3))
    whole[:, [0, 1] if isinstance(parents, slice) else [2, 0]] = matrix
    joint = linear_joint([("xw", {}, mean[old], start), ("y", {"xw": whole}, offset, noise)])
    value = matrix @ mean[parents] + offset
    gaussian.extend(mean, cov, slice(2, 3), parents, matrix, value, noise)
    order = np.array([0, 1, 3, 2])
    assert_allclose(mean[order], joint.mean)
    assert_allclose(cov[np.ix_(order, order)], joint.cov, atol=1e-12)


@algebra
@given(st.floats(0.1, 10), st.floats(-5, 5))
def test_errors_are_in_standard_deviations(std, shift):
    mean = np.zeros((4, 2, 3))
    other = mean.copy()
    other[2, 1, 0] = shift * std
    error = moments.marginal_error(mean, other, np.full(mean.shape, std))
    assert_allclose(error, [0.0, abs(shift)], atol=1e-12)


def test_the_twin_conditions_as_it_should():
    # The tests' own joint, against the textbook's bivariate normal.
    joint = Joint(
        {"a": slice(0, 1), "b": slice(1, 2)}, np.zeros(2), np.array([[2.0, 1.0], [1.0, 4.0]])
    )
    posterior, log_density = joint.given({"b": [2.0]})
    assert_allclose(posterior.marginal("a")[0], [0.5])
    assert_allclose(posterior.marginal("a")[1], [[1.75]])
    assert_allclose(log_density, -0.5 * (np.log(2 * np.pi * 4) + 1.0))


def test_a_reverse_whose_root_is_lost_to_rounding():
    """Five components of rank two, two of them nearly one another: elimination calls it indefinite.

    y = B x without noise determines x, so that the gain inverts B and nothing is left.
    """
    lost = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        matrix = rng.normal(size=(5, 2))
        matrix[1] = matrix[0] + 1e-6 * rng.normal(size=2)
        cov, nothing = matrix @ matrix.T, np.zeros((5, 5))
        size = moments.spread(matrix, np.eye(2), nothing)
        lost += np.isnan(roots.root(cov, size, negligible=0.1 * moments.ROUNDING)).any()
        back = moments.reverse(np.zeros(2), np.eye(2), matrix, nothing, np.zeros(5), cov)
        assert_allclose(back.matrix @ matrix, np.eye(2), atol=1e-5)
        assert_allclose(back.cov, 0.0, atol=1e-10)
    assert lost > 0
