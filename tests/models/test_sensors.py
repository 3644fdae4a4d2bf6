"""Sensor models against complex numbers, differences and geometry."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from models import sensors

OF_STATE = {
    "pose": (sensors.pose, sensors.pose_by_state),
    "position": (sensors.position, sensors.position_by_state),
    "heading": (sensors.heading, sensors.heading_by_state),
}
OF_LANDMARK = {
    "range_only": (
        sensors.range_only,
        sensors.range_only_by_state,
        sensors.range_only_by_landmark,
    ),
    "bearing_only": (
        sensors.bearing_only,
        sensors.bearing_only_by_state,
        sensors.bearing_only_by_landmark,
    ),
    "range_bearing": (
        sensors.range_bearing,
        sensors.range_bearing_by_state,
        sensors.range_bearing_by_landmark,
    ),
}
coordinate = st.floats(-100.0, 100.0)
states = st.tuples(coordinate, coordinate, st.floats(-20.0, 20.0)).map(np.array)
landmarks = st.tuples(coordinate, coordinate).map(np.array)


def arguments(seed=0, runs=(4, 25)):
    """Draw states, and landmarks 1 to 6 m away in all directions."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(*runs, 3)) * [3.0, 3.0, 6.0]
    offset = rng.uniform(1.0, 6.0, runs) * np.exp(1j * rng.uniform(-np.pi, np.pi, runs))
    return x, x[..., :2] + np.stack([offset.real, offset.imag], axis=-1)


def central_jacobian(function, at, step=1e-2):
    """Differentiate by the sixth-order central difference, across the seam of the bearing."""
    centre = function(at)

    def about_centre(moved):
        change = function(moved) - centre
        change[..., -1] = np.angle(np.exp(1j * change[..., -1]))  # of a range, never near π
        return change

    columns = []
    for move in np.eye(at.shape[-1]) * step:
        difference = [about_centre(at + k * move) - about_centre(at - k * move) for k in (1, 2, 3)]
        columns.append((45 * difference[0] - 9 * difference[1] + difference[2]) / (60 * step))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("name", OF_STATE)
def test_jacobians_without_a_landmark(name):
    function, by_state = OF_STATE[name]
    x, _ = arguments()
    rows = function(x).shape[-1]
    assert_array_equal(function(x), x[..., 2:] if name == "heading" else x[..., :rows])
    jacobian = by_state(x)
    assert jacobian.shape == (4, 25, rows, 3)
    assert_array_equal(np.einsum("...ij,...j", jacobian, x), function(x))
    assert_array_equal(by_state(x[0, 0]), jacobian[0, 0])


@pytest.mark.parametrize("name", OF_LANDMARK)
def test_jacobians_are_the_derivatives(name):
    function, by_state, by_landmark = OF_LANDMARK[name]
    x, m = arguments()
    assert_allclose(by_state(x, m), central_jacobian(lambda s: function(s, m), x), atol=1e-9)
    assert_allclose(by_landmark(x, m), central_jacobian(lambda p: function(x, p), m), atol=1e-9)


@pytest.mark.parametrize("name", OF_LANDMARK)
def test_a_batch_is_its_single_runs(name):
    x, m = arguments(seed=1)
    for function in OF_LANDMARK[name]:
        batch = function(x, m)
        assert batch.dtype == np.float64
        for i in np.ndindex(4, 25):
            assert_allclose(batch[i], function(x[i], m[i]), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", OF_LANDMARK)
def test_results_are_in_memory_as_states_are(name):
    """States whose runs are contiguous give readings and Jacobians whose runs are."""
    x, m = arguments(runs=(40,))
    apart = x.copy(order="F")
    for function in OF_LANDMARK[name]:
        assert function(apart, m).strides[0] == 8
        assert_array_equal(function(apart, m), function(x, m))


@pytest.mark.parametrize("name", OF_LANDMARK)
def test_no_sightings_give_no_readings(name):
    x, m = arguments(runs=(0,))
    rows = 2 if name == "range_bearing" else 1
    shapes = [function(x, m).shape for function in OF_LANDMARK[name]]
    assert shapes == [(0, rows), (0, rows, 3), (0, rows, 2)]


@given(states, landmarks)
def test_range_and_bearing_lead_back_to_the_landmark(x, m):
    distance, bearing = sensors.range_bearing(x, m)
    reached = complex(x[0], x[1]) + distance * np.exp(1j * (x[2] + bearing))
    assert_allclose([reached.real, reached.imag], m, atol=1e-11)
    assert_array_equal(sensors.range_only(x, m), [distance])
    assert_array_equal(sensors.bearing_only(x, m), [bearing])


@given(states, landmarks, st.integers(-1000, 1000))
def test_whole_turns_of_the_robot_are_not_seen(x, m, turns):
    before = sensors.range_bearing(x, m)
    assume(before[0] > 0.0)
    after = sensors.range_bearing(x + np.array([0.0, 0.0, 2 * np.pi * turns]), m)
    assert after[0] == before[0]
    assert_allclose(np.exp(1j * after[1]), np.exp(1j * before[1]), atol=1e-11)


@given(st.floats(-1e4, 1e4))
def test_bearing_is_wrapped(heading):
    _, bearing = sensors.range_bearing(np.array([0.0, 0.0, heading]), np.array([1.0, 0.0]))
    assert -np.pi <= bearing < np.pi
    assert_allclose(np.exp(1j * bearing), np.exp(-1j * heading), atol=1e-11)


def test_no_rounding_puts_a_bearing_at_pi_or_below_minus_pi():
    """Headings that look away from a landmark in the east, after many turns, and their floats."""
    away = np.arange(-9999, 10000, 2)[:, None] * np.pi
    x = np.zeros((10000, 17, 3))
    x[..., 2] = away + np.arange(-8, 9) * np.spacing(np.abs(away))
    bearing = sensors.range_bearing(x, np.broadcast_to([1.0, 0.0], (10000, 17, 2)))[..., 1]
    assert bearing.min() >= -np.pi
    assert bearing.max() < np.pi
    assert_allclose(np.abs(bearing), np.pi, atol=1e-10)


@given(st.floats(-3.1, 3.1))
def test_bearings_that_need_no_wrapping_keep_all_their_digits(heading):
    _, bearing = sensors.range_bearing(np.array([0.0, 0.0, heading]), np.array([1.0, 0.0]))
    assert bearing == -heading


@pytest.mark.parametrize(
    ("landmark", "bearing"),
    [((2, 0), 0.0), ((0, 2), np.pi / 2), ((-2, 0), -np.pi), ((0, -2), -np.pi / 2)],
)
def test_bearings_are_anticlockwise_from_ahead(landmark, bearing):
    x = np.array([5.0, 7.0, 0.0])
    assert_allclose(sensors.range_bearing(x, x[:2] + landmark), [2.0, bearing], atol=1e-15)


def test_at_the_landmark_the_jacobians_are_nan_and_the_others_are_not_touched():
    x, m = arguments(runs=(3,))
    m[1] = x[1, :2]
    assert sensors.range_only(x, m)[1] == 0.0
    for _, by_state, by_landmark in OF_LANDMARK.values():
        at_it = by_state(x, m)[1]
        assert np.isnan(at_it[:, :2]).all()
        assert np.isfinite(at_it[:, 2]).all()
        assert np.isnan(by_landmark(x, m)[1]).all()
        assert np.isfinite(by_state(x, m)[[0, 2]]).all()
        assert np.isfinite(by_landmark(x, m)[[0, 2]]).all()
