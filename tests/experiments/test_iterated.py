import json
from dataclasses import replace

import numpy as np
import pytest

import pgm
from experiments import iterated
from experiments.iterated import agreement, chain, growth, methods, pages, published
from experiments.iterated.changes import Change, verdicts
from experiments.record import Record
from models.sensors import range_bearing
from pgm import consistency

ROOT = np.sqrt(1.5)  # the unscented points' distance, w₀ = 1/3


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("iterated")
    iterated.run(out=out, seed=0, **iterated.QUICK)
    return out, json.loads((out / "summary.json").read_text())


def regress(function, mean, var):
    """F, b and the residual variance of a function of one variable, three points of weight 1/3."""
    x = mean + ROOT * np.sqrt(var) * np.array([0.0, 1.0, -1.0])
    y = function(x)
    slope = np.mean((x - mean) * (y - y.mean())) / var
    return slope, y.mean() - slope * mean, np.mean((y - y.mean()) ** 2) - slope**2 * var


def dense(z, power, at, first_var=4.0):
    """Linearise at moments (mean, variance, step by step) and solve all states at once.

    Without moments, at those of the filter, which is returned too.
    """
    steps = len(z)
    precision, information = np.zeros((steps + 1, steps + 1)), np.zeros(steps + 1)

    def add(row, value, var):
        nonlocal precision, information
        precision += np.outer(row, row) / var
        information += row * value / var

    unit = np.eye(steps + 1)
    add(unit[0], 5.0, first_var)
    mean, var = 5.0, first_var
    filtered = [(mean, var)]
    for k in range(1, steps + 1):
        here = (mean, var) if at is None else at[k - 1]
        F, b, left = regress(
            lambda x, k=k: 0.9 * x + 10 * x / (1 + x**2) + 8 * np.cos(1.2 * k), *here
        )
        add(unit[k] - F * unit[k - 1], b, left + 1.0)
        mean, var = F * mean + b, F**2 * var + left + 1.0
        H, c, left = regress(lambda x: x**power / 20, *((mean, var) if at is None else at[k]))
        add(H * unit[k], z[k - 1] - c, left + 1.0)
        gain = var * H / (H**2 * var + left + 1.0)
        mean, var = mean + gain * (z[k - 1] - H * mean - c), var * (1.0 - gain * H)
        filtered.append((mean, var))
    cov = np.linalg.inv(precision)
    return filtered, list(zip(cov @ information, np.diag(cov), strict=True))


@pytest.mark.parametrize("sensor", ["cubic", "square"])
def test_the_engine_is_a_dense_solution_linearised_at_the_same_places(sensor):
    case = growth.simulate(sensor, 3, 5)
    power = growth.POWERS[sensor]
    rule = growth.LINEARISERS["Unscented"]
    asked = {"lineariser": rule, "tolerance": 0}
    beliefs = [pgm.filter(case.model, case.evidence, lineariser=rule)[growth.state]] + [
        pgm.smooth(case.model, case.evidence, iterations=k, **asked)[growth.state] for k in (1, 2)
    ]
    readings = pgm.smooth(case.model, case.evidence, lineariser=rule).innovations[growth.reading]
    assert readings.residual.shape[-2] == 50
    for run in range(3):
        z = np.asarray(case.evidence[growth.reading].values)[run, :, 0]
        filtered, smoothed = dense(z, power, None)
        _, again = dense(z, power, smoothed)
        for belief, expected in zip(beliefs, (filtered, smoothed, again), strict=True):
            mean, var = np.array(expected).T
            std = np.sqrt(var)
            assert np.abs((belief.mean[run, :, 0] - mean) / std).max() < 1e-8
            assert np.abs(belief.std[run, :, 0] / std - 1.0).max() < 1e-8


