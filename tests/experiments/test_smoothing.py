"""Filter, smoother and iterated smoother: the order of their errors, and the bands they keep."""

import json

import numpy as np
import pytest
from scipy.stats import chi2

from experiments import smoothing
from experiments.smoothing import experiment
from experiments.smoothing.judging import gain, judge
from models.networks import sighting

LINEARISERS = {"Taylor", "Unscented", "Cubature"}
KINDS = {"filter", "smoother", "iterated"}


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    out = tmp_path_factory.mktemp("smoothing")
    smoothing.run(out=out, seed=0, **smoothing.QUICK)
    return out, json.loads((out / "summary.json").read_text())


@pytest.mark.parametrize("key", ["rmse", "rmse_heading", "nees", "steps_inside", "coverage"])
def test_every_statistic_is_there_and_finite(quick, key):
    found = quick[1][key]
    assert set(found) == LINEARISERS
    for kinds in found.values():
        assert set(kinds) == KINDS
        assert all(np.isfinite(value) and value > 0.0 for value in kinds.values())


def test_smoothing_beats_filtering(quick):
    summary = quick[1]
    for key in ("rmse", "rmse_heading"):
        for kinds in summary[key].values():
            assert kinds["smoother"] < kinds["filter"]
            assert kinds["iterated"] < kinds["filter"]
    for name, found in summary["gain"].items():
        change, error = found["smoother"]
        assert change < -3 * error
        difference = summary["rmse"][name]["smoother"] - summary["rmse"][name]["filter"]
        assert change == pytest.approx(difference)


def test_the_band_is_that_of_scipy(quick):
    summary = quick[1]
    runs = smoothing.QUICK["runs"]
    due = chi2(3 * runs).ppf([0.025, 0.975]) / runs
    assert summary["nees_band"] == pytest.approx(due)


def test_coverage_is_inside_its_own_interval(quick):
    summary = quick[1]
    for name, kinds in summary["coverage"].items():
        for kind, value in kinds.items():
            low, high = summary["coverage_interval"][name][kind]
            assert low < value < high
            assert value > 0.85


def test_iterating_settles_and_does_not_depend_on_the_lineariser(quick):
    summary = quick[1]
    assert all(0.5 < share <= 1.0 for share in summary["converged"].values())
    once, often = (
        [summary["rmse"][name][kind] for name in LINEARISERS] for kind in ("filter", "iterated")
    )
    assert np.ptp(often) < np.ptp(once)


def test_the_page_has_figures_tables_and_captions(quick):
    out, summary = quick
    figures = [part for part in summary["page"] if "figure" in part]
    names = ["rmse", "nees", "coverage", "innovations", "convergence"]
    assert [part["figure"] for part in figures] == [f"{name}.png" for name in names]
    assert all(len(part["caption"]) > 40 for part in figures)
    for name in names:
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    rows = next(part for part in summary["page"] if part.get("table") == "Consistency")["rows"]
    assert len(rows) == 9


def test_readings_are_those_within_reach_of_the_commanded_path():
    _, drive = experiment.simulate(3, 2, 100)
    found = drive.evidence[sighting]
    angle = experiment.TURN * experiment.DT * np.arange(101)
    radius = experiment.SPEED / experiment.TURN
    path = radius * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=-1)
    away = np.linalg.norm(path[:, None] - experiment.LANDMARKS, axis=-1)
    steps, landmarks = np.nonzero(away <= experiment.REACH)
    np.testing.assert_array_equal(found.step, steps)
    (seen,) = found.given.values()
    np.testing.assert_allclose(seen, experiment.LANDMARKS[landmarks])
    assert np.shape(found.values) == (2, steps.size, 2)
    assert np.isfinite(found.values).all()


def test_the_gain_is_a_paired_difference():
    network, drive = experiment.simulate(1, 12, 20)
    beliefs, _, _ = experiment.estimate(network, drive, 2)
    kinds = beliefs["Taylor"]
    change, error = gain(kinds, drive.truth)["smoother"]
    results = judge(beliefs, drive.truth)["rmse"]["Taylor"]
    assert change == pytest.approx(results["smoother"] - results["filter"])
    without = []
    for run in range(12):  # the jackknife
        rest = [k for k in range(12) if k != run]
        some = {name: belief.run(np.array(rest)) for name, belief in kinds.items()}
        without.append(gain(some, drive.truth[rest])["smoother"][0])
    jackknife = np.sqrt(11 / 12 * np.sum((np.array(without) - np.mean(without)) ** 2))
    assert error == pytest.approx(jackknife, rel=0.3)


def test_the_same_seed_gives_the_same_numbers():
    first, second, other = (experiment.simulate(seed, 3, 20)[1].truth for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, other)
