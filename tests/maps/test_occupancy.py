"""Occupancy maps: masks, distances, cells, poses, and the prior over free cells."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.distance import cdist

import pgm
from pgm.errors import ModelError
from pgm.maps import OccupancyMap, UniformPose


def test_masks_part_the_cells(building):
    whole = building.free.astype(int) + building.obstacles + building.unknown
    assert (whole == 1).all()
    assert_array_equal(building.obstacles, np.nan_to_num(building.occupied) > 0.65)
    assert np.isnan(building.occupied[building.unknown]).all()
    grey = OccupancyMap([[0.1, 0.3, 0.5, 0.9]], 1.0, free_threshold=0.4, occupied_threshold=0.45)
    assert_array_equal(grey.free, [[True, True, False, False]])
    assert_array_equal(grey.obstacles, [[False, False, True, True]])


def test_distances_are_those_to_the_nearest_obstacle(building):
    cells = np.argwhere(np.ones(building.shape, bool))
    due = cdist(cells, np.argwhere(building.obstacles)).min(axis=1) * building.resolution
    assert_allclose(building.distances, due.reshape(building.shape))


def test_centres_lie_in_their_cells(building):
    rows, columns = np.mgrid[:30, :40]
    centres = building.centres(rows, columns)
    cells = building.at(centres)
    assert_array_equal(cells.rows, rows)
    assert_array_equal(cells.columns, columns)
    assert cells.inside.all()
    # Row 0 is the lowest, and the frame is turned about its corner.
    turn = np.exp(0.4j) * (0.05 + 0.05j)
    assert_allclose(centres[0, 0], [5.0 + turn.real, -2.0 + turn.imag])
    assert_allclose(centres[0, 1] - centres[0, 0], 0.1 * np.array([np.cos(0.4), np.sin(0.4)]))


def test_points_outside_are_told():
    cells = OccupancyMap(np.zeros((2, 3)), 0.5).at(
        [[-0.1, 0.2], [1.6, 0.2], [1.4, 0.9], [1e300, 0]]
    )
    assert_array_equal(cells.inside, [False, False, True, False])
    assert_array_equal(cells.rows[:3], [0, 0, 1])
    assert_array_equal(cells.columns[:3], [-1, 3, 2])


def test_connected_cells_are_those_that_a_flood_reaches(building):
    start = building.centres(5, 5)
    cell = (5, 5)
    assert building.free[cell]
    reached, front = {cell}, [cell]
    while front:
        row, column = front.pop()
        for near in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
            inside = 0 <= near[0] < 30 and 0 <= near[1] < 40
            if inside and building.free[near] and near not in reached:
                reached.add(near)
                front.append(near)
    due = np.zeros(building.shape, bool)
    due[tuple(np.transpose(list(reached)))] = True
    assert_array_equal(building.connected(start), due)
    assert due.sum() < building.free.sum() + 1


def test_poses_are_a_grid_of_places_that_are_free(building):
    mask = building.connected(building.centres(5, 5))
    poses = building.poses(0.25, 8, mask)
    cells = building.at(poses[:, :2])
    assert cells.inside.all()
    assert mask[cells.rows, cells.columns].all()
    places = poses.reshape(-1, 8, 3)
    assert np.ptp(places[..., :2], axis=1).max() == 0.0
    assert_allclose(places[:, :, 2], np.tile(-np.pi + np.arange(8) * np.pi / 4, (len(places), 1)))
    nearest = np.sort(cdist(places[:, 0, :2], places[:, 0, :2]), axis=1)[:, 1]
    assert_allclose(nearest.min(), 0.25)
    due = sum(mask[int(2.5 * i + 1.25), int(2.5 * j + 1.25)] for i in range(12) for j in range(16))
    assert len(places) == due


def test_the_uniform_prior_is_one_over_what_is_free(building, x):
    mask = building.connected(building.centres(5, 5))
    prior = building.uniform(x, mask)
    drawn = prior.sample(size=(50, 400), rng=1).reshape(-1, 3)
    cells = building.at(drawn[:, :2])
    counts = np.zeros(building.shape)
    np.add.at(counts, (cells.rows, cells.columns), 1)
    assert not counts[~mask].any()
    expected = len(drawn) / mask.sum()
    statistic = ((counts[mask] - expected) ** 2).sum() / expected
    assert abs(statistic - mask.sum()) < 5.0 * np.sqrt(2.0 * mask.sum())
    assert abs(np.exp(1j * drawn[:, 2]).mean()) < 0.03
    within = building._to_cells(drawn[:, :2]) % 1.0
    assert_allclose(within.mean(axis=0), 0.5, atol=0.01)
    density = np.exp(prior.log_density(drawn[:100]))
    assert_allclose(density * mask.sum() * 0.01 * 2.0 * np.pi, 1.0)
    assert np.isneginf(prior.log_density([[0.0, 0.0, 0.0], [*building.centres(0, 0), 0.0]])).all()


def test_the_prior_at_a_step_is_one_too(building, x):
    prior = building.uniform(x).at(0)
    assert prior.child == x.at(0)
    assert prior.sample(rng=1).shape == (3,)


def test_maps_are_values(building):
    other = pickle.loads(pickle.dumps(building))
    assert_array_equal(other.free, building.free)
    with pytest.raises(AttributeError, match="immutable"):
        building.resolution = 1.0
    with pytest.raises(ValueError, match="read-only"):
        building.occupied[0, 0] = 1.0
    assert repr(building) == ("OccupancyMap(30 rows, 40 columns of 0.1 m from (5, -2), yaw 0.4)")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"occupied": [0.0, 1.0]}, r"shape \(2,\)"),
        ({"occupied": np.zeros((0, 3))}, r"shape \(0, 3\)"),
        ({"occupied": [[0.0, 1.5]]}, "1.5 in row 0, column 1"),
        ({"occupied": [[-0.1]]}, "-0.1 in row 0"),
        ({"occupied": [[np.inf]]}, "inf in row 0"),
        ({"occupied": [["wall"]]}, "must be numbers"),
        ({"resolution": 0.0}, "resolution must be a number above 0, not 0.0"),
        ({"resolution": np.nan}, "above 0, not nan"),
        ({"origin": (0.0, np.nan, 0.0)}, "must be finite"),
        ({"origin": (0.0, 1.0)}, r"origin has shape \(2,\)"),
        ({"free_threshold": 0.7}, "0.7, lies above its occupied_threshold, 0.65"),
        ({"occupied_threshold": 1.2}, "from 0 to 1, not 1.2"),
    ],
)
def test_bad_maps(change, message):
    arguments = {"occupied": [[0.0, 1.0]], "resolution": 0.1} | change
    with pytest.raises(ModelError, match=message):
        OccupancyMap(**arguments)


def test_questions_without_an_answer(building, x):
    empty, full = OccupancyMap(np.zeros((3, 3)), 1.0), OccupancyMap(np.ones((3, 3)), 1.0)
    with pytest.raises(ModelError, match="no obstacle"):
        _ = empty.distances
    for ask in (lambda: full.uniform(x), lambda: full.poses(1.0, 4)):
        with pytest.raises(ModelError, match="no free cell"):
            ask()
    with pytest.raises(ModelError, match="no free cell within the mask"):
        empty.uniform(x, np.zeros((3, 3), bool))
    with pytest.raises(ModelError, match=r"array of bools of shape \(3, 3\)"):
        empty.uniform(x, np.zeros((3, 3)))
    with pytest.raises(ModelError, match="set them closer"):
        OccupancyMap([[0.0] + [1.0] * 9], 1.0).poses(10.0, 1)
    with pytest.raises(ModelError, match="headings"):
        empty.poses(1.0, 0)
    with pytest.raises(ModelError, match="not in a free cell"):
        building.connected([0.0, 0.0])
    with pytest.raises(ModelError, match="points have shape"):
        building.at([1.0, 2.0, 3.0])
    with pytest.raises(ModelError, match="NaN or infinite"):
        building.at([1.0, np.nan])
    place = pgm.Variable("place", components=("x", "y"))
    with pytest.raises(ModelError, match="is no pose"):
        UniformPose(place, building)
    with pytest.raises(ModelError, match="is no pose"):
        building.uniform(pgm.Variable("x", components=("x", "y", "heading")))
