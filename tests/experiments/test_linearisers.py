import json
from types import SimpleNamespace

import numpy as np
import pytest

import pgm
from experiments import linearisers
from experiments.linearisers import accuracy, timing
from experiments.linearisers.accuracy import REPORT, Trial
from experiments.linearisers.settings import SETTINGS, Setting
from models.networks import pose, pose_fix

SPEED, TURN = 1.0, 0.5
TECHNIQUES = {"MC100", "MC10", "Taylor", "Unscented"}
MEAN = np.zeros(3)


# A dense twin, from the equations: 3.12 for the motion, 7.15 to 7.25 for the regression, the
# information form of the update, and 8.4 for the divergence, the difference of headings wrapped.
def drive(x):
    radius, heading = SPEED / TURN, x[..., 2]
    return np.stack(
        [
            x[..., 0] - radius * np.sin(heading) + radius * np.sin(heading + TURN),
            x[..., 1] + radius * np.cos(heading) - radius * np.cos(heading + TURN),
            heading + TURN,
        ],
        axis=-1,
    )


def square(std):
    return np.diag(np.square(std))


def regression(setting, x, mean_weights, cov_weights):
    """F, b and Σ_n from points (..., N, 3) and the prior's own moments."""
    cov = square(setting.start)
    y = drive(x)
    y_mean = np.einsum("k,...ki->...i", mean_weights, y)
    dx, dy = x - MEAN, y - y_mean[..., None, :]
    cross = np.einsum("k,...ki,...kj->...ij", cov_weights, dx, dy)
    spread = np.einsum("k,...ki,...kj->...ij", cov_weights, dy, dy)
    F = np.swapaxes(cross, -1, -2) @ np.linalg.inv(cov)
    return F, y_mean - F @ MEAN, spread - F @ cov @ np.swapaxes(F, -1, -2)


def taylor(setting):
    radius = SPEED / TURN
    F = np.eye(3)
    F[:2, 2] = radius * (np.cos(TURN) - 1.0), radius * np.sin(TURN)
    return F, drive(MEAN), np.zeros((3, 3))


def unscented(setting):
    """The report's λ = n − 1 = 2, κ = 0, β = 2, so that α² = 5/3."""
    arms = np.sqrt(3.0 + 2.0) * np.diag(setting.start)
    mean_weights = np.array([2.0 / 5.0] + 6 * [1.0 / 10.0])
    cov_weights = mean_weights + np.array([1.0 - 5.0 / 3.0 + 2.0] + 6 * [0.0])
    return regression(
        setting, np.vstack([MEAN, MEAN + arms, MEAN - arms]), mean_weights, cov_weights
    )


def predict(setting, affine):
    F, b, noise = affine
    spread = F @ square(setting.start) @ np.swapaxes(F, -1, -2)
    return F @ MEAN + b, spread + noise + square(setting.motion)


def update(setting, mean, cov, z):
    H, information = np.eye(len(setting.sensor), 3), np.linalg.inv(square(setting.sensor))
    before = np.linalg.inv(cov)
    after = np.linalg.inv(before + H.T @ information @ H)
    h = np.einsum("...ij,...j->...i", before, mean) + z @ (information @ H)
    return np.einsum("...ij,...j->...i", after, h), after


def divergence(mean, cov, other_mean, other_cov, wrap=True):
    inverse, d = np.linalg.inv(other_cov), other_mean - mean
    if wrap:
        d[..., 2] = np.mod(d[..., 2] + np.pi, 2.0 * np.pi) - np.pi
    ratio = np.linalg.slogdet(other_cov)[1] - np.linalg.slogdet(cov)[1]
    trace = np.einsum("...ij,...ji->...", inverse, cov)
    return 0.5 * (ratio - 3.0 + trace + np.einsum("...i,...ij,...j->...", d, inverse, d))


