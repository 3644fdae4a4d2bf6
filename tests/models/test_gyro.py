"""Arcs from an odometer and a gyro, with and without a bias, against mpmath and themselves."""

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from models import motion

number = st.floats(-3.0, 3.0)
triples = st.tuples(number, number, number).map(np.array)


def textbook(x, u, b):
    """The exact integral of a constant speed and turn rate, which divides by the turn."""
    turn = u[1] - b[0] * u[2]
    east = (mpmath.sin(x[2] + turn) - mpmath.sin(x[2])) * u[0] / turn
    north = (mpmath.cos(x[2]) - mpmath.cos(x[2] + turn)) * u[0] / turn
    return [x[0] + east, x[1] + north, x[2] + turn]


@pytest.mark.parametrize("turn", [0.8, -2.5, 1e-5])
def test_values_and_derivatives_are_the_textbooks(turn):
    x, u, b = np.array([1.0, -2.0, 0.7]), np.array([1.5, turn, 0.4]), np.array([0.05])
    u[1] += b[0] * u[2]
    flat = [*x, *u, *b]
    with mpmath.workdps(40):
        each = [lambda *v, k=k: textbook(v[:3], v[3:6], v[6:])[k] for k in range(3)]
        value = [float(f(*flat)) for f in each]
        orders = [tuple(order) for order in np.eye(7, dtype=int)]
        jacobian = np.array([[mpmath.diff(f, flat, o) for o in orders] for f in each], dtype=float)
    assert_allclose(motion.drifting(x, u, b), value, atol=1e-13)
    assert_allclose(motion.drifting_by_state(x, u, b), jacobian[:, :3], atol=1e-13)
    assert_allclose(motion.drifting_by_control(x, u, b), jacobian[:, 3:6], atol=1e-13)
    assert_allclose(motion.drifting_by_bias(x, u, b), jacobian[:, 6:], atol=1e-13)


@given(triples, triples, st.floats(0.0, 1.0))
def test_parts_of_an_arc_are_the_whole(x, u, share):
    parts = motion.arc(motion.arc(x, share * u), (1.0 - share) * u)
    assert_allclose(parts, motion.arc(x, u), atol=1e-13)


@given(triples, triples, st.floats(0.1, 3.0))
def test_arcs_are_driven_at_a_velocity(x, u, dt):
    driven = motion.velocity(x, np.array([u[0] / dt, u[1] / dt, dt]))
    assert_allclose(motion.arc(x, u), driven, atol=1e-12)
    assert_array_equal(motion.drifting(x, u, np.zeros(1)), motion.arc(x, u))


def test_a_batch_is_its_single_runs():
    rng = np.random.default_rng(3)
    x, u, b = rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 1))
    for function in (
        motion.drifting,
        motion.drifting_by_state,
        motion.drifting_by_control,
        motion.drifting_by_bias,
    ):
        batch = function(x, u, b)
        for i in np.ndindex(4, 5):
            assert_allclose(batch[i], function(x[i], u[i], b[i]), rtol=1e-12, atol=1e-15)
        shared = np.broadcast_to(u[0, 0], u.shape)
        assert_array_equal(function(x, shared, b), function(x, shared.copy(), b))
