"""Weighted regression on sigma points, against numpy's least squares."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from pgm.kernels import regression
from pgm.kernels.dense import StackRoot
from pgm.kernels.regression import RangeRoot, range_inverse


def regress(s, values, mean_weights, cov_weights, root, **more):
    """The slope along the points, the value at the mean and the error's covariance."""
    root = root if isinstance(root, StackRoot) else StackRoot(root)
    found = regression.regress(root, s, values, mean_weights, cov_weights, **more)
    return found.moment.T.array, found.value.vector, found.error.array


def data(rng, lead=(), count=12):
    return rng.normal(size=(*lead, count, 3)), rng.normal(size=(*lead, count, 2))


@pytest.mark.parametrize("fresh", [False, True])
@pytest.mark.parametrize("lead", [(), (4,), (2, 3)])
def test_least_squares(lead, fresh):
    """Points shared by all rows of a stack, and points of their own."""
    rng = np.random.default_rng(0)
    s, values = data(rng, lead)
    s = s if fresh else s[(0,) * len(lead)]
    weights = rng.uniform(0.5, 1.5, 12)
    weights /= weights.sum()
    slope, centre, left = regress(s, values, weights, weights, np.eye(3))
    root = np.sqrt(weights)[:, None]
    for k in np.ndindex(lead):
        design = np.column_stack([s[k] if fresh else s, np.ones(12)])
        solution, *_ = np.linalg.lstsq(root * design, root * values[k], rcond=None)
        residual = root * (values[k] - design @ solution)
        assert_allclose(slope[k], solution[:3].T, atol=1e-10)
        assert_allclose(centre[k], solution[3], atol=1e-10)
        assert_allclose(left[k], residual.T @ residual, atol=1e-10)


@pytest.mark.parametrize("lead", [(), (4,)])
def test_known_moments(lead):
    """With mean 0 and covariance I given, the slope is the bare cross moment."""
    rng = np.random.default_rng(1)
    s, values = data(rng, lead)
    weights = np.full(12, 1 / 12)
    slope, centre, left = regress(s, values, weights, weights, np.eye(3), known=True)
    for k in np.ndindex(lead):
        dy = values[k] - values[k].mean(axis=0)
        cross = sum(np.outer(dy[i], s[k][i]) for i in range(12)) / 12
        assert_allclose(slope[k], cross, atol=1e-12)
        assert_allclose(centre[k], values[k].mean(axis=0), atol=1e-12)
        assert_allclose(left[k], np.cov(values[k].T, ddof=0) - cross @ cross.T, atol=1e-12)


def test_known_moments_that_are_the_points_own_change_nothing():
    rng = np.random.default_rng(2)
    s, values = data(rng)
    s = s - s.mean(axis=0)
    s = s @ np.linalg.inv(np.linalg.cholesky(s.T @ s / 12)).T
    weights = np.full(12, 1 / 12)
    own, given = (regress(s, values, weights, weights, np.eye(3), known=k) for k in (False, True))
    for a, b in zip(own, given, strict=True):
        assert_allclose(a, b, atol=1e-12)


@pytest.mark.parametrize("known", [False, True])
def test_components_that_the_root_does_not_use_have_no_part(known):
    rng = np.random.default_rng(3)
    s, values = data(rng)
    lower = np.array([[1.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.2, 0.0, 0.7]])
    weights = np.full(12, 1 / 12)
    root = RangeRoot(lower, np.linalg.norm(lower, axis=1))
    slope, centre, left = regress(s, values, weights, weights, root, known=known)
    used = [0, 2]
    small = regress(s[:, used], values, weights, weights, np.eye(2), known=known)
    assert_allclose(slope[:, 1], 0.0)
    assert_allclose(slope[:, used], small[0], atol=1e-12)
    assert_allclose(left, small[2], atol=1e-12)
    if known:
        assert_allclose(centre, small[1], atol=1e-12)
    found = regression.regress(root, s, values, weights, weights, known=known)
    assert_allclose(found.matrix.array @ lower, slope, atol=1e-12)


def test_range_and_null_space_do_not_depend_on_units():
    lower = np.array([[1.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.2, 0.0, 0.7]])
    units = np.array([1.0, 1e6, 1e-6])
    for scale in (np.ones(3), units):
        scaled = scale[:, None] * lower
        inverse, null = range_inverse(scaled, np.linalg.norm(scaled, axis=1))
        assert_allclose(inverse @ scaled, np.diag([1.0, 0.0, 1.0]), atol=1e-9)
        assert_allclose(null @ scaled / scale[:, None], 0.0, atol=1e-9)
        assert_allclose(np.trace(null), 1.0, atol=1e-9)
