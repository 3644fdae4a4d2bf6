"""Numerical Jacobians, against exact derivatives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from pgm.kernels import differences
from tests.dense import algebra, matrices, vectors

PLAIN = np.array([False, False])


def smooth(x):
    return np.stack(
        [np.sin(x[..., 0]) * np.exp(0.5 * x[..., 1]), x[..., 0] ** 3 / (1 + x[..., 1] ** 2)],
        axis=-1,
    )


def smooth_by_x(x):
    a, b = x[..., 0], x[..., 1]
    rows = [
        [np.cos(a) * np.exp(0.5 * b), 0.5 * np.sin(a) * np.exp(0.5 * b)],
        [3 * a**2 / (1 + b**2), -2 * b * a**3 / (1 + b**2) ** 2],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


@pytest.mark.parametrize("std", [0.0, 1e-6, 0.3])
@pytest.mark.parametrize("lead", [(), (7,), (2, 5)])
def test_smooth_functions(lead, std):
    x = np.random.default_rng(0).normal(size=(*lead, 2))
    found = differences.jacobian(smooth, x, np.full(x.shape, std), PLAIN)
    assert found.shape == (*lead, 2, 2)
    assert_allclose(found, smooth_by_x(x), atol=1e-8)


@algebra
@given(matrices(2, 3), vectors(2), vectors(3), st.floats(0, 10))
def test_affine_functions_are_exact(matrix, offset, x, std):
    found = differences.jacobian(
        lambda p: p @ matrix.T + offset, x, np.full(3, std), np.array([False, False])
    )
    assert_allclose(found, matrix, atol=1e-9)


def test_quartics_are_exact():
    # A fourth-order rule has no error on them, however long its steps.
    x = np.array([1.5])
    found = differences.jacobian(lambda p: p**4 - p**3, x, np.array([100.0]), np.array([False]))
    assert_allclose(found, [[4 * 1.5**3 - 3 * 1.5**2]], rtol=1e-10)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e6])
def test_large_coordinates(scale):
    x = scale * np.array([3.0, -4.0])
    found = differences.jacobian(
        lambda p: np.hypot(p[..., 0], p[..., 1])[..., None], x, np.zeros(2), np.array([False])
    )
    # Below, the step of 1e-4 is long; above, the values' own rounding shows.
    assert_allclose(found, [[0.6, -0.8]], atol={1e-3: 1e-5, 1.0: 1e-8, 1e6: 1e-6}[scale])


@pytest.mark.parametrize("offset", [-1e-5, 0.0, 1e-5, 1e-3])
def test_angles_across_the_cut(offset):
    def bearing(x):
        return np.arctan2(x[..., 1], x[..., 0])[..., None]

    x = np.array([-2.0, offset])
    square = x @ x
    found = differences.jacobian(bearing, x, np.full(2, 0.1), np.array([True]))
    assert_allclose(found, [[-x[1] / square, x[0] / square]], atol=1e-8)


def test_one_call():
    calls = []

    def record(x):
        calls.append(x.shape)
        return x[..., :1]

    differences.jacobian(record, np.zeros((5, 3)), np.zeros((5, 3)), np.array([False]))
    assert calls == [(5, 12, 3)]