def moved(setting):
    """The exact moments of the moved prior: θ is normal, so that E exp(ikθ) = exp(−k²s²/2)."""
    p, s = setting.start[0], setting.start[2]
    chord, course = 2.0 * SPEED / TURN * np.sin(TURN / 2.0), TURN / 2.0
    one, two = np.exp(-(s**2) / 2.0), np.exp(-2.0 * s**2)
    cos, sin = np.cos(course), np.sin(course)
    mean = np.array([chord * one * cos, chord * one * sin, TURN])
    cov = np.zeros((3, 3))
    cov[0, 0] = p**2 + chord**2 * ((1.0 + two * np.cos(TURN)) / 2.0 - (one * cos) ** 2)
    cov[1, 1] = p**2 + chord**2 * ((1.0 - two * np.cos(TURN)) / 2.0 - (one * sin) ** 2)
    cov[0, 1] = cov[1, 0] = chord**2 * (two * np.sin(TURN) / 2.0 - one**2 * cos * sin)
    cov[0, 2] = cov[2, 0] = -chord * s**2 * one * sin
    cov[1, 2] = cov[2, 1] = chord * s**2 * one * cos
    cov[2, 2] = s**2
    return mean, cov


def twin_averages(setting, runs, seed):
    """Averages and standard errors by the twin alone, with draws of its own and the exact truth."""
    rng = np.random.default_rng(seed)

    def draw(std, *shape):
        return np.asarray(std) * rng.standard_normal((*shape, len(std)))

    z = drive(draw(setting.start, runs)) + draw(setting.motion, runs)
    z = z[:, : len(setting.sensor)] + draw(setting.sensor, runs)
    mean, cov = moved(setting)
    truth = update(setting, mean, cov + square(setting.motion), z)
    affine = {"Taylor": taylor(setting), "Unscented": unscented(setting)}
    for n in (100, 10):
        weights = np.full(n, 1.0 / n)
        affine[f"MC{n}"] = regression(setting, draw(setting.start, runs, n), weights, weights)
    values = {
        name: divergence(*truth, *update(setting, *predict(setting, each), z))
        for name, each in affine.items()
    }
    return {name: (v.mean(), v.std() / np.sqrt(runs)) for name, v in values.items()}


class Recorder:
    """A lineariser that keeps the points at which its rule calls the function."""

    def __init__(self, rule):
        self.rule = rule

    def __call__(self, function, at):
        calls = []

        class Spy:
            def __call__(self, x):
                calls.append(x)
                return function(x)

            def __getattr__(self, name):
                return getattr(function, name)

        affine = self.rule(Spy(), at)
        self.points = calls[0]
        return affine


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("linearisers")
    linearisers.run(out=out, seed=0, **linearisers.QUICK)
    return out, json.loads((out / "summary.json").read_text())


@pytest.fixture(scope="module", params=SETTINGS)
def case(request):
    setting = SETTINGS[request.param]
    trial = Trial.draw(setting, 300, 20_000, seed=5)
    z = trial.sample[setting.reading][:, 0]
    best = trial.best.predicted[pose.at(1)].run(0)
    return SimpleNamespace(setting=setting, trial=trial, z=z, predicted=(best.mean, best.cov))


@pytest.mark.parametrize("samples", [10, 100])
def test_monte_carlo_is_the_equations_in_each_simulation(case, samples):
    setting, recorder = case.setting, Recorder(accuracy.monte_carlo(samples, seed=3))
    outcome = case.trial.filter(recorder)
    points = recorder.points[:, -samples:]
    assert len(np.unique(points[:, 0, 2])) == 300  # each simulation has its own
    weights = np.full(samples, 1.0 / samples)
    affine = regression(setting, points, weights, weights)
    agree(case, outcome, affine)
    indefinite = np.linalg.eigvalsh(affine[2] + square(setting.motion))[:, 0] < 0.0
    assert outcome.indefinite == indefinite.mean() > 0.0
    assert np.linalg.eigvalsh(predict(setting, affine)[1]).min() > 0.0


@pytest.mark.parametrize(("rule", "twin"), [(pgm.Taylor(), taylor), (pgm.Unscented(), unscented)])
def test_deterministic_rules_are_the_equations(case, rule, twin):
    outcome = case.trial.filter(rule)
    agree(case, outcome, twin(case.setting))
    assert outcome.indefinite == 0.0