def test_a_sample_of_the_published_case_agrees():
    """The numbers after six linearisations, whose tails are the least heavy."""
    case = growth.simulate("cubic", 500, 3)
    numbers = [n for n in published.GROWTH["cubic"]["Unscented"] if n.method[1] == 6]
    (found,) = published.compare([case], growth.LINEARISERS["Unscented"], numbers)
    assert found.number.value == 0.44
    # The published error is that of 2000 runs.
    assert abs(found.mean - 0.44) < 4.0 * found.standard_error * np.sqrt(1.0 + 500 / 2000)
    assert found.medians[0] < found.mean


def test_other_readings_of_the_case_are_other_cases():
    """A phase later or earlier, a first state that is read, one whose error counts."""
    main = growth.simulate("cubic", 4, 0)
    assert main.truth.shape == (4, 51, 1)
    assert (main.first, growth.OTHERS[1].counted) == (1, 0)
    read = growth.simulate("cubic", 4, 0, growth.OTHERS[0])
    assert read.truth.shape == (4, 50, 1)
    assert read.evidence[growth.reading].step.tolist() == list(range(50))
    clocks = {
        how.phase: growth.simulate("cubic", 4, 0, how).evidence[growth.clock].ravel()[0]
        for how in growth.OTHERS
    }
    assert clocks == {0: 0.0, 1: 1.0, 2: 2.0}


def test_z_counts_the_published_error_as_one_seed():
    number = published.Number(("filter", 1), 1.0)
    comparison = published.Comparison(number, (1.2, 1.3, 1.4), 0.1, (1.0, 1.0, 1.0))
    assert comparison.z == pytest.approx(0.3 / (0.1 * np.sqrt(4.0 / 3.0)))


def test_scores_of_errors_known_by_hand():
    squares = np.array([[1.0, 3.0], [4.0, 4.0], [0.0, 0.0], [9.0, 7.0]])
    score = methods.score(squares, np.full((4, 2), 2.0), 1.9, 0.5, None, 0.0)
    assert score.rmse == pytest.approx(np.sqrt(3.5))
    assert score.median == pytest.approx((np.sqrt(2.0) + 2.0) / 2.0)
    assert score.lost == 0.5
    spread = np.std([2.0, 4.0, 0.0, 8.0])
    assert score.rmse_se == pytest.approx(spread / (2.0 * np.sqrt(3.5) * 2.0))
    nees = np.ones((20, 1))
    nees[3] = 21.0
    tailed = methods.score(np.arange(20.0)[:, None], nees, 9.0, 0.0, None, 0.0)
    assert tailed.trimmed == pytest.approx(np.sqrt(np.arange(19.0).mean()))
    assert tailed.tail == pytest.approx(19.0 / 190.0)
    assert tailed.nees_tail == pytest.approx(21.0 / 40.0)


def test_normalised_errors_are_the_nees_where_that_exists():
    case = chain.simulate(4, 0)
    belief = pgm.filter(case.model, case.evidence)[case.variable]
    wrong = consistency.error(belief, case.truth)
    nees = methods.normalised(wrong, belief.cov)
    assert nees == pytest.approx(consistency.nees(belief, case.truth))
    assert methods.normalised(np.ones(2), np.diag([1.0, 0.0])) > 1e12


def test_no_sighting_tells_the_turn_about_the_landmark():
    case = chain.simulate(2, 0)
    angle = 0.3
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = case.truth.copy()
    turned[..., :2] = chain.LANDMARK + (case.truth[..., :2] - chain.LANDMARK) @ turn.T
    turned[..., 2] += angle
    places = np.broadcast_to(chain.LANDMARK, (*turned.shape[:-1], 2))
    assert range_bearing(turned, places) == pytest.approx(range_bearing(case.truth, places))
    cov = np.diag([0.04, 0.01, 1.0]) + np.zeros((*turned.shape, 3))
    belief = pgm.Gaussian(case.variable, turned, cov)
    error, std = chain.turned(belief, case.truth)
    assert error == pytest.approx(np.full(error.shape, angle))
    east, north = np.moveaxis(turned[..., :2] - chain.LANDMARK, -1, 0)
    expected = np.sqrt(0.04 * north**2 + 0.01 * east**2) / (east**2 + north**2)
    assert std == pytest.approx(expected)


