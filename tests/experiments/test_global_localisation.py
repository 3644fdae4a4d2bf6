"""Drives through a house, and what finds the robot that is on them."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import binomtest

import pgm
from experiments import global_localisation, house, kidnapped
from experiments.global_localisation import ways
from experiments.global_localisation.experiment import found_at
from experiments.global_localisation.filters import follow
from experiments.global_localisation.paths import CLEARANCE, Paths, along
from experiments.global_localisation.places import (
    NEAR,
    TURNED,
    Share,
    heaviest,
    right,
)
from experiments.global_localisation.world import MOTION_STD, STEP, World, odometry
from experiments.kidnapped.carried import FAR, carried
from experiments.kidnapped.experiment import policies
from models import motion

needs_house = pytest.mark.skipif(house.find() is None, reason="rtb-data is not installed")


@pytest.fixture(scope="module")
def world():
    return World(house.load())


@pytest.fixture(scope="module")
def rooms():
    """Two rooms of 4 m, and a door in the middle of the wall between them."""
    occupied = np.zeros((80, 161))
    occupied[[0, -1]] = occupied[:, [0, -1]] = 1.0
    occupied[:, 80] = 1.0
    occupied[30:50, 80] = 0.0
    return pgm.maps.OccupancyMap(occupied, 0.05)


def test_shares_have_wilsons_interval():
    for count, runs in ((0, 7), (5, 9), (190, 200), (6, 6)):
        found = Share.of(np.arange(runs) < count)
        due = binomtest(count, runs).proportion_ci(0.95, method="wilson")
        assert (found.value, found.count, found.runs) == (count / runs, count, runs)
        assert_allclose([found.low, found.high], [due.low, due.high], atol=1e-7)


def test_the_heaviest_mode_is_not_the_mean():
    rng = np.random.default_rng(3)
    near = rng.normal([2.2, 1.2, np.pi], 0.05, (60, 3))
    far = rng.normal([9.0, 7.0, 0.5], 0.05, (90, 3))
    points = np.concatenate([near, far])
    points[:, 2] = np.mod(points[:, 2] + np.pi, 2 * np.pi) - np.pi
    weights = np.concatenate([np.full(60, 2.0), np.full(90, 1.0)])
    found = heaviest(points, weights / weights.sum())
    assert_allclose(found[:2], near[:, :2].mean(axis=0), atol=1e-9)
    assert_allclose(np.cos(found[2]), -1.0, atol=1e-3)
    weights = np.concatenate([np.full(60, 1.0), np.full(90, 1.0)])
    assert_allclose(heaviest(points, weights)[:2], far[:, :2].mean(axis=0), atol=1e-9)


def test_particles_that_weigh_nothing_are_no_mode():
    points = np.array([[1.0, 1.0, 0.0], [5.0, 5.0, 0.0], [9.0, 9.0, 0.0]])
    assert heaviest(points, np.array([0.0, 1.0, 0.0])).tolist() == [5.0, 5.0, 0.0]


def test_a_drive_is_found_where_it_stays_right():
    rows = [[0, 1, 0, 1, 1], [1, 1, 1, 1, 1], [1, 1, 1, 1, 0], [0, 0, 0, 0, 1]]
    assert found_at(np.array(rows, dtype=bool)).tolist() == [3, 0, 0, 4]


def test_right_is_near_and_turned_little():
    truth = np.array([1.0, 2.0, 3.1])
    off = np.array([[0.9 * NEAR, 0, 0], [1.1 * NEAR, 0, 0], [0, 0, 0.9 * TURNED], [0, 0, -0.4]])
    assert right(truth + off, truth).tolist() == [True, False, True, False]
    assert right(truth + np.array([0.0, 0.0, 2 * np.pi]), truth)


def test_paths_go_through_doors_and_keep_off_walls(rooms):
    paths = Paths(rooms, np.ones(rooms.shape, dtype=bool))
    rng = np.random.default_rng(1)
    for _ in range(10):
        points = paths.draw(5.0, rng)
        assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() >= 5.0
        assert (points[[0, -1], 0] < 4.0).sum() == 1  # it goes from room to room
        cells = rooms.at(points)
        assert rooms.distances[cells.rows, cells.columns].min() > CLEARANCE - 0.1
        there = np.abs(points[:, 0] - 4.025).argmin()
        assert abs(points[there, 1] - 2.0) < 0.2
    with pytest.raises(pgm.ModelError, match="no path of 50 m"):
        paths.draw(50.0, rng)


def test_poses_along_a_path_are_a_step_apart():
    turn = np.linspace(0.0, 4.0, 2001)
    circle = 2.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    poses = along(circle, 0.5, 12)
    at = 0.25 * np.arange(13)
    assert_allclose(poses[:, 0], 2.0 * np.cos(at), atol=1e-4)
    assert_allclose(poses[:, 2], at + np.pi / 2, atol=2e-3)


def test_odometry_leads_along_the_drive_but_for_its_noise():
    rng = np.random.default_rng(5)
    truth = np.cumsum(rng.normal(size=(50, 41, 3)) * 0.4, axis=1)
    off = motion.increment(truth[:, :-1], odometry(truth, rng)) - truth[:, 1:]
    assert_allclose(off.mean(axis=(0, 1)), 0.0, atol=0.01)
    assert_allclose(off.std(axis=(0, 1)), MOTION_STD, rtol=0.06)


@needs_house
def test_drives_are_indoors_and_scans_are_of_them(world):
    drives = world.drives(6, 10, np.random.default_rng(0))
    cells = world.map.at(drives.truth[..., :2])
    assert world.indoors[cells.rows, cells.columns].all()
    steps = np.linalg.norm(np.diff(drives.truth[..., :2], axis=1), axis=-1)
    assert_allclose(steps, STEP, atol=0.06)
    expected = world.map.cast(drives.truth, world.laser.angles, world.laser.most)
    assert np.median(np.abs(drives.scans - expected)) < 0.06


@needs_house
def test_a_carried_robot_is_elsewhere_and_its_odometer_does_not_tell(world):
    drives = carried(world, 5, 4, 6, np.random.default_rng(2))
    assert drives.steps == 10
    away = np.linalg.norm(np.diff(drives.truth[..., :2], axis=1), axis=-1)
    assert (away[:, 3] > FAR - STEP).all()
    assert (np.delete(away, 3, axis=1) < 1.5 * STEP).all()
    assert (np.abs(drives.odometry[..., :2]) < 2.0).all()


@needs_house
@pytest.mark.slow
def test_particles_and_the_grid_say_the_same_where_one_place_is_left(world):
    drives = world.drives(2, 12, np.random.default_rng(4))
    network = world.network(ways.field(world))
    start = ways.cells(world, 0.35, 18)
    grid = ways.Sizes(cell=0.3, turns=36).grid()
    found = [
        follow((network, belief), drives).poses
        for belief in (pgm.Particles(2000, seed=1, start=start), grid)
    ]
    assert right(found[0][:, -1], drives.truth[:, -1]).all()
    assert_allclose(found[0][:, -1, :2], found[1][:, -1, :2], atol=0.15)


@needs_house
def test_estimates_are_of_beliefs_of_either_kind(world):
    drives = world.drives(1, 3, np.random.default_rng(4))
    network, start = world.network(ways.field(world)), ways.cells(world, 0.5, 12)
    evidence = {
        ways.scan: pgm.sightings(drives.scans[0], step=np.arange(4)),
        network.transition[0].given[1]: drives.odometry[0],
    }
    belief = pgm.filter(network, evidence, belief=pgm.Particles(500, seed=2, start=start))
    way = network, pgm.Particles(500, seed=2, start=start)
    last = belief[network.states[0].at(3)]
    assert_allclose(
        heaviest(np.column_stack([last.states[:, :2], _wrapped(last.states[:, 2])]), last.weights),
        follow(way, drives).poses[0, -1],
    )


def _wrapped(angles):
    return np.mod(angles + np.pi, 2 * np.pi) - np.pi


@needs_house
def test_draws_from_the_scan_find_a_carried_robot_and_nothing_else_does(world):
    drives = carried(world, 12, 8, 10, np.random.default_rng(6))
    known = policies(world, 1000, 0.5, 16, 0)
    shares = {
        name: right(follow(known[name], drives).poses, drives.truth)[:, -1].mean()
        for name in ("none", "likelihood")
    }
    assert shares["none"] < 0.3 < 0.6 < shares["likelihood"]


@needs_house
@pytest.mark.slow
@pytest.mark.parametrize(
    ("experiment", "ways_due", "files"),
    [
        (
            global_localisation,
            {ways.GRID, ways.FIELDS, ways.KLD, ways.BEAMS},
            ("success", "errors", "map"),
        ),
        (
            kidnapped,
            {"none", "uniform", "likelihood", "fresh"},
            ("errors", "injected", "map"),
        ),
    ],
)
def test_the_quick_form_leaves_what_it_promises(experiment, ways_due, files, tmp_path):
    experiment.run(out=tmp_path, seed=1, **experiment.QUICK)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert set(summary["success"]) == ways_due
    for share in summary["success"].values():
        wilson = binomtest(share["count"], share["runs"]).proportion_ci(method="wilson")
        assert_allclose([share["low"], share["high"]], wilson, atol=1e-9)
        assert share["value"] == share["count"] / share["runs"]
        assert share["runs"] == experiment.QUICK["runs"]
    assert set(summary["by_step"]) == ways_due
    for name in files:
        assert (tmp_path / f"{name}.png").exists()
    if experiment is global_localisation:
        assert (tmp_path / "drive.gif").read_bytes().startswith(b"GIF8")


@pytest.mark.parametrize("experiment", [global_localisation, kidnapped])
def test_without_the_floor_plan_they_say_so(experiment, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(house, "find", lambda: None)
    experiment.run(out=tmp_path / "out", seed=0, **experiment.QUICK)
    assert "pip install 'rtb-data" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@needs_house
def test_at_full_size_particles_find_what_the_grid_finds(tmp_path):
    """2,000 particles, begun from the first scan, against what the grid finds in 200 drives."""
    global_localisation.run(out=tmp_path, seed=0)
    success = json.loads((tmp_path / "summary.json").read_text())["success"]
    assert success["particles, field"]["relative"] >= 0.95


@pytest.mark.slow
@needs_house
def test_at_full_size_the_scan_finds_who_was_carried_elsewhere(tmp_path):
    kidnapped.run(out=tmp_path, seed=0)
    success = json.loads((tmp_path / "summary.json").read_text())["success"]
    assert success["likelihood"]["relative"] >= 0.9
    assert success["none"]["relative"] < 0.1
