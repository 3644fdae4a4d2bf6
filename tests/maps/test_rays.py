"""Rays and segments in grids, against geometry of single squares."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from pgm.errors import ModelError
from pgm.kernels import rays
from pgm.maps import OccupancyMap


def crossing(point, unit, cell):
    """Where a ray enters and leaves the square of a cell (row, column); by halfplanes."""
    low, high = -np.inf, np.inf
    for p, u, edge in zip(point, unit, cell[::-1], strict=True):
        if u == 0.0:
            if not edge <= p < edge + 1.0:
                return np.inf, -np.inf
            continue
        ends = sorted([(edge - p) / u, (edge + 1.0 - p) / u])
        low, high = max(low, ends[0]), min(high, ends[1])
    return low, high


def slow_cast(stops, point, unit, most):
    """The first entry of a ray into any stop, square by square."""
    found = np.inf
    for cell in np.argwhere(stops):
        low, high = crossing(point, unit, cell)
        if low < high - 1e-12 and high > 1e-12:
            found = min(found, max(low, 0.0))
    return found if found < most else np.inf


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 13), st.integers(1, 13), st.floats(0.0, 0.5))
def test_rays_are_those_of_single_squares(seed, height, width, share):
    rng = np.random.default_rng(seed)
    stops = rng.random((height, width)) < share
    # Of beginnings in the grid and outside.
    points = rng.uniform(-3.0, 3.0 + np.array([[width], [height]]), size=(2, 20))
    turns = rng.uniform(-4.0, 4.0, size=20)
    units = np.stack([np.cos(turns), np.sin(turns)])
    most = rng.uniform(1.0, 20.0)
    found = rays.cast(rays.clearances(stops), points, units, most)
    due = [slow_cast(stops, p, u, most) for p, u in zip(points.T, units.T, strict=True)]
    assert_allclose(found, due, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("turn", [0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi])
def test_rays_along_axes(turn):
    stops = np.zeros((9, 9), dtype=bool)
    stops[[0, -1]] = stops[:, [0, -1]] = True
    unit = np.round([[np.cos(turn)], [np.sin(turn)]])
    found = rays.cast(rays.clearances(stops), np.array([[3.25], [4.5]]), unit, 100.0)
    due = {0: 4.75, 1: 3.5, 2: 2.25, 3: 3.5}
    assert_allclose(found, due[round(turn / (0.5 * np.pi)) % 4], atol=1e-12)


def test_jumps_over_free_boxes_change_nothing():
    rng = np.random.default_rng(1)
    clear = rays.clearances(rng.random((80, 70)) < 0.01)
    turns = rng.uniform(-4.0, 4.0, size=3000)
    points = rng.uniform(0.0, [[70.0], [80.0]], size=(2, 3000))
    units = np.stack([np.cos(turns), np.sin(turns)])
    one_by_one = (clear > 0).astype(np.int32)
    found = rays.cast(clear, points, units, 60.0)
    assert_array_equal(np.isfinite(found), np.isfinite(rays.cast(one_by_one, points, units, 60.0)))
    assert_allclose(found, rays.cast(one_by_one, points, units, 60.0), rtol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_segments_enter_the_squares_that_they_cross(seed):
    rng = np.random.default_rng(seed)
    points, ends = rng.uniform(0.0, 9.0, size=(2, 2, 15))
    found = [rays.entered(points[:, [k]], ends[:, [k]], 9) for k in range(15)]
    together = rays.entered(points, ends, 9)
    assert_array_equal(np.sort(together), np.sort(np.concatenate(found)))
    for point, end, cells in zip(points.T, ends.T, found, strict=True):
        length = np.linalg.norm(end - point)
        due = []
        for cell in np.ndindex(9, 9):
            low, high = crossing(point, (end - point) / length, cell)
            if max(low, 0.0) < min(high, length) - 1e-12:
                due.append(cell[0] * 9 + cell[1])
        assert sorted(cells.tolist()) == due


@pytest.mark.parametrize("far", [(7.5, 7.5), (0.5, 0.5), (7.5, 1.5), (1.5, 7.5), (4.5, 4.5)])
def test_segments_through_corners_go_from_side_to_side_once(far):
    near = np.array([[4.5], [4.5]])
    cells = rays.entered(near, np.array(far)[:, None], 9)
    assert len(set(cells.tolist())) == len(cells) == 1 + 2 * abs(far[0] - 4.5)
    assert {4 * 9 + 4, int(far[1]) * 9 + int(far[0])} <= set(cells.tolist())


def test_casting_from_poses_of_a_turned_map(building, angles):
    rng = np.random.default_rng(2)
    poses = building.poses(0.7, 3)[rng.permutation(30)[:12]]
    found = building.cast(poses, angles, 2.5)
    x, y, yaw = building.origin
    back = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    for pose, row in zip(poses, found, strict=True):
        point = back @ (pose[:2] - [x, y]) / 0.1
        for angle, distance in zip(angles, row, strict=True):
            turn = pose[2] + angle - yaw
            due = slow_cast(building.obstacles, point, [np.cos(turn), np.sin(turn)], 25.0)
            assert distance == pytest.approx(min(0.1 * due, 2.5), abs=1e-9)
    assert building.cast(poses.reshape(3, 4, 3), angles, 2.5).shape == (3, 4, len(angles))


def test_unknown_cells_stop_beams_or_not():
    line = OccupancyMap([[0, 0, np.nan, 0, 1]], 1.0)
    assert_allclose(line.cast([0.5, 0.5, 0.0], [0.0], 9.0), [3.5])
    assert_allclose(line.cast([0.5, 0.5, 0.0], [0.0], 9.0, through_unknown=False), [1.5])
    assert_allclose(line.cast([0.5, 0.5, np.pi], [0.0], 9.0, through_unknown=False), [9.0])
    assert_allclose(line.cast([4.5, 0.5, 0.0], [0.0], 9.0), [0.0])


def test_bad_beams(building):
    with pytest.raises(ModelError, match="poses have shape"):
        building.cast([1.0, 2.0], [0.0], 9.0)
    with pytest.raises(ModelError, match="NaN or infinite"):
        building.cast([1.0, 2.0, np.nan], [0.0], 9.0)
    with pytest.raises(ModelError, match="angles of beams have shape"):
        building.cast([1.0, 2.0, 0.0], 0.0, 9.0)
    with pytest.raises(ModelError, match="angles of beams are NaN"):
        building.cast([1.0, 2.0, 0.0], [np.inf], 9.0)
    with pytest.raises(ModelError, match="above 0"):
        building.cast([1.0, 2.0, 0.0], [0.0], 0.0)