def test_the_growing_smoother_ends_at_the_whole_one():
    case = chain.simulate(3, 1)
    rule = chain.LINEARISERS["Taylor"]
    errors = chain.growing(case, rule, 20)
    whole = pgm.smooth(case.model, case.evidence, lineariser=rule, iterations=20, tolerance=1e-3)
    last = whole[case.variable].mean[:, -1, :2] - case.truth[:, -1, :2]
    assert errors.shape == (3, len(chain.ENDS))
    assert chain.ENDS[-1] == chain.STEPS
    assert errors[:, -1] == pytest.approx(np.linalg.norm(last, axis=-1))


@pytest.fixture(scope="module")
def cubic():
    return growth.simulate("cubic", 150, 1)


def test_step_control_saves_the_second_linearisation_of_the_cubic_filter(cubic):
    rule = growth.LINEARISERS["Unscented"]
    plain, lm = (methods.solve(cubic, rule, "filter", control, 2) for control in ("plain", "lm"))
    assert lm.score.rmse < 0.8 * plain.score.rmse
    assert lm.score.lost <= plain.score.lost


def test_iterating_wins_the_cubic_smoother(cubic):
    rule = growth.LINEARISERS["Unscented"]
    once, many = (methods.solve(cubic, rule, "smoother", "plain", k) for k in (1, 6))
    assert many.score.median < 0.8 * once.score.median


@pytest.fixture(scope="module")
def drives():
    return chain.simulate(200, 2)


def test_on_chains_the_smoother_gains_and_the_filter_loses(drives):
    """At the last step both know the same readings."""
    rule = chain.LINEARISERS["Cubature"]
    once, many = (methods.solve(drives, rule, "filter", "plain", k) for k in (1, 10))
    lm = methods.solve(drives, rule, "filter", "lm", 10)
    smoother = methods.solve(drives, rule, "smoother", "plain", 10)
    assert min(many.by_step[-1], lm.by_step[-1]) > once.by_step[-1] > smoother.by_step[-1]


def test_a_change_is_judged_run_by_run(drives):
    once = methods.solve(drives, chain.LINEARISERS["Taylor"], "filter", "plain", 1)
    assert Change(once, once).verdict == "no clear change"
    worse = replace(once, squares=once.squares + 0.01 * np.arange(1, 201.0)[:, None])
    assert Change(once, worse).verdict == "higher"
    assert Change(worse, once).verdict == "lower"


def outcome(squares):
    score = methods.score(squares, squares, 1.0, 0.0, None, 0.0)
    return methods.Outcome(None, squares, np.empty((0, len(squares))), score)


def by_hand(**changes):
    """Controls whose runs all change their squared error by about so much, by linearisations."""
    once = 1.0 + np.linspace(0.0, 1.0, 40)[:, None]
    unequal = np.linspace(0.9, 1.1, 40)[:, None]
    return {
        control: {1: outcome(once)} | {k: outcome(once + by * unequal) for k, by in each.items()}
        for control, each in changes.items()
    }


def test_the_answer_says_which_control_wins_and_when():
    filters = by_hand(plain={2: 0.0, 10: 0.3}, damped={2: -0.3, 10: -0.1}, lm={2: 0.2, 10: 0.1})
    smoothers = by_hand(
        plain={2: -0.3, 10: -0.4}, damped={2: -0.2, 10: -0.4}, lm={2: -0.3, 10: -0.4}
    )
    said = pages.answer({"Taylor": {"filter": filters, "smoother": smoothers}})
    assert said.startswith("Does step control make iterating win on chains? ")
    assert said.endswith(
        " Taylor filter: after 2 no clear change with plain, lower with damped by a half, higher "
        "with Levenberg–Marquardt; after 10 higher with plain and Levenberg–Marquardt, lower with "
        "damped by a half. Taylor smoother: after 2, 10 lower with each."
    )


