"""Pose graphs, maps and fields of the benchmark: they are what they are called."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import agreement, first_call, memory
from benchmarks.libraries import pgm_maps
from benchmarks.rows import ROWS
from benchmarks.work import fields, landmarks, pose_graphs
from models import motion, sensors
from models.pose_graphs import squared_errors

BY_NAME = {row.name: row for row in ROWS}


def wrapped(angles):
    return np.angle(np.exp(1j * angles))


def is_of_right_noise(squares, told, free):
    """Whether a sum of squares at the optimum is one of χ², to four of its deviations."""
    due = told - free
    return abs(squares.sum() - due) < 4 * np.sqrt(2 * due)


@pytest.mark.parametrize("work", [fields.grid(7), fields.chain(60), fields.grid(1)])
def test_fields_are_those_of_their_recursion(work):
    """Each variable sums what is new in those before it; readings condition on them."""
    sums = np.eye(work.units)
    for k in range(work.units):
        for j in work.before(k):
            sums[k] += work.weight * sums[j]
    prior = fields.NOISE * sums @ sums.T
    read = np.arange(0, work.units, fields.READ)
    gain = np.linalg.solve(
        prior[np.ix_(read, read)] + fields.READ_NOISE * np.eye(read.size), prior[read]
    ).T
    ((means, covs),) = pgm_maps.marginals(work).call()
    np.testing.assert_allclose(means[:, 0], gain @ work.readings, rtol=0, atol=1e-12)
    due = np.diag(prior - gain @ prior[read])
    np.testing.assert_allclose(covs[:, 0, 0], due, rtol=1e-10)


def test_the_square_has_two_before_each_but_at_its_edges():
    work = fields.grid(3)
    assert [work.before(k) for k in (0, 1, 3, 4)] == [[], [0], [0], [1, 3]]
    assert fields.chain(4).before(3) == [2]
    assert fields.chain(4).units == 4


def test_drawn_worlds_have_as_many_edges_as_were_asked_for_and_the_noise_of_edges():
    work = pose_graphs.city(900)
    graph = work.graph
    assert len(graph.edges) == 900 * 20_687 // 10_000
    pairs = set(zip(graph.edges.first.tolist(), graph.edges.second.tolist(), strict=True))
    assert len(pairs) == len(graph.edges)
    assert {(k, k + 1) for k in range(899)} < pairs
    ((means, _),) = pgm_maps.marginals(work).call()
    poses = np.concatenate([graph.poses[:1], means])
    errors = squared_errors(graph, poses, graph.landmarks)
    assert is_of_right_noise(errors, 3 * len(graph.edges), 3 * 899)
    away = graph.poses - poses  # the map as a whole may drift, but not from pose to pose
    spread = np.diff(away[1:], axis=0).std(axis=0) / np.sqrt(2.0)
    np.testing.assert_allclose(spread, pose_graphs.START_STD, rtol=0.15)
    assert (away[0] == 0.0).all()


def test_a_drawn_robot_goes_a_metre_at_a_time_along_streets():
    graph = pose_graphs.streets(2_000, 4_000, seed=3)
    steps = graph.edges.motions[:1_999]
    np.testing.assert_allclose(np.abs(steps[:, :2]).sum(axis=1), 1.0, atol=0.5)
    turns = wrapped(steps[:, 2]) / (np.pi / 2)
    assert np.abs(turns - turns.round()).max() < 0.1
    assert set(turns.round().astype(int).tolist()) == {-1, 0, 1}
    at_crossings = np.abs(turns) > 0.5
    assert 0.02 < at_crossings.mean() < 0.2


def test_the_city_is_as_large_as_the_published_one():
    row = BY_NAME["graph_city"]
    graph = row.work(row.size).graph
    assert (len(graph.poses), len(graph.edges)) == (10_000, 20_687)


@pytest.mark.parametrize("name", pose_graphs.PUBLISHED)
def test_published_graphs_are_as_large_as_they_are_told(name):
    poses, edges = pose_graphs.PUBLISHED[name]
    work = pose_graphs.published(name, poses)
    assert work.units == poses
    assert len(work.graph.edges) == edges
    small = pose_graphs.published(name, 50)
    assert len(small.asked().kinds[0]) == 49  # the first is held
    assert max(small.graph.edges.second.max(), small.graph.edges.first.max()) == 49


def test_a_drawn_world_stands_in_for_a_file_and_its_row_says_so(monkeypatch, tmp_path):
    pose_graphs._whole.cache_clear()
    monkeypatch.setattr(pose_graphs, "DATA", tmp_path)
    assert pose_graphs.title("CSAIL") == "graph_csail_drawn"
    graph = pose_graphs.published("CSAIL", 2_000).graph
    assert (len(graph.poses), len(graph.edges)) == pose_graphs.PUBLISHED["CSAIL"]
    pose_graphs._whole.cache_clear()
    (tmp_path / "posegraphs").mkdir()
    (tmp_path / "posegraphs" / "CSAIL.g2o").touch()
    assert pose_graphs.title("CSAIL") == "graph_csail"


@pytest.mark.parametrize("reckoned", [False, True])
def test_maps_have_the_noise_they_are_told(reckoned):
    work = landmarks.draw(200, reckoned=reckoned)
    assert (len(work.poses), len(work.places)) == (200, 30)
    (means, _), (places, _) = pgm_maps.marginals(work).call()
    poses = np.concatenate([work.poses[:1], means])
    moved = motion.relative(poses[:-1], poses[1:]) - work.odometry
    seen = sensors.range_bearing(poses[work.who], places[work.what]) - work.sights
    moved[:, 2], seen[:, 1] = wrapped(moved[:, 2]), wrapped(seen[:, 1])
    squares = np.concatenate(
        [(moved / landmarks.ODOMETRY_STD).ravel(), (seen / landmarks.SIGHT_STD).ravel()]
    )
    assert is_of_right_noise(squares**2, squares.size, 3 * 199 + 2 * 30)
    ranges = work.sights[:, 0]
    assert ranges.min() > landmarks.CLEAR - 0.5
    assert ranges.max() < landmarks.REACH + 0.5
    assert set(work.what.tolist()) == set(range(30))
    assert np.bincount(work.who).max() <= landmarks.SEEN + 3
    if reckoned:
        due = [motion.increment(*pair) for pair in zip(work.poses, work.odometry, strict=False)]
        np.testing.assert_allclose(work.poses[1:], due, rtol=0, atol=1e-12)
        assert np.abs(work.poses[-1, :2] - poses[-1, :2]).max() > 1.0
        first = [work.what.tolist().index(j) for j in range(30)]
        near = sensors.range_bearing(work.poses[work.who[first]], work.places)
        np.testing.assert_allclose(near[:, 0], work.sights[first, 0], rtol=0, atol=1e-12)


def test_three_hundred_landmarks_are_seen_from_two_thousand_poses():
    sizes = {name: BY_NAME[name].size for name in ("landmarks_30", "landmarks_300")}
    assert sizes == {"landmarks_30": 200, "landmarks_300": 2_000}
    work = BY_NAME["landmarks_300"].work(2_000)
    assert (len(work.poses), len(work.places)) == (2_000, 300)


def test_a_declaration_is_of_all_variables_and_readings():
    graph = pgm_maps.declared(fields.grid(10)).call()
    assert len(graph.network.variables) == 100 + 10


def test_maps_are_held_to_deviations_and_to_the_size_of_covariances():
    covs = np.stack([np.eye(3), 1e-4 * np.eye(3)])
    means = np.array([[1.0, 2.0, 3.0], [3.0, 2.0, 3.1]])
    ours, turn = [(means, covs)], np.array([0.0, 0.0, 2.0 * np.pi])

    def off(deviations):
        """The second variable a little off, and all headings told a turn on."""
        return means + turn + np.array([[0.0], [deviations * 1e-2]])

    agreement.maps("gtsam", ours, [(off(0.04), 1.09 * covs)])
    agreement.maps("scipy", ours, [(off(9e-7), None)])
    for library, theirs in (
        ("gtsam", (off(0.06), covs)),
        ("scipy", (off(2e-6), None)),
        ("pgm_compiled", (off(2e-6), covs)),
    ):
        with pytest.raises(AssertionError, match=f"means, in deviations, of {library}"):
            agreement.maps(library, ours, [theirs])
    with pytest.raises(AssertionError, match="covariances of gtsam"):
        agreement.maps("gtsam", ours, [(means, covs * np.array([1.0, 1.11])[:, None, None])])
    with pytest.raises(ValueError, match="shorter"):
        agreement.maps("gtsam", ours, [])


def test_memory_of_a_pose_graph_is_of_each_library_in_its_own_process():
    pytest.importorskip("gtsam", reason="gtsam comes with the extra bench")
    city = next(each for each in memory.LARGE if each.name == "graph_city_memory")
    times, peaks = memory.measure(replace(city, size=60))
    assert set(times) == set(peaks) == {"pgm", "gtsam"}
    assert all(0.0 < each < 60.0 for each in times.values())
    assert all(2**20 < each < 2**30 for each in peaks.values())


def test_a_first_call_of_a_pose_graph_is_told_with_the_second(monkeypatch, capsys):
    monkeypatch.setattr(first_call, "STEPS", 30)
    first_call.graph()
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {"first", "second"}
    assert all(0.0 < each < 60.0 for each in found.values())
