"""Feature maps."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import pgm
from models.sensors import range_bearing
from pgm.errors import ModelError
from pgm.maps import FeatureMap

NAMES = ("door", "pillar", "tree")
PLACES = [[0.0, 1.0], [4.0, 3.0], [-2.0, 5.0]]


def test_landmarks_by_place_and_name():
    features = FeatureMap(PLACES, NAMES)
    assert_array_equal(features.at("tree"), [-2.0, 5.0])
    assert_array_equal(features.at(["tree", "door"]), [[-2.0, 5.0], [0.0, 1.0]])
    assert features.at([]).shape == (0, 2)
    points = np.random.default_rng(1).normal(size=(4, 5, 2)) * 4.0
    apart = np.linalg.norm(points[..., None, :] - np.array(PLACES), axis=-1)
    assert_array_equal(features.nearest(points), apart.argmin(axis=-1))
    assert_array_equal(features.bounds, [[-2.0, 1.0], [4.0, 5.0]])
    assert_array_equal(list(features), PLACES)
    assert len(features) == 3
    assert repr(features) == "FeatureMap(3 landmarks, door, pillar, tree)"
    assert repr(FeatureMap(PLACES)) == "FeatureMap(3 landmarks)"
    assert FeatureMap([[1.0, 2.0, 3.0]]).nearest([0.0, 0.0, 0.0]) == 0


def test_they_are_evidence_of_sightings():
    x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
    z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
    m = pgm.Variable("m", components=("east", "north"))
    features = FeatureMap(PLACES, NAMES)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, np.zeros(3), np.eye(3))],
        [pgm.LinearGaussianCPD(x, {x.previous: np.eye(3)}, cov=np.eye(3))],
        [pgm.NonlinearGaussianCPD(z, (x, m), range_bearing, cov=0.01 * np.eye(2))],
    )
    values, step = [[5.0, 0.1], [1.0, 1.5]], [0, 1]
    seen = pgm.sightings(values, step=step, given={m: features.at(("pillar", "door"))})
    bare = pgm.sightings(values, step=step, given={m: np.array([PLACES[1], PLACES[0]])})
    found = pgm.filter(model, {z: seen}, steps=1)
    assert_array_equal(found[x].mean, pgm.filter(model, {z: bare}, steps=1)[x].mean)
    all_seen = pgm.sightings([[1.0, 0.0]] * 3, step=[0, 0, 1], given={m: features})
    assert np.isfinite(pgm.filter(model, {z: all_seen}, steps=1).log_evidence)


@pytest.mark.parametrize(
    ("positions", "names", "message"),
    [
        ([1.0, 2.0], None, r"shape \(2,\)"),
        ([[1.0], [2.0]], None, r"shape \(2, 1\)"),
        (np.zeros((0, 2)), None, r"shape \(0, 2\)"),
        ([[1.0, np.nan]], None, "NaN or infinite"),
        (PLACES, ("door", "tree"), "2 names of 3 landmarks"),
        (PLACES, ("door", "tree", "door"), "two landmarks are called 'door'"),
        (PLACES, "abc", "sequence of texts"),
        (PLACES, (1, 2, 3), "sequence of texts"),
    ],
)
def test_bad_landmarks(positions, names, message):
    with pytest.raises(ModelError, match=message):
        FeatureMap(positions, names)


def test_names_that_no_landmark_has():
    with pytest.raises(ModelError, match="no landmark called 'bush'"):
        FeatureMap(PLACES, NAMES).at("bush")
    with pytest.raises(ModelError, match="its landmarks have no names"):
        FeatureMap(PLACES).at(["bush"])
    with pytest.raises(ModelError, match="points have shape"):
        FeatureMap(PLACES).nearest([1.0])
