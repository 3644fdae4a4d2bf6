"""Kernels that go along rows of runs: equal to those that go matrix by matrix, layout kept."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from pgm.kernels import arrays, moments, roots, solving
from pgm.kernels.arrays import by_runs, stacked, transpose
from tests.dense import random_covariance

RUNS = pytest.mark.parametrize("runs", [1, 31, 32])


def by_run(array):
    """The same numbers, laid out by runs."""
    out = stacked(array.shape[:1], array.shape[1:])
    out[...] = array
    return out


def problem(runs, size, height, seed=0):
    """Beliefs, a linear reading of each, and its noise, in the usual order in memory."""
    rng = np.random.default_rng(seed)
    cov = np.stack([random_covariance(rng, size) for _ in range(runs)])
    noise = np.stack([random_covariance(rng, height) for _ in range(runs)])
    matrix = rng.normal(size=(runs, height, size))
    return rng.normal(size=(runs, size)), cov, matrix, rng.normal(size=(runs, height)), noise


def conditioned(mean, cov, matrix, residual, noise):
    """The textbook's Kalman update of one run, with inverses."""
    predictive = matrix @ cov @ matrix.T + noise
    gain = cov @ matrix.T @ np.linalg.inv(predictive)
    sign, log_det = np.linalg.slogdet(2.0 * np.pi * predictive)
    assert sign == 1.0
    log_density = -0.5 * (residual @ np.linalg.inv(predictive) @ residual + log_det)
    return mean + gain @ residual, cov - gain @ matrix @ cov, log_density


@RUNS
@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize(("size", "height"), [(1, 1), (3, 1), (3, 2), (2, 3), (4, 4)])
def test_an_update_of_many_runs_is_that_of_each(runs, size, height, shared):
    mean, cov, matrix, residual, noise = problem(runs, size, height)
    if shared:
        noise = np.broadcast_to(noise[0], noise.shape)
        mean, matrix = (np.broadcast_to(part[0], part.shape) for part in (mean, matrix))
    parts = [part if shared else by_run(part) for part in (mean, cov, matrix, residual)]
    parts[1] = by_run(cov)
    found = moments.update(*parts, noise if shared else by_run(noise), exact=False)
    for k in range(runs):
        due = conditioned(mean[k], cov[k], matrix[k], residual[k], noise[k])
        for one, expected in zip(found, due, strict=False):
            assert_allclose(one[k], expected, rtol=1e-8, atol=1e-10)
    assert_allclose(found.lower @ transpose(found.lower), matrix @ cov @ transpose(matrix) + noise)
    assert_array_equal(found.lower, np.tril(found.lower))
    assert found.left is None


@pytest.mark.parametrize(("size", "height"), [(1, 1), (3, 1), (3, 3)])
def test_one_belief_may_stand_for_all_runs(size, height):
    mean, cov, matrix, residual, noise = problem(40, size, height)
    mean, cov = (np.broadcast_to(part[0], part.shape) for part in (mean, cov))
    seen = by_run(matrix), by_run(residual), by_run(noise)
    updated = moments.update(mean, cov, *seen, exact=False)
    for k in range(40):
        due = conditioned(mean[k], cov[k], matrix[k], residual[k], noise[k])
        for one, expected in zip(updated, due, strict=False):
            assert_allclose(one[k], expected, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("lead", [(40,), (5, 40)])
def test_products_keep_the_layout(lead):
    rng = np.random.default_rng(1)
    a, b = stacked(lead, (2, 3)), stacked(lead, (3, 3))
    a[...], b[...] = rng.normal(size=a.shape), rng.normal(size=b.shape)
    b += transpose(b).copy()
    one = np.broadcast_to(rng.normal(size=(3, 3)), b.shape)
    for found, due in [
        (arrays.multiply(a, b), a @ b),
        (arrays.multiply(a, one), a @ one),
        (arrays.multiply(one, b), one @ b),
        (arrays.multiply(one[(0,) * len(lead)], b), one @ b),
        (arrays.times_transposed(a, b), a @ transpose(b)),
        (arrays.times_transposed(a, one), a @ transpose(one)),
        (arrays.times_transposed(one, b), one @ transpose(b)),
        (arrays.times_symmetric(a, b), a @ b),
        (arrays.sandwich(a, b), a @ b @ transpose(a)),
        (arrays.make_symmetric(arrays.sandwich(a, b)), a @ b @ transpose(a)),
    ]:
        assert by_runs(found)
        assert_allclose(found, due, atol=1e-12)


@RUNS
def test_roots_and_solves_keep_the_layout(runs):
    _, cov, _, _, _ = problem(runs, 3, 1)
    right = by_run(np.random.default_rng(2).normal(size=(runs, 3, 2)))
    lower = roots.root(by_run(cov))
    assert_allclose(lower, np.linalg.cholesky(cov), atol=1e-12)
    solved = [solving.solve_lower(lower, right), solving.solve_upper(lower, right)]
    assert_allclose(lower @ solved[0], right, atol=1e-9)
    assert_allclose(transpose(lower) @ solved[1], right, atol=1e-9)
    if runs >= 32:
        assert all(by_runs(each) for each in (lower, *solved))


def test_one_indefinite_matrix_among_many():
    _, cov, _, _, _ = problem(50, 3, 1)
    cov[3] = np.diag([1.0, -1.0, 1.0])
    cov[4] = np.diag([1.0, 0.0, 1.0])
    lower = roots.root(by_run(cov))
    assert np.isnan(lower[3]).all()
    assert_array_equal(roots.determined(lower[4]), [False, True, False])
    assert_allclose(lower[5:], np.linalg.cholesky(cov[5:]), atol=1e-12)


@pytest.mark.parametrize("runs", [1, 50])
def test_the_plain_order_in_memory_is_no_layout_by_runs(runs):
    assert not by_runs(np.zeros((runs, 3, 3)))
    assert not by_runs(np.broadcast_to(np.eye(3), (runs, 3, 3)))
    assert by_runs(stacked((runs,), (3, 3))) == (runs >= 32)
