"""Occupancy grids from scans, against the inverse sensor model cell by cell."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from pgm.errors import ModelError
from pgm.maps import log_odds_map

SET = {"resolution": 0.25, "most": 3.0}


def slow_map(poses, scans, angles, corner, shape, odds=(0.7, 0.4, 0.5)):
    """Log-odds by Bayes' rule, beam after beam; each visits the cells of many points along it."""
    hit, miss, prior = (np.log(p / (1 - p)) for p in odds)
    total, visited = np.full(shape, prior), np.zeros(shape, bool)
    for pose, scan in zip(poses, scans, strict=True):
        for angle, distance in zip(angles, scan, strict=True):
            if np.isnan(distance):
                continue
            turn, length = pose[2] + angle, min(distance, SET["most"])
            along = np.linspace(0.0, length, 4001)[:, None]
            points = pose[:2] + along * [np.cos(turn), np.sin(turn)]
            cells = np.floor((points - corner) / SET["resolution"]).astype(int)[:, ::-1]
            passed = {tuple(cell) for cell in cells.tolist()}
            end = tuple(cells[-1].tolist())
            for cell in passed:
                if not (0 <= cell[0] < shape[0] and 0 <= cell[1] < shape[1]):
                    continue
                ended = cell == end and distance < SET["most"]
                total[cell] += (hit if ended else miss) - prior
                visited[cell] = True
    return np.where(visited, 1.0 / (1.0 + np.exp(-total)), np.nan)


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(4)
    poses = rng.normal(size=(8, 3)) * [1.0, 1.0, 3.0] + [0.3, -5.2, 0.0]
    scans = rng.uniform(0.3, 3.5, size=(8, 9))
    scans[1, 2], scans[3] = np.nan, np.inf
    return poses, scans, np.linspace(-1.5, 1.5, 9)


def test_a_map_is_that_of_bayes_rule(drive):
    found = log_odds_map(*drive, **SET)
    assert_allclose(found.origin[:2] / 0.25, np.round(found.origin[:2] / 0.25))
    due = slow_map(*drive, found.origin[:2], found.shape)
    assert_allclose(found.occupied, due, rtol=1e-9)
    for side in (0, -1):  # no larger than its beams
        assert (~np.isnan(found.occupied[side])).any()
        assert (~np.isnan(found.occupied[:, side])).any()
    other = log_odds_map(*drive, hit=0.9, miss=0.2, prior=0.3, **SET)
    assert_allclose(
        other.occupied, slow_map(*drive, other.origin[:2], other.shape, (0.9, 0.2, 0.3))
    )


@pytest.mark.parametrize("corner", [(-1.0, -6.0), (-9.0, -12.0), (0.0, -7.0)])
def test_a_map_of_given_cells_is_a_part_of_it(drive, corner):
    found = log_odds_map(*drive, origin=(*corner, 0.0), shape=(14, 37), **SET)
    assert found.shape == (14, 37)
    assert_allclose(found.occupied, slow_map(*drive, corner, (14, 37)), rtol=1e-9)
    whole = log_odds_map(*drive, origin=(*corner, 0.0), **SET)
    rows, columns = (min(pair) for pair in zip(whole.shape, (14, 37), strict=True))
    assert_array_equal(whole.occupied[:rows, :columns], found.occupied[:rows, :columns])


def test_a_turned_map_of_turned_poses_is_the_same(drive):
    poses, scans, angles = drive
    turn, shift = 0.8, np.array([3.0, 1.0])
    matrix = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    moved = np.column_stack([poses[:, :2] @ matrix + shift, poses[:, 2] + turn])
    plain = log_odds_map(*drive, origin=(-4.0, -9.0, 0.0), **SET)
    corner = np.array([-4.0, -9.0]) @ matrix + shift
    turned = log_odds_map(moved, scans, angles, origin=(*corner, turn), **SET)
    assert_allclose(turned.occupied, plain.occupied, rtol=1e-9)


def test_a_mounted_sensor_is_where_it_is(drive):
    poses, scans, angles = drive
    mount = np.array([0.4, -0.1, 0.5])
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    sensors = poses + np.column_stack(
        [0.4 * cos + 0.1 * sin, 0.4 * sin - 0.1 * cos, np.full(8, 0.5)]
    )
    found = log_odds_map(poses, scans, angles, mount=mount, **SET)
    due = log_odds_map(sensors, scans, angles, **SET)
    assert_allclose(found.occupied, due.occupied)


def test_a_building_is_found_again(building, x):
    poses = building.uniform(x, building.connected(building.centres(5, 5))).sample(size=150, rng=1)
    angles = np.linspace(-np.pi, np.pi, 90)
    scans = building.cast(poses, angles, 3.0) + 1e-3
    found = log_odds_map(
        poses, scans, angles, resolution=0.1, most=3.0, origin=building.origin, shape=building.shape
    )
    assert (found.obstacles & building.free).sum() < 3
    assert (found.free & building.obstacles).sum() < 3
    assert found.free.sum() > 0.9 * building.free.sum() - building.unknown.sum()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"poses": np.zeros((7, 3))}, r"scans have shape \(8, 9\)"),
        ({"poses": np.full((8, 3), np.nan)}, "poses have entries that are NaN"),
        ({"scans": np.full((8, 9), np.nan)}, "no beam that was measured"),
        ({"scans": np.full((8, 9), -1.0)}, "ranges below 0"),
        ({"angles": np.full(9, np.nan)}, "angles of beams are NaN"),
        ({"resolution": 0.0}, "resolution must be"),
        ({"most": -1.0}, "most must be"),
        ({"hit": 1.0}, "hit must be a probability between 0 and 1"),
        ({"miss": 0.6}, "must not be above hit nor below miss"),
        ({"shape": (3, 0)}, "rows and columns"),
        ({"origin": (0.0, np.inf, 0.0)}, "must be finite"),
        ({"origin": (90.0, 0.0, 0.0)}, "no beam enters the map"),
        ({"resolution": 1e-7}, "would take .* larger resolution"),
    ],
)
def test_bad_scans(drive, change, message):
    names = dict(zip(("poses", "scans", "angles"), drive, strict=True))
    with pytest.raises(ModelError, match=message):
        log_odds_map(**(names | SET | change))
