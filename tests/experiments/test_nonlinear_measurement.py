"""The experiment's numbers against twins written out: one step of each filter, and a dense grid."""

import json
import re
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from crossed import slow_after

import pgm
from experiments import nonlinear_measurement
from experiments.nonlinear_measurement import findings, reference, study
from experiments.nonlinear_measurement.audits import distance
from experiments.nonlinear_measurement.cases import HEADINGS, SENSORS, simulate
from experiments.nonlinear_measurement.rules import Tally, cost, rules
from experiments.nonlinear_measurement.scores import Score
from experiments.nonlinear_measurement.study import Study
from experiments.nonlinear_measurement.truth import draw, posterior
from models.networks import pose

# The reference's mean KL at s = 0.3 / 0.6: far, near, two ranges, collinear, position.
REFERENCE = """
Taylor            .064/.465  1.87/6.81  .076/.499  .087/.665  .031/.369
Unscented         .060/.415  .96/1.93   .072/.497  .081/.405  .027/.255
Cubature          .053/.283  .86/1.63   .067/.384  .079/.319  .026/.200
GaussHermite5     .051/.258  .79/1.40   .066/.368  .078/.316  .026/.198
MonteCarlo10      .115/.721  1.72/3.80  .121/.826  .145/.875  .046/.430
MonteCarlo100     .057/.292  .85/1.53   .073/.415  .087/.367  .027/.219
Antithetic10      .069/.468  1.2/2.8    .079/.541  .084/.456  .029/.281
IteratedCubature  .015/.153  .021/.162  .028/.219  .158/1.87  .026/.200
"""
NAMES = ["far", "near", "two_ranges", "collinear", "position"]
DUE = {
    (rule, name, s): float(number)
    for rule, *cells in map(str.split, REFERENCE.strip().splitlines())
    for name, cell in zip(NAMES, cells, strict=True)
    for s, number in zip(("0.3", "0.6"), cell.split("/"), strict=True)
}
OLD = {rule for rule, *_ in DUE}
AGAIN = ["IteratedSmoother", "IteratedLag", "TaylorSmoother"]
RULES = OLD | {*AGAIN}
ORDER = [*reference.KL, *AGAIN]
RUNS = 30
LANDMARKS = {
    "far": [(3.0, 2.0)],
    "near": [(1.6, 0.9)],
    "two_ranges": [(3.0, 2.0), (3.0, -2.0)],
    "collinear": [(4.0, 0.3), (-2.0, 0.2)],
}


@pytest.fixture(scope="module", params=[pytest.param("quick", marks=pytest.mark.slow)])
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("nonlinear_measurement")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(study, "cost", partial(cost, repeats=1))
        nonlinear_measurement.run(out=out, seed=0, **nonlinear_measurement.QUICK)
    return out, json.loads((out / "summary.json").read_text())


# ---- the twin: one step of a filter, from the textbook's equations, all simulations at once


