"""The kernels of one Gaussian are those of many."""

import numpy as np
import pytest

from pgm.kernels import differences, moments, roots, single


def covariance(rng, size, scale=1.0):
    factor = rng.normal(size=(size, size)) * scale
    return factor @ factor.T + 0.1 * np.eye(size)


@pytest.mark.parametrize("size", [1, 2, 3, 7])
@pytest.mark.parametrize("height", [1, 2, 5])
def test_update_and_predict(size, height):
    rng = np.random.default_rng(size * 10 + height)
    mean, cov = rng.normal(size=size), covariance(rng, size)
    matrix, offset = rng.normal(size=(height, size)), rng.normal(size=height)
    residual, noise = rng.normal(size=height), covariance(rng, height)
    due = moments.update(mean[None], cov[None], matrix[None], residual[None], noise[None])
    found = single.update(mean, cov, matrix, residual, noise)
    assert found is not None
    for one, other in zip(found, (due.mean[0], due.cov[0], due.log_density[0]), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-12)
    assert (found[1] == found[1].T).all()
    _, spread = moments.push(mean, cov, moments.Conditional(matrix, offset, noise))
    np.testing.assert_allclose(single.predict(cov, matrix, noise), spread, rtol=1e-12, atol=1e-13)


def test_extend():
    rng = np.random.default_rng(2)
    places = np.array([0, 2])
    matrix, offset, noise = rng.normal(size=(2, 2)), rng.normal(size=2), covariance(rng, 2)
    mean, cov = np.zeros(5), np.zeros((5, 5))
    mean[:3], cov[:3, :3] = rng.normal(size=3), covariance(rng, 3)
    due_mean, due_cov = mean.copy(), cov.copy()
    moments.extend(due_mean, due_cov, slice(3, 5), places, matrix, offset, noise)
    value = matrix @ mean[places] + offset
    single.extend(mean, cov, slice(3, 5), places, matrix, value, noise)
    np.testing.assert_allclose(mean, due_mean, rtol=1e-12)
    np.testing.assert_allclose(cov, due_cov, rtol=1e-12, atol=1e-13)


def test_a_root_and_its_quotient():
    rng = np.random.default_rng(3)
    cov, slope = covariance(rng, 4), rng.normal(size=(2, 4))
    lower = single.root(cov)
    np.testing.assert_allclose(lower, roots.root(cov), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(single.divide(slope.T, lower) @ lower, slope, rtol=1e-10)


@pytest.mark.parametrize(
    "cov",
    [
        np.zeros((2, 2)),
        np.ones((2, 2)),
        np.diag([1.0, -1.0]),
        np.full((2, 2), np.nan),
        np.diag([1.0, np.nan]),
    ],
)
def test_what_is_special_is_left_to_others(cov):
    with np.errstate(invalid="ignore"):
        assert single.root(cov) is None
        nothing = np.zeros((2, 2))
        assert single.update(np.zeros(2), cov, np.eye(2), np.zeros(2), nothing) is None


def test_differences():
    def function(v):
        return np.stack([v[..., 0] * v[..., 1], np.arctan2(v[..., 1], -v[..., 0])], axis=-1)

    rng = np.random.default_rng(4)
    x = np.array([2.0, 1e-5])  # the angle jumps between the points
    cov = covariance(rng, 2, 0.3)
    angles = np.array([False, True])
    due = differences.jacobian(function, x, np.sqrt(np.diag(cov)), angles)
    points, steps = single.difference_points(x, cov)
    found = single.differences(function(points), steps, [1])
    np.testing.assert_allclose(found, due, rtol=1e-12, atol=1e-13)
