"""Numbers of particles: what is measured, against formulas, and what the page says of it."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from experiments import particle_counts
from experiments.differential_drive.particles import follow
from experiments.differential_drive.problems import problems
from experiments.particle_counts import choices, pages
from experiments.particle_counts.experiment import COUNTS, SHOWN
from experiments.particle_counts.study import Estimate, mean_square, study
from models.networks import wheels


@pytest.fixture(scope="module", params=[pytest.param("quick", marks=pytest.mark.slow)])
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("particle_counts")
    particle_counts.run(out=out, seed=0, **particle_counts.QUICK)
    return out, json.loads((out / "summary.json").read_text())


def test_estimates_have_standard_errors():
    found = Estimate.of(np.array([1.0, 2.0, 6.0]))
    assert found.value == 3.0
    assert found.error == pytest.approx(np.sqrt(7.0 / 3.0))  # (4 + 1 + 9) / 2 / 3
    assert found.root.value == pytest.approx(np.sqrt(3.0))
    assert found.root.error == pytest.approx(found.error / (2.0 * np.sqrt(3.0)))
    assert Estimate(0.0, 0.0).root == Estimate(0.0, 0.0)


def test_the_mean_square_leaves_the_known_start_and_the_heading_out():
    means, truth = np.zeros((2, 3, 3)), np.zeros((2, 3, 3))
    truth[:, 0], truth[:, :, 2] = 9.0, 7.0
    truth[1, 1, :2] = 3.0, 4.0
    assert mean_square(means, truth).tolist() == [0.0, 12.5]


def test_the_kalman_filter_is_the_exact_answer_of_the_linear_problem():
    """Its means are those of least squares over the whole drive, here with one reading."""
    found = study(problems("variance", 1)["1"], 3, (50,), 1000, 0)
    assert found.reference is None
    for axis, (w, r, scale) in enumerate([(0.1, 0.05, 1.0), (0.15, 0.075, 2.0)]):
        gain = w * scale / (scale**2 * w + r)  # variances, after one second
        due = 0.01 + gain * (found.readings[:, 0, axis] - scale * 0.01)
        assert_allclose(found.exact[:, 8, axis], due, rtol=1e-9)


def test_numbers_are_of_the_same_drives():
    found = study(problems("variance", 2)["2a"], 6, (40, 80), 500, 3)
    numbers = found.numbers()
    assert list(numbers) == [
        "extended Kalman",
        "unscented Kalman",
        "40 particles",
        "80 particles",
        "500 particles",
    ]
    best = mean_square(found.exact, found.truth)
    error = mean_square(found.particles[80].mean, found.truth)
    excess = error - best
    each = numbers["80 particles"]
    assert each["rmse"]["value"] == pytest.approx(np.sqrt(error.mean()))
    assert each["excess"]["value"] == pytest.approx(excess.mean())
    assert each["excess"]["error"] == pytest.approx(excess.std(ddof=1) / np.sqrt(6))
    assert each["worse"] == np.mean(excess > 0.0)
    assert found.ratio(each)[0] == pytest.approx(np.sqrt(error.mean() / best.mean()))
    assert numbers["500 particles"]["distance"]["value"] == 0.0
    assert found.distances()[80].value == pytest.approx(each["distance"]["value"])
    assert found.constant() * np.sqrt(1 / 80 + 1 / 500) == pytest.approx(
        found.distances()[80].value
    )
    assert found.own_error() == pytest.approx(found.constant() / np.sqrt(500))


def test_the_slope_takes_the_reference_s_part_away(monkeypatch):
    found = study(problems("variance", 1)["2a"], 2, (10, 100, 1000), 500, 0)
    exact = {n: Estimate(0.7 * np.sqrt(1 / n + 1 / 500), 0.0) for n in (10, 100, 1000)}
    monkeypatch.setattr(type(found), "distances", lambda self: exact)
    assert found.slope() == pytest.approx(-0.5)
    assert found.constant() == pytest.approx(0.7)


def test_following_is_filtering():
    """One step at a time gives what the engine gives over the recorded drives."""
    problem = problems("variance", 2)["2b"]
    evidence = problem.sample(3, np.random.default_rng(1))[1]
    particles = pgm.Particles(2000, seed=4)
    followed = follow(problem, np.asarray(evidence[problem.reading].values), particles)
    whole = pgm.filter(problem.network, evidence, belief=particles)
    assert_allclose(followed.mean, whole[problem.state].mean, atol=1e-12)
    assert_allclose(followed.cov, whole[problem.state].cov, atol=1e-12)
    assert_allclose(followed.log_evidence, whole.log_evidence, atol=1e-9)
    assert (followed.number == 2000).all()


def test_an_unknown_start_is_wide():
    problem = choices.from_unknown(problems("variance", 3)["2a"])
    belief = pgm.filter(problem.network, {wheels: problem.controls})[problem.state]
    assert_allclose(belief.std[0], choices.UNKNOWN)


def test_the_kalman_filter_wins_on_the_linear_problem():
    found = study(problems("variance", 8)["1"], 200, (30, 100), 1000, 0).numbers()
    assert "extended Kalman" not in found
    for count in (30, 100):
        each = found[f"{count} particles"]
        assert each["rmse"]["value"] > found["Kalman filter"]["rmse"]["value"]
        assert each["excess"]["value"] > 4.0 * each["excess"]["error"] > 0.0
        assert each["worse"] > 0.6
    assert "the Kalman filter wins" in pages.winner(found, SHOWN)


def test_no_number_of_particles_beats_the_kalman_filter(done):
    for count in COUNTS:
        excess = done[1]["estimators"]["1"][f"{count:,} particles"]["excess"]
        assert excess["value"] > -3.0 * excess["error"]


def test_distances_fall_as_one_over_the_root(done):
    for name, found in done[1]["estimators"].items():
        distances = [found[f"{count:,} particles"]["distance"]["value"] for count in COUNTS]
        assert (np.diff(distances) < 0.0).all()
        assert -0.8 < done[1]["slope"][name] < -0.3


def test_systematic_draws_are_nearer_than_independent_ones(done):
    found = done[1]["resamplers"]
    assert list(found) == list(choices.RESAMPLERS)
    for key in ("distance", "spread"):
        assert found["systematic"][key]["value"] < found["multinomial"][key]["value"]


def test_numbers_follow_the_belief(done):
    narrow, wide = (
        np.array(done[1]["adapted"][name]["median"]) for name in ("narrow", "shrinking")
    )
    assert narrow[0] == wide[0] == choices.MOST
    assert narrow[1] == choices.LEAST  # a known start is one bin
    assert wide[1] == choices.MOST
    assert wide[-1] < 0.3 * choices.MOST
    for each in done[1]["adapted"].values():
        assert len(each["last"]) == 8
        assert each["lost"] == np.sum(np.array(each["last"]) > choices.LOST)


def test_the_page_shows_everything(done):
    out, summary = done
    files = [part["figure"] for part in summary["page"] if "figure" in part]
    assert files == [
        "errors.png",
        *(f"{kind}_{name}.png" for name in ("1", "2a", "2b") for kind in ("drive", "tracked")),
        "resamplers.png",
        "adapted.png",
    ]
    assert all((out / file).stat().st_size > 1000 for file in files)
    text = " ".join(part["note"] for part in summary["page"] if "note" in part)
    linear = summary["estimators"]["1"]
    assert f"RMSE {linear['Kalman filter']['rmse']['value']:.4f} m of the Kalman filter" in text
    assert f"{linear['100 particles']['rmse']['value']:.4f} m of {SHOWN} particles" in text
    assert pages.winner(linear, SHOWN) in text
    tables = [part for part in summary["page"] if "table" in part]
    assert [len(table["rows"]) for table in tables] == [6, 8, 8, 4]


@pytest.mark.parametrize(
    ("excess", "says"),
    [
        (0.3, "the Kalman filter wins. The excess is above 0 by more than two standard errors"),
        (0.1, "the Kalman filter is not told from them. The excess is within two"),
        (-0.3, "the Kalman filter loses. The excess is below 0 by more than two standard errors"),
    ],
)
def test_the_page_says_who_won(excess, says):
    best = {"rmse": {"value": 1.0, "error": 0.1}, "excess": {"value": 0.0, "error": 0.0}}
    other = {
        "rmse": {"value": 1.1, "error": 0.1},
        "excess": {"value": excess, "error": 0.1},
        "worse": 0.5,
    }
    found = {"Kalman filter": best | {"worse": 0.0}, f"{SHOWN} particles": other}
    assert says in pages.winner(found, SHOWN)
