"""The numbers of the discrete worlds, against what their docstrings say."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from models import worlds
from models.worlds.maze import PATTERNS, named

WORLDS = {"grid_world": worlds.grid_world(), "hallway": worlds.hallway(), "maze": worlds.maze()}


@pytest.mark.parametrize("name", WORLDS)
def test_probabilities_sum_to_one(name):
    world = WORLDS[name]
    cells, actions, readings = (len(v.states) for v in (world.cell, world.action, world.reading))
    assert world.motion.shape == (cells, actions, cells)
    assert world.sensor.shape == (cells, readings)
    assert world.places.shape == (cells, 2)
    assert len({tuple(place) for place in world.places.tolist()}) == cells
    for table in (world.prior, world.motion, world.sensor):
        assert table.min() >= 0.0
        assert_allclose(table.sum(axis=-1), 1.0, atol=1e-15)


def test_the_grid_world_s_beliefs_are_the_lecture_s():
    """By hand: belief₁ = (1, 16, 1)/18 over the top row, and a step south from there."""
    world = WORLDS["grid_world"]
    belief = world.prior * world.sensor[:, 1]
    belief /= belief.sum()
    assert_allclose(belief, np.array([1, 16, 1, 0, 0, 0]) / 18.0, atol=1e-15)
    south = world.action.states.index("south")
    assert_allclose(
        belief @ world.motion[:, south],
        np.array([0.3, 4.8, 0.3, 2.3, 9.7, 0.6]) / 18.0,
        atol=1e-15,
    )
    printed = [0.0167, 0.2667, 0.0167, 0.1278, 0.5389, 0.0333]
    assert_allclose(belief @ world.motion[:, south], printed, atol=5e-5)


@pytest.mark.parametrize(
    ("action", "start", "due"),
    [
        ("south", "b", {"e": 0.6, "b": 0.3, "d": 0.1}),
        ("south", "a", {"d": 0.7, "a": 0.3}),  # along the wall
        ("south", "d", {"d": 1.0}),  # in the corner
        ("south", "f", {"f": 0.9, "e": 0.1}),
        ("north", "d", {"a": 0.6, "d": 0.3, "b": 0.1}),
        ("north", "b", {"b": 0.9, "c": 0.1}),
        ("east", "a", {"b": 0.6, "a": 0.3, "e": 0.1}),
        ("west", "f", {"e": 0.6, "f": 0.3, "b": 0.1}),
        ("west", "c", {"b": 0.7, "c": 0.3}),
    ],
)
def test_a_step_in_the_grid_world(action, start, due):
    world = WORLDS["grid_world"]
    moved = world.motion[world.cell.states.index(start), world.action.states.index(action)]
    found = {world.cell.states[k]: p for k, p in enumerate(moved) if p}
    assert found == pytest.approx(due)


def test_a_step_in_the_hallway():
    world = worlds.hallway(5, (1,), steps=(0.1, 0.7, 0.2), seen=0.9)
    wait, ahead = world.motion[:, 0], world.motion[:, 1]
    assert_allclose(wait, np.eye(5))
    assert_allclose(ahead[0], [0.1, 0.7, 0.2, 0.0, 0.0])
    assert_allclose(ahead[3], [0.0, 0.0, 0.0, 0.1, 0.9])
    assert_allclose(ahead[4], [0.0, 0.0, 0.0, 0.0, 1.0])
    assert_allclose(world.sensor[1], [0.9, 0.05, 0.05])
    assert_allclose(world.sensor[[0, 2, 3]], np.tile([0.05, 0.9, 0.05], (3, 1)))
    assert_allclose(world.sensor[4], [0.05, 0.05, 0.9])
    assert world.places.tolist() == [[0, k] for k in range(5)]


@pytest.mark.parametrize("door", [-1, 4, 5])
def test_a_door_beyond_the_hallway_is_refused(door):
    with pytest.raises(ValueError, match=rf"doors in the cells \[{door}\]; .* cells 0 to 3"):
        worlds.hallway(5, (1, door))


SMALL = ("..#", "#..")


def test_the_walls_of_a_maze():
    assert_allclose(worlds.walls(SMALL), [[1, 0, 1, 1], [1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 0]])
    world = worlds.maze(SMALL)
    assert world.cell.states == ("0,0", "0,1", "1,1", "1,2")
    assert world.places.tolist() == [[0, 0], [0, 1], [1, 1], [1, 2]]


def test_a_frame_of_walls_changes_nothing_but_names():
    framed = worlds.maze(("#####", "#..##", "##..#", "#####"))
    plain = worlds.maze(SMALL)
    assert_allclose(framed.motion, plain.motion)
    assert_allclose(framed.sensor, plain.sensor)
    assert_allclose(framed.places, plain.places + 1)


def test_at_most_one_sensor_of_a_maze_is_mistaken():
    world = worlds.maze(SMALL, mistake=0.2)
    for walls, row in zip(worlds.walls(SMALL), world.sensor, strict=True):
        for pattern, probability in zip(PATTERNS, row, strict=True):
            wrong = sum(a != b for a, b in zip(walls, pattern, strict=True))
            assert probability == pytest.approx({0: 0.8, 1: 0.05}.get(wrong, 0.0))
    assert world.reading.states[PATTERNS.index((True, False, True, False))] == "NS"
    assert named((False,) * 4) == "none"


def test_a_step_in_a_maze():
    world = worlds.maze(SMALL, fails=0.1)
    north, east, south, west = np.moveaxis(world.motion, 1, 0)
    assert_allclose(north[2], [0.0, 0.9, 0.1, 0.0])
    assert_allclose(east[0], [0.1, 0.9, 0.0, 0.0])
    assert_allclose(south[1], [0.0, 0.1, 0.9, 0.0])
    assert_allclose(west[0], [1.0, 0.0, 0.0, 0.0])


def test_a_maze_of_walls_is_refused():
    with pytest.raises(ValueError, match="no cells to be in"):
        worlds.maze(("##", "##"))


def test_the_building_s_probabilities_sum_to_one():
    found = worlds.building()
    for table in (found.turning, found.going, found.looks, found.ahead):
        assert table.min() >= 0.0
        assert_allclose(table.sum(axis=-1), 1.0, atol=1e-15)
    count = len(found.place.states)
    assert found.going.shape == (count, 4, 3, count)
    assert found.neighbour.shape == (count, 4)


def test_ways_through_the_building_lead_back():
    found = worlds.building()
    ways = [(k, d, n) for (k, d), n in np.ndenumerate(found.neighbour) if n >= 0]
    assert len(ways) == 28  # a loop of ten places, and four more at ends of corridors
    for place, direction, other in ways:
        assert found.neighbour[other, (direction + 2) % 4] == place
        offset = found.places[other] - found.places[place]
        assert tuple(offset.tolist()) == list(worlds.COMPASS.values())[direction]


def test_a_step_and_a_turn_in_the_building():
    found = worlds.building(turns=0.9, goes=0.85, recognised=0.8, way_seen=0.9)
    place, heading = found.place.states.index, found.heading.states.index
    ahead = found.going[place("junction W"), heading("north"), 0]
    assert ahead[place("laboratory")] == pytest.approx(0.85)
    assert ahead[place("junction W")] == pytest.approx(0.15)
    assert found.going[place("entrance"), heading("west"), 0, place("entrance")] == 1.0
    assert found.going[place("stairs"), 0, 1, place("stairs")] == 1.0
    assert_allclose(found.turning[heading("north"), 2], [0.1, 0.9, 0.0, 0.0])
    assert_allclose(found.turning[heading("north"), 1], [0.1, 0.0, 0.0, 0.9])
    assert_allclose(found.turning[:, 0], np.eye(4))
    assert_allclose(found.looks[place("stairs")], [0.1, 0.1, 0.8])
    assert_allclose(found.ahead[place("stairs"), heading("south")], [0.9, 0.1])
    assert_allclose(found.ahead[place("stairs"), heading("north")], [0.1, 0.9])


def test_an_unknown_kind_of_place_is_refused():
    with pytest.raises(ValueError, match=r"kinds of places \['lift'\]"):
        worlds.building({"lift": ("lift", 0, 0)})
