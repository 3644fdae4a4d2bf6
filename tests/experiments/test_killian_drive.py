"""The Killian Court drive: its pose graph, the map of half of it, and the other half found."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

import pgm
from experiments import killian
from experiments.killian import drive, graph, localise, log, made_up
from experiments.killian.log import Log
from models import motion
from pgm.errors import FileError
from pgm.maps import log_odds_map
from pgm.recordings import Edges


@pytest.fixture(scope="module")
def simulated():
    return made_up.drive(3)


@pytest.fixture(scope="module")
def driven(simulated):
    return drive.driven(simulated)


@pytest.fixture(scope="module", params=[pytest.param("quick", marks=pytest.mark.slow)])
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("killian")
    killian.run(out=out, seed=0, **killian.QUICK)
    return out, json.loads((out / "summary.json").read_text())


def matrix(pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])


def vector(found):
    return np.array([found[0, 2], found[1, 2], np.arctan2(found[1, 0], found[0, 0])])


def small(rng):
    """Seven poses in a ring, whose edges do not quite fit."""
    turns = np.linspace(0.0, 2.0 * np.pi, 7, endpoint=False)
    poses = np.stack([2.0 * np.cos(turns), 2.0 * np.sin(turns), turns + 2.5], axis=1)
    first, second = np.array([0, 1, 2, 3, 4, 5, 0, 6, 2]), np.array([1, 2, 3, 4, 5, 6, 3, 0, 5])
    motions = motion.relative(poses[first], poses[second])
    motions = motions + rng.normal(scale=0.05, size=motions.shape)
    roots = rng.normal(size=(len(first), 3, 3))
    information = 100.0 * (np.eye(3) + 0.2 * roots @ roots.swapaxes(1, 2))
    poses[1:] += rng.normal(scale=0.05, size=(6, 3))
    edges = Edges(first, second, motions, information)
    return Log(poses, np.ones((7, 2)), np.zeros(2), 50.0, edges)


def test_residuals_are_those_of_matrices(simulated):
    edges, poses = simulated.edges, simulated.poses
    found = graph.residuals(poses, edges)
    for e in (0, 30, 50, 134, 140):
        one, other = matrix(poses[edges.first[e]]), matrix(poses[edges.second[e]])
        due = vector(np.linalg.solve(one, other)) - edges.motions[e]
        due[2] = np.arctan2(np.sin(due[2]), np.cos(due[2]))
        assert_allclose(found[e], due, atol=1e-12)


def test_the_optimum_is_that_of_least_squares():
    recording = small(np.random.default_rng(2))
    edges = recording.edges
    roots = np.linalg.cholesky(edges.information)

    def weighted(free):
        poses = np.concatenate([recording.poses[:1], free.reshape(-1, 3)])
        away = []
        for e, (i, j) in enumerate(zip(edges.first, edges.second, strict=True)):
            due = matrix(edges.motions[e])
            apart = vector(np.linalg.solve(matrix(poses[i]), matrix(poses[j]))) - vector(due)
            apart[2] = np.arctan2(np.sin(apart[2]), np.cos(apart[2]))
            away.append(roots[e].T @ apart)
        return np.concatenate(away)

    start = recording.poses[1:].ravel()
    best = least_squares(weighted, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    found = graph.fitted(recording)
    assert found.before == pytest.approx((weighted(start) ** 2).sum())
    assert found.after == pytest.approx(2.0 * best.cost, rel=1e-9)
    assert found.after < 0.9 * found.before
    assert_allclose(found.poses[1:].ravel(), best.x, atol=1e-6)
    assert found.poses[0].tolist() == recording.poses[0].tolist()
    assert_allclose(found.moved, np.abs(found.poses - recording.poses).max(axis=0))


def test_a_path_is_made_of_its_motions(simulated):
    at = matrix(simulated.poses[0])
    motions = simulated.edges.motions[:40]
    for each in motions:
        at = at @ matrix(each)
    last = graph.reckoned(simulated.poses[0], motions)[-1]
    assert_allclose(matrix(last), at, atol=1e-12)


def test_a_made_up_drive_survives_its_file(simulated, tmp_path):
    lines = []
    for pose, ranges in zip(simulated.poses.tolist(), simulated.scans.tolist(), strict=True):
        lines.append(f"VERTEX_SE2 {len(lines) // 2} " + " ".join(map(repr, pose)))
        start, step = simulated.angles[0], simulated.angles[1] - simulated.angles[0]
        head = f"ROBOTLASER1 0 {start} {np.pi} {step} {simulated.most} 0.1 0 {len(ranges)}"
        lines.append(" ".join([head, *map(repr, ranges), *["0"] * 15]))
    edges = simulated.edges
    upper = edges.information[:, *np.triu_indices(3)]
    for i, j, told, each in zip(edges.first, edges.second, edges.motions, upper, strict=True):
        lines.append(" ".join(map(str, ("EDGE_SE2", i, j, *told.tolist(), *each.tolist()))))
    path = tmp_path / "made_up.g2o"
    path.write_text("\n".join(lines))
    found = log.load(path)
    for name in ("poses", "scans", "angles"):
        assert_allclose(getattr(found, name), getattr(simulated, name), atol=1e-12)
    for name in ("first", "second", "motions", "information"):
        assert_allclose(getattr(found.edges, name), getattr(edges, name), atol=1e-12)


def test_half_of_the_scans_are_the_map(simulated, driven):
    due = log_odds_map(
        simulated.poses[::2], simulated.scans[::2], simulated.angles, resolution=0.1, most=50.0
    )
    assert_allclose(driven.map.occupied, due.occupied)
    assert driven.poses.tolist() == simulated.poses[1::2].tolist()
    assert driven.scans.shape == (68, 180)
    assert driven.motions.shape == (67, 3)


def test_motions_are_two_edges_each_in_any_order(simulated):
    edges = simulated.edges
    order = np.random.default_rng(1).permutation(len(edges.first))
    mixed = Edges(*(getattr(edges, name)[order] for name in vars(edges)))
    found = drive.driven(Log(*(vars(simulated) | {"edges": mixed}).values()))
    for k in (0, 20, 66):
        due = matrix(edges.motions[2 * k + 1]) @ matrix(edges.motions[2 * k + 2])
        assert_allclose(matrix(found.motions[k]), due, atol=1e-12)
    assert_allclose(found.cov, 2.0 * np.diag(np.square(made_up.MOTION_STD)))


def test_distances_and_evidence_are_of_the_steps(driven):
    assert driven.distance[0] == 0.0
    assert driven.distance[2] == pytest.approx(
        np.hypot(*(driven.poses[1] - driven.poses[0])[:2])
        + np.hypot(*(driven.poses[2] - driven.poses[1])[:2])
    )
    part = driven.evidence(4, 9)
    moved, seen = part[drive.step_made], part[driven.scan]
    assert moved.tolist() == driven.motions[4:9].tolist()
    assert np.asarray(seen.values).tolist() == driven.scans[4:10].tolist()
    assert len(np.asarray(driven.evidence()[driven.scan].values)) == 68


@pytest.mark.parametrize("keep", [slice(0, 18), slice(1, None)])
def test_a_drive_that_does_not_hang_together_is_refused(simulated, keep):
    edges = Edges(*(getattr(simulated.edges, name)[keep] for name in vars(simulated.edges)))
    poses = 19 if keep.stop else len(simulated.poses)
    short = Log(simulated.poses[:poses], simulated.scans[:poses], simulated.angles, 50.0, edges)
    with pytest.raises(FileError, match=r"20 poses or more, and one edge between each two"):
        drive.driven(short)


@pytest.mark.parametrize(
    ("distance", "found"),
    [([3.0, 0.5, 0.4], 1), ([0.1, 0.2, 0.3], 0), ([0.1, 2.0, 0.3], 2), ([3.0, 0.5, 2.0], None)],
)
def test_a_pose_is_found_from_where_it_stays(distance, found):
    followed = SimpleNamespace(distance=np.array(distance))
    assert localise.Stray(0, followed, {}).found_at == found


def test_errors_are_of_places_and_headings():
    found = localise.errors(np.array([[3.0, 4.0, 0.1], [0.0, 1.0, -0.1], [0.0, 0.0, 0.1]]))
    assert found["rmse"] == pytest.approx(np.sqrt(26.0 / 3.0))
    assert (found["median"], found["largest"]) == (1.0, 5.0)
    assert found["heading"] == pytest.approx(0.1)


def test_scans_hold_the_drive_where_odometry_does_not(done):
    found = done[1]
    assert found["particles"]["rmse"] < 0.1 < 0.2 < found["dead_reckoning"]["rmse"]
    assert found["particles"]["nees"] < 4.0
    assert found["graph"]["after"] == pytest.approx(found["graph"]["before"])
    assert set(found["part"]) == {"grid", "particles"}
    for each in found["part"].values():
        assert each["median"] < 0.4
    assert sum(step is not None for step in found["starts"].values()) >= 2


def test_the_page_shows_everything(done):
    out, summary = done
    files = [part["figure"] for part in summary["page"] if "figure" in part]
    names = ("map", "errors", "zoom", "anywhere", "starts", "grid")
    assert files == [f"{name}.png" for name in names]
    assert all((out / file).stat().st_size > 1000 for file in files)
    text = " ".join(part["note"] for part in summary["page"] if "note" in part)
    for told in ("made up", "no ground truth", "No Gaussian filter", "they are an optimum already"):
        assert told in text
    assert len([part for part in summary["page"] if "table" in part]) == 3


def test_without_the_recording_it_says_so(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(log, "find", lambda: None)
    killian.run(out=tmp_path / "none", seed=0)
    told = " ".join(capsys.readouterr().out.split())
    assert "killian: the package rtb-data, which carries the Killian Court recording" in told
    assert "pip install 'rtb-data>=2.0'" in told
    assert not (tmp_path / "none").exists()


def test_what_cannot_be_run_is_refused(tmp_path, driven):
    with pytest.raises(pgm.EvidenceError, match="--path names a recording, --data made_up none"):
        killian.run(out=tmp_path, seed=0, data="made_up", path=tmp_path)
    with pytest.raises(pgm.EvidenceError, match="begins at step 67, and the drive has 67 steps"):
        localise.gridded(driven, 67, 0.5, 1000, 0)


@pytest.mark.slow
def test_the_recording_s_poses_are_an_optimum():
    """Least squares over its edges hardly moves them, while odometry alone leads far astray."""
    if log.find() is None:
        pytest.skip("the recording comes with rtb-data, which is not installed")
    recording = log.load()
    found = graph.fitted(recording)
    assert found.before == pytest.approx(1034.07, abs=0.01)
    assert found.before - 2.0 < found.after < found.before
    assert (found.moved < [0.02, 0.02, 0.02]).all()
    halved = drive.driven(recording)
    away = np.linalg.norm((halved.dead_reckoning - halved.poses)[:, :2], axis=1)
    assert away.max() > 100.0