def agree(case, outcome, affine):
    belief = outcome.posterior[pose.at(1)]
    mean, cov = update(case.setting, *predict(case.setting, affine), case.z)
    assert np.abs(belief.mean - mean).max() < 1e-8
    assert np.abs(belief.cov - cov).max() < 1e-8
    truth = update(case.setting, *case.predicted, case.z)
    assert outcome.divergence == pytest.approx(divergence(*truth, mean, cov), rel=1e-6, abs=1e-9)
    assert outcome.mean == pytest.approx(outcome.divergence.sum() / 300)
    unwrapped = divergence(*truth, mean, cov, wrap=False).mean()
    assert outcome.unwrapped == pytest.approx(unwrapped, rel=1e-6, abs=1e-9)
    assert outcome.standard_error == pytest.approx(np.std(outcome.divergence) / np.sqrt(299))


def test_wrapping_the_difference_of_headings_alters_an_average():
    trial = Trial.draw(SETTINGS["R1"], 10_000, 20_000, seed=0)
    outcome = trial.filter(accuracy.rules(0)["MC10"])
    best, found = trial.best[pose.at(1)], outcome.posterior[pose.at(1)]
    wrapped, plain = (
        divergence(best.mean, best.cov, found.mean, found.cov, wrap=wrap).mean()
        for wrap in (True, False)
    )
    assert outcome.mean == pytest.approx(wrapped, rel=1e-6)
    assert outcome.unwrapped == pytest.approx(plain, rel=1e-6)
    assert wrapped < 0.999 * plain


@pytest.mark.parametrize("name", SETTINGS)
def test_the_truth_has_the_exact_moments(name):
    setting = SETTINGS[name]
    samples = 400_000
    trial = Trial.draw(setting, 2, samples, seed=0)
    best = trial.best.predicted[pose.at(1)]
    mean, cov = moved(setting)
    scale = np.sqrt(np.diag(cov))
    assert (np.abs(best.mean - mean) / scale).max() < 5.0 / np.sqrt(samples)
    off = np.abs(best.cov - cov - square(setting.motion)) / np.outer(scale, scale)
    # A product of two deviations has a variance of at most about twice its scale squared.
    assert off.max() < 5.0 * np.sqrt(2.0 / samples)


def test_averages_are_those_of_a_twin_with_its_own_draws(done):
    summary = done[1]
    for name, ours in {**summary["table_8_1"], "mild": summary["contrast"]["mean"]}.items():
        errors = (
            summary["contrast"]["standard_error"]
            if name == "mild"
            else summary["table_8_1_se"][name]
        )
        assert set(ours) == set(errors) == TECHNIQUES
        for technique, (mean, error) in twin_averages(SETTINGS[name], 2000, seed=1).items():
            # The truth of the quick run is itself of 20,000 samples.
            slack = 4.0 * np.hypot(error, errors[technique]) + 3.0 / 20_000
            assert ours[technique] == pytest.approx(mean, abs=slack), (name, technique)
            assert 0.0 < errors[technique] < 0.5 * ours[technique]


def test_medians_and_indefinite_noise_are_reported(done):
    summary = done[1]
    for name in ("R1", "R2"):
        medians, means = summary["table_8_1_median"][name], summary["table_8_1"][name]
        assert all(0.0 < medians[k] < means[k] for k in TECHNIQUES)
        shares = summary["indefinite_noise"][name]
        assert shares["Taylor"] == shares["Unscented"] == 0.0
        assert 0.05 < shares["MC100"] < shares["MC10"] < 0.75


def test_the_order_is_another_where_headings_are_known(done):
    contrast = done[1]["contrast"]["mean"]
    assert max(contrast["Taylor"], contrast["Unscented"]) < 0.05 * contrast["MC100"]


def test_error_falls_as_one_over_the_samples(done):
    table = done[1]["error_by_samples"]
    for n, each in table.items():
        assert each["times_samples"] == pytest.approx(int(n) * each["mean"])
        if int(n) >= 30:
            slack = 4.0 * int(n) * each["standard_error"] + int(n) * 2.0 / 20_000
            assert each["times_samples"] == pytest.approx(0.58, abs=slack)
    product = np.prod([each["times_samples"] for n, each in table.items() if int(n) >= 30])
    assert done[1]["error_constant"] == pytest.approx(product ** (1.0 / 5.0))


