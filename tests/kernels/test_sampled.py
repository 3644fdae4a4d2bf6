"""Errors of moments and divergences from groups of draws: against textbook twins and simulation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from pgm.kernels import sampled

Q = np.array([[1.5, 0.3], [0.3, 0.8]])
MU = np.array([0.4, -0.2])


def moments(mass, first, second):
    total = mass.sum(axis=0)
    mean = first.sum(axis=0) / total
    return mean, second.sum(axis=0) / total - np.outer(mean, mean)


def divergence(mean, cov):
    """KL(N(mean, cov) ‖ N(MU, Q)) as a book has it."""
    inverse = np.linalg.inv(Q)
    off = mean - MU
    ratio = np.linalg.slogdet(Q)[1] - np.linalg.slogdet(cov)[1]
    return 0.5 * (ratio - 2 + np.trace(inverse @ cov) + off @ inverse @ off)


def groups(rng, count, draws, shift=0.0):
    """Sums of weighted standard normal draws in groups."""
    x = rng.normal(size=(count, draws, 2)) + shift
    weights = rng.uniform(0.5, 1.5, size=(count, draws))
    first = (weights[..., None] * x).sum(axis=1)
    return weights.sum(axis=1), first, np.einsum("cs,csi,csj->cij", weights, x, x)


def terms(each):
    mean, cov = moments(*each)
    found = sampled.spread(*each, mean, cov)
    return mean, cov, found, sampled.terms(mean - MU, cov, Q, found)


def test_terms_are_the_derivatives_by_the_groups_weights():
    """The first and second changes of the divergence, as a group's draws count a little more."""
    each = groups(np.random.default_rng(0), 5, 400)
    mean, cov, found, tells = terms(each)
    assert_allclose(found.mean.sum(axis=0), 0.0, atol=1e-12)
    assert_allclose(found.cov.sum(axis=0), 0.0, atol=1e-12)
    for c in range(5):
        more = np.ones(5)
        more[c] += 1e-6
        up = moments(*(part * more.reshape(-1, *[1] * (part.ndim - 1)) for part in each))
        assert_allclose((up[0] - mean) / 1e-6, found.mean[c], atol=1e-6)
        assert_allclose((up[1] - cov) / 1e-6, found.cov[c], atol=1e-6)
        slope = (divergence(*up) - divergence(mean, cov)) / 1e-6
        assert slope == pytest.approx(tells.first[c] / np.sqrt(5 / 4), rel=2e-3)
    # The quadratic form of the second derivatives, along two groups' changes.
    h = 1e-4
    for c, d in ((0, 0), (1, 3)):
        value = 0.0
        for i, j, sign in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
            at = mean + h * (i * found.mean[c] + j * found.mean[d])
            value += sign * divergence(at, cov + h * (i * found.cov[c] + j * found.cov[d]))
        assert value / (4 * h * h) == pytest.approx(tells.second[c, d] / (5 / 4), rel=0.01)


@pytest.mark.parametrize("right", [False, True])
def test_bias_and_variance_are_those_of_repeated_samples(right):
    """Of 2,000 samples: also where q is right, so that no first-order error is left."""
    rng = np.random.default_rng(1)
    global_q, mu = (np.eye(2), np.zeros(2)) if right else (Q, MU)
    true = 0.5 * (
        np.linalg.slogdet(global_q)[1]
        - 2
        + np.trace(np.linalg.inv(global_q))
        + mu @ np.linalg.inv(global_q) @ mu
    )
    values, biases, variances = [], [], []
    for _ in range(2000):
        each = groups(rng, 12, 20)
        mean, cov = moments(*each)
        found = sampled.spread(*each, mean, cov)
        tells = sampled.terms(mean - mu, cov, global_q, found)
        inverse, off = np.linalg.inv(global_q), mean - mu
        values.append(
            0.5
            * (
                np.linalg.slogdet(global_q)[1]
                - np.linalg.slogdet(cov)[1]
                - 2
                + np.trace(inverse @ cov)
                + off @ inverse @ off
            )
        )
        biases.append(float(tells.bias))
        variances.append(float(tells.variance))
    assert np.mean(biases) == pytest.approx(np.mean(values) - true, rel=0.15, abs=2e-4)
    # Where no first-order error is left it is somewhat large, but never too small.
    ratio = np.mean(variances) / np.var(values)
    assert 0.95 < ratio < 1.8 if right else 0.85 < ratio < 1.15


def test_worth_is_the_number_of_draws():
    rng = np.random.default_rng(2)
    found = [
        sampled.worth(sampled.spread(*each, mean, cov), cov)
        for each in (groups(rng, 40, 25) for _ in range(60))
        for mean, cov in [moments(*each)]
    ]
    weight = 1000.0 / (1.0 + 1.0 / 12.0)  # of weights uniform on ½ to 1½
    assert np.mean(found) == pytest.approx(weight, rel=0.08)
    same = [np.repeat(part[:1], 4, axis=0) for part in groups(rng, 1, 50)]
    mean, cov = moments(*same)
    assert sampled.worth(sampled.spread(*same, mean, cov), cov) > 1e20
