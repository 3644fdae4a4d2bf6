"""Mixtures merged into fewer Gaussians, against sums member by member."""

import numpy as np
import pytest

from pgm.kernels import merging
from tests.dense import random_covariance

NONE = np.zeros(0, dtype=int)


def drawn(members=4, batch=(3,), size=2, seed=0):
    """Log-weights, means and covariances, components first."""
    rng = np.random.default_rng(seed)
    cov = random_covariance(rng, size, lead=(members, *batch))
    return (
        rng.normal(size=(members, *batch)),
        rng.normal(size=(size, members, *batch)),
        np.moveaxis(cov, (-2, -1), (0, 1)),
    )


def due(logs, mean, cov):
    """The log-weight, mean and covariance of a mixture of members (members,)."""
    weights = np.exp(logs)
    shares = weights / weights.sum()
    centre = sum(w * m for w, m in zip(shares, mean.T, strict=True))
    whole = sum(
        w * (cov[..., k] + np.outer(mean[:, k] - centre, mean[:, k] - centre))
        for k, w in enumerate(shares)
    )
    return np.log(weights.sum()), centre, whole


@pytest.mark.parametrize("members", [1, 4])
def test_all_members_are_merged_into_one(members):
    logs, mean, cov = drawn(members)
    logs[1:, 1] = -np.inf  # members of which one is left
    found = merging.merged(logs, None, 1, mean, cov, NONE)
    for run in range(3):
        own = due(logs[:, run], mean[..., run], cov[..., run])
        parts = found.logs[0, run], found.mean[:, 0, run], found.cov[:, :, 0, run]
        for part, each in zip(parts, own, strict=True):
            np.testing.assert_allclose(part, each, atol=1e-13)


def test_members_that_all_of_a_batch_have():
    """Moments with a batch of length one, under weights that differ in it."""
    logs, _, _ = drawn(4, (3, 2))
    _, mean, cov = drawn(4, (1, 2), seed=1)
    found = merging.merged(logs, None, 1, mean, cov, NONE)
    assert found.mean.shape == (2, 1, 3, 2)
    for place in np.ndindex(3, 2):
        run = place[1]
        _, centre, whole = due(logs[(..., *place)], mean[..., 0, run], cov[..., 0, run])
        np.testing.assert_allclose(found.mean[:, 0][(..., *place)], centre, atol=1e-13)
        np.testing.assert_allclose(found.cov[:, :, 0][(..., *place)], whole, atol=1e-13)


@pytest.mark.parametrize("owner", [None, np.array([0, 0, 1, 1])])
def test_a_dead_component_has_the_mean_of_the_likeliest_of_all(owner):
    logs, mean, cov = drawn(4, ())
    logs[2:] = -np.inf
    if owner is None:
        logs[:] = -np.inf
    count = 1 if owner is None else 2
    found = merging.merged(logs, owner, count, mean, cov, NONE)
    best = logs.argmax(axis=0)
    assert found.logs[-1] == -np.inf
    np.testing.assert_array_equal(found.mean[:, -1], mean[:, best])
    assert np.linalg.eigvalsh(found.cov[..., -1] - cov[..., best]).min() > -1e-13


def test_angles_of_one_component_are_on_the_branch_of_its_likeliest_member():
    logs = np.log([[0.4], [0.6]])
    mean, cov = np.array([[[np.pi - 0.1], [0.1 - np.pi]]]), np.ones((1, 1, 2, 1))
    found = merging.merged(logs, None, 1, mean, cov, np.array([0]))
    np.testing.assert_allclose(found.members[0, :, 0], [-np.pi - 0.1, 0.1 - np.pi])
    np.testing.assert_allclose(found.mean[0, 0, 0], 0.4 * (-np.pi - 0.1) + 0.6 * (0.1 - np.pi))


def test_one_member_that_all_of_a_batch_have_is_the_component_of_each():
    logs, _, _ = drawn(1, (3, 2))
    _, mean, cov = drawn(1, (1, 2), seed=1)
    found = merging.merged(logs, None, 1, mean, cov, NONE)
    np.testing.assert_allclose(found.mean, np.broadcast_to(mean, (2, 1, 3, 2)))
    np.testing.assert_allclose(found.cov, np.broadcast_to(cov, (2, 2, 1, 3, 2)))


@pytest.mark.parametrize("owner", [None, np.array([0, 1, 1, 0, 1])])
def test_merged_covariances_are_symmetric_to_the_last_bit(owner):
    """However they lie in memory: predictions rely on it."""
    logs, mean, cov = drawn(5, (), 6)
    cov = 0.5 * (cov + cov.swapaxes(0, 1))
    orders = np.moveaxis(np.ascontiguousarray(np.moveaxis(cov, -1, 0)), 0, -1)
    for each in (cov.copy(), orders, np.asfortranarray(cov)):
        found = merging.merged(logs, owner, 1 if owner is None else 2, mean, each, NONE)
        np.testing.assert_array_equal(found.cov, found.cov.swapaxes(0, 1))