def test_times_are_positive_and_grow_with_many_samples(done):
    summary = done[1]
    step, part = summary["table_8_2"], summary["table_8_2_linearisation"]
    assert list(step["by_technique"]) == list(timing.REPORT)
    assert list(step["by_samples"]) == [str(n) for n in timing.SAMPLES]
    assert step["by_samples"]["10"] == step["by_technique"]["MC10"]
    assert step["by_samples"]["100000"] > step["by_samples"]["1000"]
    for kind in ("by_technique", "by_samples"):
        assert all(0.0 < part[kind][name] < t for name, t in step[kind].items())
    assert set(summary["table_8_2_batch"]) == TECHNIQUES
    assert min(summary["table_8_2_batch"].values()) > 0.0
    assert set(summary["trend"]) == {"step", "linearisation"}


def test_a_line_is_found_again():
    due = timing.Line(3e-4, 2e-7)
    found = timing.fit(timing.SAMPLES, due(timing.SAMPLES))
    assert (found.fixed, found.per_sample) == pytest.approx((3e-4, 2e-7))
    assert found.knee == pytest.approx(1500.0)
    noisy = due(timing.SAMPLES) * np.where(np.arange(9) % 2, 1.1, 0.9)
    assert timing.fit(timing.SAMPLES, noisy).knee == pytest.approx(1500.0, rel=0.25)


# ---- the page: the report's numbers as it prints them, ours from the summary

ORDER = ("MC100", "MC10", "Taylor", "Unscented")
TITLES = {
    "MC10000": "Monte Carlo 10000",
    "MC100": "Monte Carlo 100",
    "MC10": "Monte Carlo 10",
    "Taylor": "Taylor",
    "Unscented": "unscented",
}


def table(summary, title):
    (found,) = (part for part in summary["page"] if part.get("table", "").startswith(title))
    return found["columns"], found["rows"]


def notes(summary):
    return [part["note"] for part in summary["page"] if "note" in part]


def shown(value):
    return f"{value:.4g}"


def test_table_8_1_has_the_report_and_the_summary_in_their_columns(done):
    summary = done[1]
    columns, rows = table(summary, "Table 8.1")
    assert columns == ["setting", "technique", "report", "ours", "± s.e.", "median"]
    reported = dict(zip(ORDER, ("0.0057", "0.0744", "0.0758", "0.0769"), strict=True))
    contrast = summary["contrast"]
    due = []
    for name in ("R1", "R2", "mild"):
        means, errors, medians = (
            (contrast["mean"], contrast["standard_error"], contrast["median"])
            if name == "mild"
            else (summary[key][name] for key in ("table_8_1", "table_8_1_se", "table_8_1_median"))
        )
        for k in ORDER:
            report = "–" if name == "mild" else reported[k]
            ours = map(shown, (means[k], errors[k], medians[k]))
            due.append([name, TITLES[k], report, *ours])
    assert rows == due


def test_table_8_2_has_the_report_and_the_summary_in_their_columns(done):
    summary = done[1]
    step, part = summary["table_8_2"], summary["table_8_2_linearisation"]
    columns, rows = table(summary, "Table 8.2")
    assert columns == ["technique", "report", "step", "linearisation", "batch"]
    reported = {"MC10000": 1271.8, "MC100": 14.04, "MC10": 1.61, "Unscented": 1.61, "Taylor": 1.6}
    batch = summary["table_8_2_batch"]
    assert rows == [
        [
            TITLES[k],
            shown(report),
            shown(1e3 * step["by_technique"][k]),
            shown(1e3 * part["by_technique"][k]),
            shown(1e3 * batch[k]) if k in batch else "–",
        ]
        for k, report in reported.items()
    ]
    columns, rows = table(summary, "Time [ms] by number of samples")
    assert columns == ["samples", "step", "linearisation"]
    assert rows == [
        [n, shown(1e3 * t), shown(1e3 * part["by_samples"][n])]
        for n, t in step["by_samples"].items()
    ]


