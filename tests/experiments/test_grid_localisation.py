"""Localisation from an unknown pose, on a grid."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from experiments import grid_localisation
from experiments.grid_localisation import problem
from experiments.grid_localisation.experiment import compared, found_at, judged, settled
from experiments.grid_localisation.figures import moments
from models.networks import pose


@pytest.fixture(scope="module")
def drive():
    return problem.drive(14, np.random.default_rng(0))


@pytest.fixture(scope="module")
def oracle(drive):
    return pgm.smooth(problem.network("unknown"), drive.evidence, belief=problem.grid(0.5, 7.5))


def test_the_wrong_start_is_the_right_one_turned_about_the_first_landmark():
    seen = []
    for start in ("right", "wrong"):
        (east, north, heading), _ = problem.STARTS[start]
        away = problem.LANDMARKS[0] - [east, north]
        bearing = np.arctan2(away[1], away[0]) - heading
        seen.append([np.hypot(*away), np.angle(np.exp(1j * bearing))])
    assert_allclose(seen[0], seen[1], atol=0.01)
    assert seen[0][0] < problem.REACH


def test_one_landmark_leaves_a_ring_and_two_leave_a_place(drive, oracle):
    found = found_at(oracle)
    assert 5 < found < 14
    filtered = oracle.filtered[pose]
    ring, after = filtered[4], filtered[found]
    # It goes round the landmark: narrow along the radius, wide in the plane.
    away = np.hypot(
        *(
            c - at
            for c, at in zip(np.meshgrid(*ring.centres[:2]), problem.LANDMARKS[0], strict=True)
        )
    ).T
    plane = ring.marginal("east", "north").values
    mean = (plane * away).sum()
    assert np.sqrt((plane * (away - mean) ** 2).sum()) < 0.5 < 1.5 < ring.std[0]
    assert np.linalg.norm(after.std[:2]) < 0.5
    assert_allclose(after.mean[:2], drive.truth[found, :2], atol=1.5)
    # The smoother knew it all along.
    assert (np.linalg.norm(oracle[pose].std[:, :2], axis=1) < 1.0).all()


def test_a_wrong_start_is_seen_in_every_figure(drive, oracle):
    found = found_at(oracle)
    right, wrong = (judged(compared(s, drive, oracle), found) for s in ("right", "wrong"))
    for label in problem.LINEARISERS:
        for word in ("filter", "smoother"):
            good, bad = right[label][word], wrong[label][word]
            assert bad["kl_found"] > 10.0 * good["kl_found"]
            assert bad["plane"] > 2.0 * good["plane"]
            assert bad["nees"] > 10.0 * good["nees"]
            assert bad["log_evidence"] < good["log_evidence"] - 20.0
        assert right[label]["smoother"]["settled"] is not None
        assert wrong[label]["filter"]["settled"] is None


@pytest.mark.parametrize(
    ("kl", "due"),
    [([3.0, 0.2, 0.1], 1), ([0.1, 0.2], 0), ([0.1, 3.0], None), ([3.0, 0.1, np.nan, 0.1], 3)],
)
def test_a_divergence_has_settled_where_it_stays_low(kl, due):
    assert settled(np.array(kl)) == due


def test_maps_are_of_steps_that_there_are():
    assert moments(9, 40) == [0, 3, 6, 8, 9, 40]
    assert moments(12, 12) == [0, 3, 8, 11, 12]


@pytest.mark.filterwarnings("ignore:measurements are too sharp")  # its few cells are wide
@pytest.mark.slow
def test_everything_is_written(tmp_path):
    grid_localisation.run(out=tmp_path, seed=0, **grid_localisation.QUICK)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert set(summary["starts"]) == {"unknown", "right", "wrong"}
    for found in (*summary["starts"].values(), summary["alike"]):
        assert set(found) == set(problem.LINEARISERS)
        assert all(each["error"] == "" for by_word in found.values() for each in by_word.values())
    assert summary["grid"]["outside"] < 1e-3
    assert set(summary["grid"]["by_kind"]) == {"filtered", "smoothed"}
    assert (tmp_path / "drive.gif").read_bytes().startswith(b"GIF8")
    for name in ("beliefs", "kl", "alike"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