def wrap(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def transpose(matrix):
    return np.swapaxes(matrix, -1, -2)


def apply(matrix, vector):
    return np.einsum("bij,bj->bi", matrix, vector)


def drive(x):
    """Speed 1 m/s, turn rate 0.5 rad/s, one second: the chord of an arc."""
    chord = 2 * np.sin(0.25) / 0.5
    course = x[..., 2] + 0.25
    return x + np.stack([chord * np.cos(course), chord * np.sin(course), 0.5 + 0 * course], -1)


def sensor(name):
    """What is read, stacked, which of it is an angle, and its noise."""
    if name == "position":
        return lambda x: x[..., :2], np.array([False, False]), 0.01 * np.eye(2)
    bearing = name in ("far", "near")

    def sense(x):
        found = []
        for east, north in LANDMARKS[name]:
            found.append(np.hypot(east - x[..., 0], north - x[..., 1]))
            if bearing:
                found.append(np.arctan2(north - x[..., 1], east - x[..., 0]) - x[..., 2])
        return np.stack(found, axis=-1)

    return sense, np.array([False, bearing]), np.diag([0.01, 0.0025 if bearing else 0.01])


def taylor(function, mean, cov, angles):
    step = 1e-5 * np.eye(3)
    offset = function(mean[:, None] + step) - function(mean[:, None] - step)
    slope = transpose(np.where(angles, wrap(offset), offset)) / 2e-5
    return slope, function(mean), 0.0


def sigma_points(points, mean_weights, cov_weights):
    def rule(function, mean, cov, angles):
        x = mean[:, None] + points @ transpose(np.linalg.cholesky(cov))
        centre = function(mean)
        offset = function(x) - centre[:, None]
        offset = np.where(angles, wrap(offset), offset)
        value = mean_weights @ offset
        dx, dy = x - mean[:, None], offset - value[:, None]
        cross = transpose(cov_weights[:, None] * dx) @ dy
        slope = transpose(np.linalg.solve(cov, cross))
        own = transpose(cov_weights[:, None] * dy) @ dy
        return slope, centre + value, own - slope @ cov @ transpose(slope)

    return rule


ARMS = np.vstack([np.eye(3), -np.eye(3)])
CUBATURE = sigma_points(np.sqrt(3) * ARMS, np.full(6, 1 / 6), np.full(6, 1 / 6))
WEIGHTS = np.array([0.4, *[0.1] * 6])  # λ = 2 at n = 3, so α² = 5/3
UNSCENTED = sigma_points(
    np.sqrt(5) * np.vstack([np.zeros(3), ARMS]), WEIGHTS, WEIGHTS + np.eye(7)[0] * (1 - 5 / 3 + 2)
)


def twin(case, name, rule, iterations=1):
    """Mean and covariance after the step; the sensor is linearised again at its posterior."""
    sense, angles, noise = sensor(name)
    z = case.readings.reshape(len(case.readings), -1)
    mean = np.zeros((len(z), 3))
    cov = np.broadcast_to(np.diag([0.04, 0.04, case.heading_std**2]), (len(z), 3, 3))
    slope, mean, left = rule(drive, mean, cov, np.zeros(3, dtype=bool))
    cov = slope @ cov @ transpose(slope) + left + 0.0025 * np.eye(3)
    at = mean, cov
    for _ in range(iterations):
        slope, value, left = rule(sense, *at, angles)
        residual = z - value
        residual = np.where(angles, wrap(residual), residual) + apply(slope, at[0] - mean)
        predictive = slope @ cov @ transpose(slope) + left + noise
        gain = transpose(np.linalg.solve(predictive, slope @ cov))
        at = mean + apply(gain, residual), cov - gain @ predictive @ transpose(gain)
    return at


def kl(p_mean, p_cov, q_mean, q_cov):
    solved = np.linalg.solve(q_cov, p_cov)
    off = q_mean - p_mean
    far = np.sum(off * np.linalg.solve(q_cov, off[..., None])[..., 0], axis=-1)
    trace = np.trace(solved, axis1=-2, axis2=-1)
    return 0.5 * (trace + far - 3 - np.linalg.slogdet(solved)[1])


@pytest.mark.parametrize("name", SENSORS)
def test_the_kl_of_the_summary_is_that_of_the_twin(done, name):
    for s in (0.1, 0.3):
        case = simulate(SENSORS[name], s, RUNS, 0)
        exact = posterior(case, 12, 125, 0)
        for rule, linearise, iterations in (
            ("Taylor", taylor, 1),
            ("Unscented", UNSCENTED, 1),
            ("Cubature", CUBATURE, 1),
            ("IteratedCubature", CUBATURE, 10),
        ):
            due = kl(exact.mean, exact.cov, *twin(case, name, linearise, iterations))
            assert done[1]["kl"][name][str(s)][rule] == pytest.approx(due.mean(), rel=1e-6)
            assert done[1]["kl_median"][name][str(s)][rule] == pytest.approx(
                np.median(due), rel=1e-6
            )
            spread = due.std(ddof=1) / np.sqrt(RUNS)
            assert done[1]["kl_se"][name][str(s)][rule] == pytest.approx(spread, rel=1e-5)


@pytest.mark.parametrize("name", SENSORS)
def test_iterating_in_the_engine_is_iterating_in_the_twin(name):
    """Beliefs of single simulations, to part of a deviation, where iterating came to rest."""
    case = simulate(SENSORS[name], 0.6, 40, 3)
    after = rules(0)["IteratedCubature"].solve(case)
    belief = after[pose.at(1)]
    mean, cov = twin(case, name, CUBATURE, 10)
    rest = after.status.converged
    assert rest.mean() > (0.0 if name == "collinear" else 0.5)
    assert np.abs((belief.mean - mean) / belief.std)[rest].max() < 1e-7
    assert np.abs(belief.cov - cov)[rest].max() < 1e-8


def test_the_twin_would_notice_a_second_count_of_the_reading():
    """Restarting from the posterior instead of the prediction is another answer."""
    case = simulate(SENSORS["far"], 0.3, 20, 0)
    belief = rules(0)["IteratedCubature"].solve(case)[pose.at(1)]
    once = twin(case, "far", CUBATURE, 1)
    assert np.abs((belief.mean - once[0]) / belief.std).max() > 0.1


# ---- the truth


def grid_moments(case, name, run):
    """Moments of the pose on a dense grid, the first heading summed out; nothing is sampled."""
    s = case.heading_std
    start = np.linspace(-6.5 * s, 6.5 * s, 301)
    east = north = np.linspace(-1.9, 2.3, 61)
    heading = np.linspace(-6.5 * s, 6.5 * s + 0.8, 201)

    def normal(x, mean, variance):
        return np.exp(-0.5 * (x - mean) ** 2 / variance)

    chord = 2 * np.sin(0.25) / 0.5
    a = normal(east[:, None], chord * np.cos(start + 0.25), 0.0425)
    b = normal(north[:, None], chord * np.sin(start + 0.25), 0.0425)
    c = normal(heading[:, None], start + 0.5, 0.0025) * normal(start, 0.0, s**2)
    density = np.einsum("it,jt,kt->ijk", a, b, c, optimize=True)
    grid = np.stack(np.meshgrid(east, north, heading, indexing="ij"), axis=-1)
    sense, angles, noise = sensor(name)
    off = case.readings[run].ravel() - sense(grid)
    off = np.where(angles, wrap(off), off)
    density *= np.exp(-0.5 * np.sum(off**2 / np.diag(noise), axis=-1))
    density /= density.sum()
    mean = np.einsum("ijk,ijkc->c", density, grid)
    centred = grid - mean
    return mean, np.einsum("ijk,ijkc,ijkd->cd", density, centred, centred, optimize=True)


@pytest.mark.parametrize(
    ("name", "s"),
    slow_after(2, [("near", 0.3), ("collinear", 0.6), ("far", 0.6), ("two_ranges", 0.3)]),
)
def test_the_truth_is_that_of_a_dense_grid(name, s):
    case = simulate(SENSORS[name], s, 4, 1)
    exact = posterior(case, 14, 500, 0)
    mean, cov = grid_moments(case, name, 3)
    std = np.sqrt(np.diagonal(cov))
    assert np.abs((exact.mean[3] - mean) / std).max() < 0.01
    assert np.abs((exact.cov[3] - cov) / np.outer(std, std)).max() < 0.02


@pytest.mark.parametrize("name", ["near", "collinear", "position"])
def test_both_poses_and_the_evidence_are_those_of_drives_weighed_by_the_readings(name):
    """Both poses are drawn from the model, with all noise, and nothing is integrated out."""
    case, rng = simulate(SENSORS[name], 0.6, 2, 1), np.random.default_rng(0)
    exact = posterior(case, 14, 500, 0)
    first = rng.normal(size=(500_000, 3)) * [0.2, 0.2, 0.6]
    after = drive(first) + 0.05 * rng.normal(size=first.shape)
    sense, angles, noise = sensor(name)
    off = case.readings[0].ravel() - sense(after)
    off = np.where(angles, wrap(off), off) / np.sqrt(np.diag(noise))
    weights = np.exp(-0.5 * (off**2).sum(-1)) / np.sqrt(np.linalg.det(2 * np.pi * noise))
    poses = np.concatenate([first, after], axis=-1)
    cov = np.cov(poses.T, aweights=weights)
    std = np.sqrt(np.diagonal(cov))
    assert exact.log_evidence[0] == pytest.approx(np.log(weights.mean()), abs=0.03)
    assert np.abs(exact.poses_mean[0] - np.average(poses, 0, weights)).max() < 0.03 * std.max()
    assert np.abs((exact.poses_cov[0] - cov) / np.outer(std, std)).max() < 0.05


def test_the_truth_of_a_linear_reading_is_unbiased_and_calibrated():
    """Drawn poses are draws from the exact posterior: their NEES averages 3 by construction."""
    case = simulate(SENSORS["position"], 0.6, 1500, 7)
    exact = posterior(case, 10, 30, 0)
    off = case.truth - exact.mean
    nees = np.einsum("bi,bij,bj->b", off, np.linalg.inv(exact.cov), off)
    assert nees.mean() == pytest.approx(3.0, abs=4 * nees.std() / np.sqrt(1500))


def test_effective_sample_sizes_follow_the_number_of_points():
    case = simulate(SENSORS["near"], 0.6, 8, 2)
    few, many = (posterior(case, k, 0.0, 0).effective for k in (10, 13))
    assert np.all((few > 1) & (few < 2**10))
    assert np.all((many > 1) & (many < 2**13))
    assert np.median(many / few) == pytest.approx(8, rel=0.2)


def test_a_better_pilot_helps_where_the_first_was_lost():
    """A reading far out in the prior's tail leaves the first pilot few points."""
    case = simulate(SENSORS["far"], 0.3, 600, 0)
    once, again = (posterior(case, 12, enough, 0).effective for enough in (0.0, 500.0))
    lost = once < 500
    assert lost.any()
    assert np.all(again[lost] > 500)
    assert np.array_equal(once[~lost], again[~lost])


def test_places_drawn_have_the_exact_moments():
    case = simulate(SENSORS["collinear"], 0.6, 3, 4)
    exact = posterior(case, 14, 500, 0)
    for run in range(3):
        places = draw(case, run, 4000, seed=1)
        std = np.sqrt(np.diagonal(exact.cov[run])[:2])
        assert np.abs((places.mean(axis=0) - exact.mean[run, :2]) / std).max() < 0.1
        assert places.std(axis=0) == pytest.approx(std, rel=0.1)


# ---- what the experiment says


def test_every_sensor_s_and_rule_has_its_numbers(done):
    summary = done[1]
    for key in ("kl", "kl_se", "kl_median"):
        assert set(summary[key]) == set(SENSORS) == {*LANDMARKS, "position"}
        for cases in summary[key].values():
            assert set(cases) == set(map(str, HEADINGS)) == {"0.1", "0.3", "0.6"}
            for found in cases.values():
                assert set(found) == RULES
                assert all(0.0 < value < 100.0 for value in found.values())
    for key in ("nees", "rmse", "rmse_heading"):
        assert all(set(found) == {*RULES, "Exact"} for found in summary[key]["far"].values())


def test_the_truth_kept_every_simulation(done):
    for cases in done[1]["truth"].values():
        for found in cases.values():
            assert found["dropped"] == 0
            assert 125 <= found["effective_min"] <= found["effective_median"] < 2**12


def test_the_point_of_linearisation_matters_more_than_the_rule(done):
    kl = done[1]["kl"]
    for name in ("far", "near", "two_ranges"):
        for found in kl[name].values():
            others = [found[rule] for rule in OLD - {"IteratedCubature"}]
            assert found["IteratedCubature"] < 0.7 * min(others)
    assert kl["near"]["0.6"]["Taylor"] > 10 * kl["near"]["0.6"]["IteratedCubature"]
    assert done[1]["nees"]["near"]["0.6"]["Taylor"] > 6.0
    assert done[1]["nees"]["near"]["0.6"]["IteratedCubature"] == pytest.approx(3.0, abs=0.8)


def test_iterating_hurts_where_the_posterior_has_two_modes(done):
    found = done[1]["kl"]["collinear"]["0.6"]
    assert found["IteratedCubature"] > 2 * found["Cubature"]
    rest = done[1]["settled"]["collinear"]["0.6"]
    assert rest["share"] < 0.9
    assert done[1]["settled"]["far"]["0.6"]["share"] > 0.9
    mean = rest["share"] * rest["kl"] + (1 - rest["share"]) * rest["kl_others"]
    assert mean == pytest.approx(found["IteratedCubature"])


def test_linearising_the_motion_again_wins_where_one_mode_is_left(done):
    kl = done[1]["kl"]
    for name, factor in {"far": 30, "near": 10, "two_ranges": 5, "position": 5}.items():
        found = kl[name]["0.6"]
        assert factor * found["IteratedSmoother"] < found["IteratedCubature"]
        assert factor * found["TaylorSmoother"] < found["IteratedCubature"]
    assert kl["collinear"]["0.6"]["IteratedSmoother"] > 4 * kl["collinear"]["0.6"]["Cubature"]


def test_a_window_of_one_step_is_the_smoother_of_one_step(done):
    for cases in done[1]["kl"].values():
        for found in cases.values():
            assert found["IteratedLag"] == pytest.approx(found["IteratedSmoother"], rel=1e-4)


def test_the_audit_knows_wrong_beliefs_from_right_ones(done):
    each = [found for rules_ in done[1]["audits"].values() for found in rules_.values()]
    wrong, caught, right, alarms = (
        sum(found[key] for found in each) for key in ("wrong", "caught", "right", "alarms")
    )
    assert wrong > 100
    assert right > 500
    assert caught >= 0.95 * wrong
    assert alarms <= 0.02 * right
    for found in done[1]["audits"]["collinear"].values():
        assert found["caught"] >= 0.9 * found["wrong"]
        assert found["alarms"] <= 0.1 * found["right"]


def test_estimates_are_nearer_than_every_rule_and_their_bounds_hold(done):
    for name, found in done[1]["estimates"].items():
        assert found["kl"] < min(done[1]["kl"][name]["0.6"].values())
        assert found["vouched"] >= 0.7
        assert found["beyond"] <= 0.05


def test_poses_that_are_right_one_by_one_and_wrong_together():
    """Linearised once, the motion's bend is noise: it hides how the poses belong together."""
    case = simulate(SENSORS["far"], 0.6, 150, 0)
    exact = posterior(case, 13, 250, 0)
    smoothed = pgm.smooth(case.model, case.evidence, lineariser=pgm.Cubature())
    before, after = pose.at(0), pose.at(1)
    mean, cov = exact.poses_mean[:, :3], exact.poses_cov[:, :3, :3]
    alone = kl(mean, cov, smoothed[before].mean, smoothed[before].cov)
    alone = np.maximum(alone, pgm.Gaussian(after, exact.mean, exact.cov).kl(smoothed[after]))
    together, right = distance(smoothed, exact), alone < 0.2
    assert right.sum() > 8
    assert together[right].min() > 0.5
    found = pgm.audit(smoothed, rng=0)
    assert found.suspect[right].mean() > 0.9
    assert "the belief of x[0], x[1] of run" in repr(found)


def test_the_verdict_is_three_points_of_the_run(done):
    first, second, third = done[1]["verdict"]
    assert done[1]["page"][0]["note"] == f"{first} {second} {third}"
    kl = done[1]["kl"]
    assert max(len(sentence.split()) for sentence in re.split(r"\. ", first)) < 26
    pair = (kl["far"]["0.6"][rule] for rule in ("IteratedCubature", "IteratedSmoother"))
    # Where most is gained.
    assert "from {:.2g} to {:.2g} nats with range and bearing, far".format(*pair) in first
    harm = kl["collinear"]["0.6"]
    pair = (harm[rule] for rule in ("IteratedCubature", "IteratedSmoother"))
    assert "{:.2g} to {:.2g}".format(*pair) in second or "no certain harm" in second
    assert "suspect" in third


def test_findings_follow_the_numbers_and_not_the_other_way():
    """With the rules' numbers exchanged the verdict says that nothing is gained."""

    def made(kl):
        return Score(kl, 0.01, kl, 3.0, 0.1, 0.1, 0.1)

    def of(cubature, iterated, smoother):
        scores = {"Cubature": cubature, "IteratedCubature": iterated, "IteratedSmoother": smoother}
        cases = {str(s): {r: made(kl) for r, kl in scores.items()} for s in HEADINGS}
        return findings.verdict(Study(scores={"near": cases}))

    assert "1 to 0.1 nats" in of(1.0, 1.0, 0.1)[0]
    first, second, third = of(1.0, 1.0, 1.0)
    assert "gains nothing certain" in first
    assert "no certain harm" in second
    assert "none of the results" in third
    assert "0.1 to 2" in of(0.1, 2.0, 3.0)[1]
    assert "2 to 3 nats" in of(0.1, 2.0, 3.0)[1]


def test_every_table_but_the_references_has_its_finding(done):
    page = done[1]["page"]
    assert set(page[0]) == {"note"}
    for before, part in pairwise(page):
        if "table" in part and not part["table"].startswith("the reference"):
            assert "note" in before, part["table"]


def test_iterating_changes_nothing_about_a_linear_reading(done):
    for found in done[1]["kl"]["position"].values():
        assert found["IteratedCubature"] == pytest.approx(found["Cubature"], rel=1e-12)


def test_kl_grows_with_the_spread_of_the_heading(done):
    for name, cases in done[1]["kl"].items():
        for rule in OLD:
            low, middle, high = (cases[str(s)][rule] for s in HEADINGS)
            assert low < middle < high, (name, rule)


def test_costs_are_counted(done):
    for name, costs in done[1]["cost"].items():
        count = {rule: found["evaluations"] for rule, found in costs.items()}
        calls = 1 if name == "position" else 2  # a linear sensor is not linearised
        assert count["Taylor"] == 2 * calls  # a value and a Jacobian
        assert count["Unscented"] == pytest.approx(7 * calls, abs=0.5)
        assert count["GaussHermite5"] == pytest.approx(125 * calls, abs=1.5)
        assert count["MonteCarlo100"] > 4 * count["MonteCarlo10"]
        assert (count["IteratedCubature"] > 2 * count["Cubature"]) == (calls == 2)
        assert all(found["microseconds"] > 0 for found in costs.values())


def test_counting_changes_no_belief():
    case = simulate(SENSORS["far"], 0.3, 5, 0)
    rule = rules(0)["Unscented"]
    assert cost(rule, case, repeats=1).evaluations == 14
    counted = rule.solve(case, Tally(rule.lineariser))
    np.testing.assert_allclose(counted[pose].mean, rule.solve(case)[pose].mean, atol=1e-13)


def test_z_is_in_standard_errors_of_the_difference(done):
    found = done[1]["against_reference"]["near"]["0.3"]["Taylor"]
    ours, se = (done[1][key]["near"]["0.3"]["Taylor"] for key in ("kl", "kl_se"))
    assert found["reference"] == 1.87
    assert found["difference"] == pytest.approx(ours - 1.87)
    assert found["z"] == pytest.approx((ours - 1.87) / np.hypot(se, se * np.sqrt(RUNS / 1000)))
    every = [
        each["z"]
        for cases in done[1]["against_reference"].values()
        for rules_ in cases.values()
        for each in rules_.values()
    ]
    assert len(every) == 5 * 2 * 8
    assert abs(done[1]["largest_z"]["z"]) == max(map(abs, every))


# ---- the page: cells against the summary and the reference


def table(summary, title):
    (found,) = (part for part in summary["page"] if part.get("table", "").startswith(title))
    return found["columns"], found["rows"]


@pytest.mark.parametrize("s", ["0.1", "0.3", "0.6"])
def test_tables_of_kl_are_the_summary(done, s):
    kl, se, median = (done[1][key] for key in ("kl", "kl_se", "kl_median"))
    columns, rows = table(done[1], f"mean KL [nats] ± standard error, s = {s}")
    assert columns == ["rule", *NAMES]
    assert rows == [
        [r, *(f"{kl[n][s][r]:.3g} ±{100 * se[n][s][r] / kl[n][s][r]:.0f}%" for n in NAMES)]
        for r in ORDER
    ]
    columns, rows = table(done[1], "median KL")
    assert columns == ["rule", "s [rad]", *NAMES]
    assert [row for row in rows if row[1] == s] == [
        [r, s, *(f"{median[n][s][r]:.4g}" for n in NAMES)] for r in ORDER
    ]


@pytest.mark.parametrize("s", ["0.3", "0.6"])
def test_tables_of_the_reference_are_the_reference(done, s):
    columns, rows = table(done[1], f"the reference's mean KL [nats], s = {s}")
    assert columns == ["rule", *NAMES]
    assert {row[0] for row in rows} == OLD
    against = done[1]["against_reference"]
    for rule, *cells in rows:
        for name, cell in zip(NAMES, cells, strict=True):
            number, z = cell.rstrip(")").split(" (")
            assert float(number) == DUE[rule, name, s] == against[name][s][rule]["reference"]
            assert float(z) == pytest.approx(against[name][s][rule]["z"], abs=0.051)


def test_tables_of_the_widest_heading_are_the_summary(done):
    summary = done[1]
    nees, error, rmse, heading = (
        {n: summary[key][n]["0.6"] for n in NAMES}
        for key in ("nees", "nees_se", "rmse", "rmse_heading")
    )
    order = ["Exact", *ORDER]
    columns, rows = table(summary, "NEES, 3 is right")
    assert columns == ["rule", *NAMES]
    assert rows == [[r, *(f"{nees[n][r]:.2f} ± {error[n][r]:.2g}" for n in NAMES)] for r in order]
    columns, rows = table(summary, "RMSE of position [m] / heading [rad]")
    assert columns == ["rule", *NAMES]
    assert rows == [[r, *(f"{rmse[n][r]:.3f} / {heading[n][r]:.3f}" for n in NAMES)] for r in order]


def test_tables_of_cost_and_of_rest_are_the_summary(done):
    summary = done[1]
    columns, rows = table(summary, "evaluations of functions / µs")
    assert columns == ["rule", *NAMES]
    each = {rule: [summary["cost"][name][rule] for name in NAMES] for rule in ORDER}
    assert rows == [
        [rule, *(f"{c['evaluations']:.0f} / {c['microseconds']:.1f}" for c in costs)]
        for rule, costs in each.items()
    ]
    columns, rows = table(summary, "IteratedCubature: simulations at rest")
    assert columns == ["sensor", "s [rad]", "at rest", "KL at rest", "KL of the others"]
    assert len(rows) == 15
    for name, s, share, kl, others in rows:
        rest = summary["settled"][name][s]
        assert (share, kl) == (f"{100 * rest['share']:.1f}%", f"{rest['kl']:.4g}")
        assert others == (f"{rest['kl_others']:.4g}" if rest["share"] < 1.0 else "–")


def test_tables_fit_a_hundred_characters(done):
    """A terminal's border takes three for each column, and one."""
    for part in done[1]["page"]:
        if "table" in part:
            lines = [part["columns"], *part["rows"]]
            widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
            assert sum(widths) + 3 * len(widths) + 1 <= 100, part["table"]


def test_figures_are_png_and_pdf(done):
    for name in ("kl_against_cost", "scenes"):
        assert (done[0] / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (done[0] / f"{name}.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.slow
def test_three_full_runs_agree_with_the_reference(tmp_path):
    """The reference is one seed's, of as many simulations: its error is taken to be one seed's."""
    runs = []
    for seed in range(3):
        nonlinear_measurement.run(out=tmp_path, seed=seed, runs=1000, log2_points=13)
        runs.append(json.loads((tmp_path / "summary.json").read_text()))
    for (rule, name, s), due in DUE.items():
        means, errors = (
            np.array([run[key][name][s][rule] for run in runs]) for key in ("kl", "kl_se")
        )
        one = np.sqrt(np.mean(errors**2))
        difference, error = means.mean() - due, np.hypot(one, one / np.sqrt(3.0))
        assert abs(difference) < 3.0 * error, (rule, name, s)
    assert len(DUE) == 80