def test_notes_say_the_numbers_of_this_run(done):
    summary = done[1]
    (mild,) = (note for note in notes(summary) if "mild setting, ours alone" in note)
    means = summary["contrast"]["mean"]
    order = ", ".join(f"{TITLES[k]} ({means[k]:.2g})" for k in sorted(means, key=means.get))
    assert f"from best to worst are: {order}." in mild
    assert "20,000 samples" in mild
    assert f"is {summary['second_truth']['mild']:.2g} on average" in mild
    (heavy,) = (note for note in notes(summary) if "heavy-tailed" in note)
    assert "of 500 simulations" in heavy
    for name in ("R1", "R2"):
        mean, median, error = (
            summary[key][name]["MC10"] for key in ("table_8_1", "table_8_1_median", "table_8_1_se")
        )
        assert f"{name} {median:.2g} against {mean:.2g} ± {100 * error / mean:.1f} %" in heavy
    (alike,) = (note for note in notes(summary) if "equation 8.4" in note)
    change = max(
        abs(summary["table_8_1_unwrapped"][name][k] / mean - 1.0)
        for name in ("R1", "R2")
        for k, mean in summary["table_8_1"][name].items()
    )
    assert f"by {100 * change:.1f} % at the most" in alike


def test_captions_say_the_numbers_of_this_run(done):
    summary = done[1]
    captions = {part["figure"]: part["caption"] for part in summary["page"] if "figure" in part}
    trial = Trial.draw(SETTINGS["R1"], 500, 20_000, 0)
    first = {k: trial.filter(rule).divergence[0] for k, rule in accuracy.rules(0).items()}
    order = ", ".join(f"{TITLES[k]} ({first[k]:.2g})" for k in sorted(first, key=first.get))
    assert "unscented transform did best and Monte Carlo 10 worst" in captions["figure_8_1.png"]
    assert f"from best to worst: {order}." in captions["figure_8_1.png"]
    constant = summary["error_constant"]
    ratio = 10 * summary["error_by_samples"]["10"]["mean"] / constant
    assert f"{constant:.2f} / N" in captions["error.png"]
    assert f"is {ratio:.2f} times" in captions["error.png"]


def test_two_truths_are_as_far_apart_as_theory_says():
    """Moments of N samples: a KL of 9 / 2N each, were all of the variance sampled and nothing read.

    The truth of the mild setting is read, which can only take from it, and two differ by both.
    """
    trial = Trial.draw(SETTINGS["mild"], 50, 20_000, 0)
    apart = [accuracy.second_truth(trial, 20_000, seed) for seed in range(20)]
    assert 0.1 * 9.0 / 20_000 < np.mean(apart) < 9.0 / 20_000
    assert apart[0] > 0.01 * np.mean(apart)  # the trial's own seed draws another truth too


def test_figures_and_the_statement_are_there(done):
    out, summary = done
    for name in ("figure_8_1", "error", "cost"):
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (out / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    said = " ".join(notes(summary))
    assert "parameters are unknown" in said
    assert "proves nothing" in said
    assert summary["settings"]["seed"] == 0


def test_the_same_seed_gives_the_same_numbers():
    first, again, other = (
        Trial.draw(SETTINGS["R1"], 50, 1000, seed).filter(accuracy.rules(seed)["MC10"]).divergence
        for seed in (0, 0, 1)
    )
    assert (first == again).all()
    assert (first != other).all()


def test_a_heading_read_as_an_angle_would_raise_the_average():
    class Wrapped(Setting):
        @property
        def reading(self):
            return pose_fix

    setting = SETTINGS["R2"]
    averages = [
        Trial.draw(each, 10_000, 100_000, seed=1).filter(accuracy.rules(1)["MC100"]).mean
        for each in (setting, Wrapped(setting.start, setting.motion, setting.sensor))
    ]
    assert averages[1] > 1.3 * averages[0]


@pytest.mark.parametrize("name", ["R1", "R2"])
def test_taylor_and_unscented_meet_the_report(name):
    for seed in range(3):
        trial = Trial.draw(SETTINGS[name], 5000, 200_000, seed)
        for technique in ("Taylor", "Unscented"):
            mean = trial.filter(accuracy.rules(seed)[technique]).mean
            assert mean == pytest.approx(REPORT[technique], rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["R1", "R2"])
def test_every_average_is_within_15_per_cent_of_the_report(name, seed):
    trial = Trial.draw(SETTINGS[name], 10_000, 1_000_000, seed)
    for technique, rule in accuracy.rules(seed).items():
        mean = trial.filter(rule).mean
        assert mean == pytest.approx(REPORT[technique], rel=0.15), technique
