"""Wrapping, and choosing branches."""

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from pgm.kernels import angles
from tests.dense import algebra

radians = st.floats(-1e3, 1e3)
BOTH = np.array([False, True])


@algebra
@given(radians)
@example(np.pi)
@example(-np.pi)
@example(np.nextafter(-np.pi, -4.0))
@example(3 * np.pi)
def test_wrapping_gives_the_equal_angle_from_minus_pi_to_below_pi(angle):
    wrapped = angles.wrap(np.array(angle))
    assert -np.pi <= wrapped < np.pi
    assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-12)


def test_what_is_no_number_stays_none():
    with np.errstate(invalid="ignore"):
        assert np.isnan(angles.wrap(np.array([np.nan, np.inf]))).all()


@algebra
@given(radians, radians)
def test_only_angles_are_wrapped(a, b):
    found = angles.difference(np.array([a, a]), np.array([b, b]), BOTH)
    assert found[0] == a - b
    assert abs(found[1]) <= np.pi
    assert_allclose(np.exp(1j * found[1]), np.exp(1j * (a - b)), atol=1e-12)


@given(st.lists(st.booleans(), min_size=1, max_size=9))
@example([False, True, False] * 3)
def test_angles_are_wrapped_wherever_they_stand(marked):
    off = np.linspace(-20.0, 20.0, 2 * len(marked)).reshape(2, -1)
    due = np.where(marked, angles.wrap(off), off)
    assert_array_equal(angles.difference(off, np.zeros(len(marked)), np.array(marked)), due)


@algebra
@given(radians, radians)
def test_the_nearest_branch(value, reference):
    found = angles.nearest_branch(np.full(2, value), np.full(2, reference), BOTH)
    assert found[0] == value
    assert abs(found[1] - reference) <= np.pi + 1e-9
    turns = (found[1] - value) / (2 * np.pi)
    assert_allclose(turns, np.round(turns), atol=1e-9)


def test_branches_of_batches_and_no_change_of_arguments():
    value = np.array([1.0, 3.0])
    reference = np.array([[0.0, -3.0], [0.0, 3.0], [0.0, 9.0]])
    found = angles.nearest_branch(value, reference, BOTH)
    assert_allclose(found, [[1.0, 3.0 - 2 * np.pi], [1.0, 3.0], [1.0, 3.0 + 2 * np.pi]])
    assert_array_equal(value, [1.0, 3.0])
    a = np.array([5.0, 5.0])
    angles.difference(a, np.zeros(2), BOTH)
    assert_array_equal(a, [5.0, 5.0])
