"""Filter, smoother and iterated smoother: the order of their errors, and the bands they keep."""

import json

import numpy as np
import pytest
from scipy.stats import chi2

import pgm
from experiments import smoothing
from experiments.smoothing import experiment
from experiments.smoothing.judging import LOST, gain, judge
from models.networks import pose, sighting

LINEARISERS = {"Taylor", "Unscented", "Cubature"}
KINDS = {"filter", "smoother", "iterated"}


STD = np.array([0.5, 0.25, 0.1])


def unit_belief(away):
    """A belief at 0 with deviations `STD`, and a truth so many of them away on each axis."""
    truth = np.asarray(away, dtype=float)[..., None] * STD
    cov = np.broadcast_to(np.diag(STD**2), (*truth.shape, 3))
    steps = np.arange(truth.shape[-2])
    return pgm.Gaussian(pose, np.zeros_like(truth), cov, steps=steps), truth


def judged(away):
    belief, truth = unit_belief(away)
    found = judge({"one": {"filter": belief}}, truth)
    return {key: by["one"]["filter"] for key, by in found.items()}


def test_errors_of_a_belief_made_by_hand():
    """Four runs of two steps; a truth k deviations away on each axis has a NEES of 3 k²."""
    found = judged([[1, 0], [1, 0], [1, 2], [1, 2]])
    assert found["nees"] == pytest.approx(3 * (4 + 8) / 8)
    assert found["rmse"] == pytest.approx(np.sqrt((0.5**2 + 0.25**2) * 1.5))
    assert found["rmse_heading"] == pytest.approx(0.1 * np.sqrt(1.5))


@pytest.mark.parametrize(
    ("away", "share"),
    [([1, 1, 1, 1], 1.0), ([1, 1, 1, 2], 0.75), ([1, 2, 2, 2], 0.25), ([0, 2, 2, 0.1], 0.0)],
)
def test_the_share_of_steps_whose_mean_nees_is_in_its_band(away, share):
    """Ten runs alike: 3 k² at each step, in the band of χ² with 30 degrees if k = 1 alone."""
    low, high = chi2(30).ppf([0.025, 0.975]) / 10
    assert 3 * 0.1**2 < low < 3 < high < 3 * 2**2
    assert judged(np.tile(away, (10, 1)))["steps_inside"] == share


def test_a_run_is_lost_if_its_mean_nees_is_ten_times_what_is_due():
    assert LOST == 10
    just, past = np.sqrt(10 * 0.99), np.sqrt(10 * 1.01)
    assert judged(np.full((1, 2), just))["lost"] == 0.0
    assert judged([[just, just], [past, past], [0, 0], [past, past]])["lost"] == 0.5
    # The mean over a run's steps decides, not its worst step: 3 (0 + 2 · 9.9) / 2.
    assert judged([[0, np.sqrt(2) * just], [0, np.sqrt(2) * past]])["lost"] == 0.5


def test_the_share_of_truths_inside_the_region():
    """95 % of χ² with 3 degrees is 7.81: k = 1.61 is inside, 1.62 is not."""
    found = judged([[1.61, 1.62], [0.0, 1.61], [1.62, 1.62]])
    assert found["coverage"] == pytest.approx(0.5)
    low, high = found["coverage_interval"]
    assert 0.0 < low < 0.5 < high < 1.0


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


def test_the_tables_have_the_numbers_of_the_summary(quick):
    summary = quick[1]
    errors, consistency, innovations = (
        {tuple(row[:-k]): row[-k:] for row in part["rows"]}
        for part, k in zip((p for p in summary["page"] if "table" in p), (3, 5, 2), strict=True)
    )
    assert (
        set(errors) == set(consistency) == {(rule, kind) for rule in LINEARISERS for kind in KINDS}
    )
    for (rule, kind), cells in consistency.items():
        value = {
            key: summary[key][rule][kind] for key in ("nees", "steps_inside", "coverage", "lost")
        }
        assert cells == [
            f"{value['nees']:.4g}",
            f"{value['steps_inside']:.0%}",
            f"{value['coverage']:.3f}",
            f"{value['lost']:.1%}",
            f"{summary['converged'][rule]:.0%}" if kind == "iterated" else "",
        ]
        change = summary["gain"][rule].get(kind)
        assert errors[rule, kind] == [
            f"{summary['rmse'][rule][kind]:.4g}",
            f"{summary['rmse_heading'][rule][kind]:.4g}",
            f"{change[0]:+.3f} ± {change[1]:.3f}" if change else "",
        ]
    for rule, found in summary["whiteness"].items():
        assert innovations[rule,] == [f"{found['nis']:.4g}", f"{found['probability']:.4g}"]


def test_the_tables_quote_the_band_and_what_a_lost_run_is(quick):
    text = " ".join(part["about"] for part in quick[1]["page"] if "about" in part)
    assert "{:.3f} to {:.3f}; about 95 %".format(*quick[1]["nees_band"]) in text
    assert "mean NEES is more than 30, which" in text


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
        some = {name: belief[rest] for name, belief in kinds.items()}
        without.append(gain(some, drive.truth[rest])["smoother"][0])
    jackknife = np.sqrt(11 / 12 * np.sum((np.array(without) - np.mean(without)) ** 2))
    assert error == pytest.approx(jackknife, rel=0.3)


def test_the_same_seed_gives_the_same_numbers():
    first, second, other = (experiment.simulate(seed, 3, 20)[1].truth for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, other)
