"""The discrete worlds: the lecture's numbers, the textbook, enumeration, and what is written."""

from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose

from experiments import topological
from experiments.worlds import locate, textbook
from models import worlds

WORLDS = {"grid_world": worlds.grid_world(), "hallway": worlds.hallway(), "maze": worlds.maze()}


def evidence(world, steps=12, seed=0):
    """Actions and readings as the world would have them, from a cell that may be."""
    rng = np.random.default_rng(seed)
    cell = rng.choice(len(world.prior), p=world.prior)
    actions, readings = (
        [],
        [world.reading.states[rng.choice(world.reading.size, p=world.sensor[cell])]],
    )
    for step in range(steps):
        actions.append(rng.integers(world.action.size))
        cell = rng.choice(len(world.prior), p=world.motion[cell, actions[-1]])
        seen = rng.choice(world.reading.size, p=world.sensor[cell])
        readings.append(None if step % 4 == 3 else world.reading.states[seen])
    return [world.action.states[u] for u in actions], readings


@pytest.mark.parametrize("name", WORLDS)
def test_the_network_is_the_textbook_s(name):
    world = WORLDS[name]
    found = locate(world, *evidence(world))
    assert found.difference < 1e-12
    filtered, smoothed, log_density = textbook(world, *evidence(world))
    assert_allclose(found.filtered.probabilities, filtered, atol=1e-12)
    assert_allclose(found.smoothed.probabilities, smoothed, atol=1e-12)
    assert found.log_evidence == pytest.approx(log_density, abs=1e-12)
    assert_allclose(found.predicted.probabilities[0], world.prior, atol=1e-15)


def test_the_most_probable_path_is_the_best_of_all():
    world = WORLDS["grid_world"]
    actions, readings = evidence(world, steps=4, seed=3)
    u = [world.action.index(action) for action in actions]
    z = [None if reading is None else world.reading.index(reading) for reading in readings]

    def density(path):
        p = world.prior[path[0]]
        for t, cell in enumerate(path):
            p *= world.motion[path[t - 1], u[t - 1], cell] if t else 1.0
            p *= 1.0 if z[t] is None else world.sensor[cell, z[t]]
        return p

    best = max(product(range(6), repeat=5), key=density)
    assert density(locate(world, actions, readings).path) == pytest.approx(density(best), rel=1e-12)


@pytest.fixture(scope="module")
def summaries(quick):
    done = map(quick, ("grid_world", "hallway", "maze", "topological"))
    return {each.name: (each.folder, each.summary) for each in done}


def test_all_of_them_are_the_textbook_s_and_drawn(summaries):
    for name, (out, summary) in summaries.items():
        assert summary["experiment"] == name
        assert summary["largest_difference"] < 1e-12
        pictures = [entry["figure"] for entry in summary["page"] if "figure" in entry]
        assert pictures
        for picture in pictures:
            assert (out / picture).read_bytes().startswith(b"\x89PNG")


def test_the_lecture_s_beliefs(summaries):
    _, summary = summaries["grid_world"]
    assert_allclose(summary["belief_1"], [[1 / 18, 16 / 18, 1 / 18], [0, 0, 0]], atol=1e-15)
    assert_allclose(
        summary["predicted_2"],
        np.array([[0.3, 4.8, 0.3], [2.3, 9.7, 0.6]]) / 18.0,
        atol=1e-15,
    )
    assert summary["path"] == ["b", "e", "f", "c"]


def test_the_hallway_s_smoother_knows_more(summaries):
    _, summary = summaries["hallway"]
    assert summary["at_truth"]["smoother"] > summary["at_truth"]["filter"]
    assert summary["truth"][0] == worlds.hallway().cell.index("5")
    assert len(summary["readings"]) == len(summary["truth"]) == len(summary["path"]) == 21


def test_the_maze_is_found_out_in_spite_of_a_mistake(summaries):
    _, summary = summaries["maze"]
    assert summary["path"] == summary["truth"] == ["1,5", "2,5", "3,5", "3,6", "3,7"]
    assert summary["readings"] == [None, "EW", "SW", "N", "NS"]
    right = [summary["cells"].index(cell) for cell in summary["truth"]]
    filtered, smoothed = np.array(summary["filtered"]), np.array(summary["smoothed"])
    assert filtered[2, right[2]] < 0.1 < 0.8 < smoothed[2, right[2]]
    assert filtered[4].argmax() == right[4]


def test_a_drive_in_the_building_goes_from_place_to_place():
    building = worlds.building()
    drive = topological.driven(building, np.random.default_rng(1), 200)
    for before, after in zip(drive.place[:-1], drive.place[1:], strict=True):
        assert after == before or after in building.neighbour[before]
    assert building.place.states[drive.place[-1]] == topological.ROUTE[-1]
    assert len(drive.place) == len(drive.heading) == len(drive.action) + 1
    short = topological.driven(building, np.random.default_rng(1), 5)
    assert len(short.action) == 5


def test_the_building_s_smoother_knows_more(summaries):
    _, summary = summaries["topological"]
    for name in ("place", "heading"):
        assert summary["at_truth"]["smoother"][name] > summary["at_truth"]["filter"][name]
        assert len(summary["path"][name]) == len(summary["truth"][name])
