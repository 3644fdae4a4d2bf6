"""Pose graphs: settings of one's own, the optimum beside least squares, and false closures."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares

import pgm
from experiments import pose_graphs
from experiments.pose_graphs import given
from experiments.pose_graphs.drawn import APART, NEAR, STD, manhattan, with_false
from experiments.pose_graphs.experiment import ROBUST, misled
from experiments.pose_graphs.given import drawn, find, published
from experiments.pose_graphs.solving import prepared, solve
from models import motion
from tests.models.test_pose_graphs import residuals, written

GUIDE = Path(__file__).parents[2] / "docs" / "guide" / "recordings.md"


@pytest.fixture(scope="module")
def town():
    return drawn(50, np.random.default_rng(2))


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    out = tmp_path_factory.mktemp("pose_graphs")
    pose_graphs.run(out=out, seed=0, **pose_graphs.QUICK)
    return out, json.loads((out / "summary.json").read_text())


def results(out, **settings):
    pose_graphs.run(out=out, linearisers="Taylor", **settings)
    return json.loads((out / "summary.json").read_text())["results"]


def settings_of_the_guide():
    (found,) = re.findall(r"```toml\n(path = \"killian-small.*?)```", GUIDE.read_text(), re.S)
    return found


def test_a_graph_with_the_guides_settings(tmp_path):
    (tmp_path / "killian-small.toro").write_text(written())
    file = tmp_path / "own.toml"
    file.write_text(settings_of_the_guide())
    found = results(tmp_path / "out", settings=file)["killian-small"]
    ends = [found["solved"][start]["Taylor"] for start in found["solved"]]
    assert len(ends) == 2
    assert ends[0]["error"] == pytest.approx(ends[1]["error"])
    assert ends[0]["error"] < 0.2 * min(found["before"].values())
    assert all(each["converged"] for each in ends)
    file.write_text(file.read_text() + "gate = 0.9\n")
    with pytest.raises(
        pgm.errors.FileError, match=r"methods.gate is unknown; known are iterations"
    ):
        results(tmp_path / "out", settings=file)


def test_a_file_is_named_by_its_own_name(tmp_path):
    path = tmp_path / "square.g2o"
    path.write_text(written())
    found = results(tmp_path / "out", path=path)
    assert list(found) == ["square"]
    page = json.loads((tmp_path / "out" / "summary.json").read_text())["page"]
    pictures = [part["figure"] for part in page if "figure" in part]
    assert pictures == ["square_poses.png", "square_errors.png"]


def test_the_optimum_is_that_of_least_squares(town):
    graph = town.graph
    count = len(graph.poses)

    def of(v):
        return residuals(graph, np.vstack([graph.poses[0], v.reshape(-1, 3)]), graph.landmarks)

    due = least_squares(of, graph.poses[1:].ravel(), xtol=1e-14, ftol=1e-14)
    ready = prepared(graph)
    solved = solve(ready, (graph.poses, graph.landmarks))
    assert solved.status.converged.all()
    assert solved.errors.sum() == pytest.approx(2.0 * due.cost, rel=1e-8)
    assert_allclose(solved.poses[1:].ravel(), due.x, atol=1e-6)
    cov = np.linalg.inv(due.jac.T @ due.jac)
    for k in (0, count // 2, count - 2):
        own = cov[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        assert_allclose(solved.covs[k + 1], own, rtol=1e-3, atol=1e-7)
    # χ² of right noise has as many degrees as components are told beyond those that are free.
    degrees = 3 * len(graph.edges) - 3 * (count - 1)
    assert abs(solved.errors.sum() - degrees) < 4.0 * np.sqrt(2.0 * degrees)


def test_a_drawn_town_is_what_its_edges_say(town):
    graph, truth = town.graph, town.truth
    edges = graph.edges
    assert_allclose(np.abs(truth[:, :2] - truth[:, :2].round()), 0.0, atol=1e-12)
    step = np.diff(truth, axis=0)
    assert_allclose(np.hypot(step[:, 0], step[:, 1]), 1.0)
    assert_allclose(step[:, 0], np.cos(truth[1:, 2]), atol=1e-12)
    assert_allclose(step[:, 1], np.sin(truth[1:, 2]), atol=1e-12)
    away = edges.motions - motion.relative(truth[edges.first], truth[edges.second])
    away[:, 2] = (away[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    assert_allclose(away.std(axis=0), STD, rtol=0.25)
    assert (np.abs(away) < 5.0 * np.array(STD)).all()
    loops = graph.loops
    one, other = truth[edges.first[loops]], truth[edges.second[loops]]
    assert np.linalg.norm((one - other)[:, :2], axis=1).max() <= NEAR
    assert (edges.first[loops] - edges.second[loops]).min() >= APART
    assert_array_equal(graph.poses[0], truth[0])
    assert np.linalg.norm(graph.poses[-1, :2] - truth[-1, :2]) > 0.05


def test_poses_know_their_errors():
    """The mean NEES of twelve towns, within four of its own errors of 1."""
    found = []
    for seed in range(12):
        each = drawn(40, np.random.default_rng(seed))
        solved = solve(prepared(each.graph), (each.truth, each.graph.landmarks))
        errors = solved.poses - each.truth
        errors[:, 2] = (errors[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        cov = np.linalg.inv(solved.covs[1:])
        found.append(np.einsum("ni,nij,nj->n", errors[1:], cov, errors[1:]).mean() / 3.0)
    assert abs(np.mean(found) - 1.0) < 4.0 * np.std(found, ddof=1) / np.sqrt(len(found))


def test_false_closures_are_true_ones_told_of_other_poses(town):
    graph = town.graph
    wrong = with_false(graph, 0.5, np.random.default_rng(0))
    count = len(graph.edges)
    false = slice(count, None)
    assert len(wrong.edges) - count == round(0.5 * graph.loops.size)
    for name in ("first", "second", "motions", "information"):
        assert_array_equal(getattr(wrong.edges, name)[:count], getattr(graph.edges, name))
    assert (wrong.edges.first[false] != wrong.edges.second[false]).all()
    told = {tuple(row) for row in graph.edges.motions[graph.loops].tolist()}
    assert {tuple(row) for row in wrong.edges.motions[false].tolist()} <= told
    ends = town.truth[wrong.edges.first[false]], town.truth[wrong.edges.second[false]]
    off = motion.relative(*ends) - wrong.edges.motions[false]
    assert np.median(np.linalg.norm(off[:, :2], axis=1)) > 1.0
    again = with_false(graph, 0.5, np.random.default_rng(0))
    assert_array_equal(again.edges.first, wrong.edges.first)
    other = with_false(graph, 0.5, np.random.default_rng(1))
    assert not np.array_equal(other.edges.first, wrong.edges.first)


def test_a_graph_without_closures_has_none_to_take_for_others():
    graph, _ = manhattan(APART, np.random.default_rng(0))
    with pytest.raises(pgm.EvidenceError, match="no loop closures that could be taken for others"):
        with_false(graph, 0.1, np.random.default_rng(0))


def test_false_closures_mislead_least_squares_alone(quick):
    (found,) = quick[1]["results"].values()
    each = found["against_truth"]
    right, plain = each["right closures"], each["least squares"]
    assert right["settled"] == "yes"
    assert right["moved"] == 0.0
    assert plain["rmse"] > 3.0 * right["rmse"]
    assert plain["error"] > 3.0 * found["due"]
    assert plain["false_used"] == 1.0
    truncated = each["truncated least squares"]
    assert truncated["settled"] == "yes"
    assert truncated["moved"] < 1.0
    assert truncated["false_used"] == 0.0
    assert truncated["right_left_out"] < 0.02
    assert truncated["rmse"] < 1.1 * right["rmse"]


@pytest.mark.slow
def test_a_tenth_of_false_closures_moves_manhattan_by_less_than_a_deviation():
    path = find("m3500")
    if path is None:
        pytest.skip("the pose graph m3500 is not here; PGM_DATA may name its folder's folder")
    each = published("m3500", path)
    right = solve(prepared(each.graph), (each.graph.poses, each.graph.landmarks))
    wrong = with_false(each.graph, 0.1, np.random.default_rng(0))
    led = misled(each, wrong, ROBUST["truncated least squares"])
    assert led.status.converged.all()
    off = led.poses - right.poses
    off[:, 2] = (off[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    assert (np.abs(off[1:]) / right.beliefs[1:].std).max() < 1.0


def test_the_page_has_figures_and_tables(quick):
    out, summary = quick
    figures = [part["figure"] for part in summary["page"] if "figure" in part]
    assert figures == [f"drawn_{name}.png" for name in ("poses", "errors", "false")]
    for name in figures:
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    tables = [part for part in summary["page"] if "table" in part]
    assert [len(part["rows"]) for part in tables] == [2, 5]


def test_a_published_graph():
    path = find("CSAIL")
    if path is None:
        pytest.skip("the pose graph CSAIL is not here; PGM_DATA may name its folder's folder")
    graph = published("CSAIL", path).graph
    solved = solve(prepared(graph), (graph.poses, graph.landmarks))
    assert solved.status.converged.all()
    assert solved.errors.sum() == pytest.approx(40.5551, abs=1e-3)


@pytest.mark.slow
def test_manhattan_has_the_published_optimum():
    path = find("m3500")
    if path is None:
        pytest.skip("the pose graph m3500 is not here; PGM_DATA may name its folder's folder")
    each = published("m3500", path)
    solved = solve(prepared(each.graph), (each.graph.poses, each.graph.landmarks))
    assert solved.status.converged.all()
    assert solved.errors.sum() == pytest.approx(each.optimum, abs=5e-4)


def test_graphs_that_are_not_here_are_told(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("PGM_DATA", str(tmp_path))
    assert given.find("m3500") is None
    pose_graphs.run(out=tmp_path / "out", data="m3500")
    told = " ".join(capsys.readouterr().out.split())
    assert "m3500 is not here; --path, or the folder posegraphs" in told
    assert not (tmp_path / "out").exists()


def test_refusals(tmp_path):
    with pytest.raises(pgm.EvidenceError, match="is not a pose graph: drawn, CSAIL"):
        pose_graphs.run(data="moon")
    with pytest.raises(pgm.EvidenceError, match="is not a lineariser"):
        pose_graphs.run(linearisers="Tailor")
    with pytest.raises(pgm.EvidenceError, match="--data drawn is not; leave it out"):
        pose_graphs.run(data="drawn", path=tmp_path)