def test_a_control_without_so_many_linearisations_has_no_verdict():
    controls = by_hand(plain={2: 0.3, 31: 0.3}, damped={2: -0.3, 31: 0.3}, lm={2: 0.3})
    assert verdicts({"Taylor": {"filter": controls}}) == (
        "Taylor filter: after 2 higher with plain and Levenberg–Marquardt, lower with damped by a "
        "half; after 31 higher with each."
    )


def test_the_summary_holds_every_method(done):
    summary = done[1]
    most = iterated.QUICK["most"]
    assert set(summary["growth"]) == {"cubic", "square"}
    for by_name in summary["growth"].values():
        assert set(by_name) == {"Unscented", "Taylor"}
        for kinds in by_name.values():
            assert set(kinds) == {"filter", "smoother"}
            for controls in kinds.values():
                assert set(controls) == {"plain", "damped", "lm"}
                assert all(set(each) == {"1", str(most)} for each in controls.values())
                assert controls["plain"]["1"] == controls["lm"]["1"]
                assert controls["plain"]["1"]["settled"] is None
                assert controls["plain"]["2"]["rmse"] > 0.0
                assert 0.0 <= controls["plain"]["2"]["settled"] <= 1.0
    assert set(summary["chains"]) == set(chain.LINEARISERS)
    controlled = {name for name, kinds in summary["chains"].items() if "lm" in kinds["filter"]}
    assert controlled == {"Taylor", "Cubature"} == set(summary["chain_last"])
    for methods_ in summary["chain_last"].values():
        # The smoother begins with the filter's last belief.
        assert methods_["smoother, once"]["rmse"] == pytest.approx(methods_["filter, once"]["rmse"])


def test_the_summary_compares_with_what_was_published(done):
    summary = done[1]
    found = summary["published"]
    cubic = found["cubic"]["Unscented"]
    assert [one["published"] for one in cubic] == [2.30, 2.02, 1.17]
    for one in cubic:
        error = one["standard_error"] * np.sqrt(1.0 + 1.0 / len(one["seeds"]))
        assert one["z"] == pytest.approx((np.mean(one["seeds"]) - one["published"]) / error)
    everything = [
        one
        for case in ("cubic", "square", "chain")
        for each in found[case].values()
        for one in each
    ]
    assert found["largest_z"] == max(abs(one["z"]) for one in everything)
    assert {one["quantity"] for one in found["square"]["Unscented"]} == {"rmse", "nees"}


def test_readings_of_the_case_that_agree_are_named(tmp_path):
    number = published.Number(("smoother", 1), 1.0)
    near, far = (published.Comparison(number, (v,), 0.1, (1.0,)) for v in (1.2, 1.9))
    record = Record("iterated", tmp_path)
    once = outcome(np.ones((20, 1))).score
    found = {"cubic": {"Unscented": [near]}}
    agreement.published_page(record, found, {"alike": [near], "unlike": [far]}, once)
    page = json.loads(record.summary().read_text())["page"]
    notes = [entry["note"] for entry in page if "note" in entry]
    assert notes[0].startswith("1 of 1 published numbers")
    assert notes[1].endswith(f"at most 3: {growth.MAIN.title}; alike.")


def test_the_answer_comes_first_and_figures_are_on_the_page(done):
    out, summary = done
    page = summary["page"]
    assert page[0]["note"].startswith("Does step control make iterating win")
    figures = [entry for entry in page if "figure" in entry]
    assert [entry["figure"] for entry in figures] == [
        f"{name}.png" for name in ("over_time", "failure", "linearisations", "residuals")
    ]
    for entry in figures:
        assert entry["caption"]
        assert (out / entry["figure"]).read_bytes().startswith(b"\x89PNG")
    # Where nothing is done again, nothing is at rest.
    (rest,) = (entry for entry in page if entry.get("table", "").startswith("Runs at rest"))
    assert {row[1] for row in rest["rows"]} == {str(iterated.QUICK["most"])}
    (caption,) = (e["caption"] for e in figures if e["figure"] == "linearisations.png")
    one = summary["published"]["square"]["Unscented"][1]
    assert f"published {one['published']:g}" in caption
    assert f"there {one['mean']:.2f}" in caption
