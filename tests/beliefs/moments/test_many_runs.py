"""Many runs: worked through in parts, of beliefs alone at first, and judged anew at each step."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from robots import u, x
from zoo import (
    MODELS,
    RULES,
    RUNS,
    SIGHT,
    T,
    assert_same,
    model_of,
    of,
    of_run,
    recording,
    smoothed,
)

import pgm
from pgm.beliefs.moments.passes import forward

MANY = 40
WHICH = np.arange(MANY) % RUNS
rules = pytest.mark.parametrize("rule", ["taylor", "unscented"])
NAME = "a start for each run"


def filtered(rule="taylor", name=NAME, **options):
    evidence = of_run(recording(name), WHICH)
    return pgm.filter(model_of(name, WHICH), evidence, lineariser=RULES[rule], **options)


def assert_each_alone(posterior, rule="taylor", name=NAME, kinds=("filtered", "predicted")):
    for run in range(MANY):
        assert_same(
            of(posterior, run, kinds), of(smoothed(name, rule, WHICH[run]), None, kinds), 1e-9
        )


@rules
@pytest.mark.parametrize("most", [7, MANY - 1])
def test_parts_that_fit_a_cache(monkeypatch, rule, most):
    """Runs differ in their start, controls and landmarks, so that each has to keep its own."""
    monkeypatch.setattr(forward, "MOST", most)
    assert_each_alone(filtered(rule), rule)


def test_a_filter_keeps_beliefs_alone_until_more_is_asked_for():
    posterior = filtered()
    assert isinstance(posterior._outcome._swept, forward.Filtered)
    assert_each_alone(posterior, kinds=("filtered",))
    assert "whole" not in vars(posterior._outcome._swept)
    joint = posterior.joint(x.at(2), x.at(3))
    innovations = posterior.innovations[SIGHT.z]
    for run in (0, MANY - 1):
        evidence = of_run(recording(NAME), WHICH[run])
        alone = pgm.filter(model_of(NAME, WHICH[run]), evidence)
        due = alone.joint(x.at(2), x.at(3))
        np.testing.assert_allclose(joint.mean[run], due.mean, atol=1e-10)
        np.testing.assert_allclose(joint.cov[run], due.cov, rtol=1e-9, atol=1e-12)
        nis = alone.innovations[SIGHT.z].nis
        np.testing.assert_allclose(innovations.nis[run], nis, rtol=1e-8)
    assert_each_alone(posterior, kinds=("predicted",))


def test_parts_that_threads_have_filtered_are_one_filter():
    with ThreadPoolExecutor(2) as pool:
        shared = filtered(executor=pool)
    assert_each_alone(shared, kinds=("filtered",))
    assert_each_alone(shared)


@rules
def test_a_smoother_of_many_runs(rule):
    evidence = of_run(recording("everything"), WHICH)
    posterior = pgm.smooth(MODELS["everything"], evidence, lineariser=RULES[rule])
    assert_each_alone(posterior, rule, "everything", ("filtered", "smoothed"))


@pytest.mark.parametrize("runs", [1, MANY])
def test_a_noise_that_varies_is_judged_anew_at_each_step(runs):
    """A blunt reading first, then sharp ones, of which a difference would lose eight digits."""
    state, z, scale = pgm.variables("state z scale")
    noise = pgm.noise(lambda scale: scale[..., None] ** 2, given=scale)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(state, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(state, {state.previous: 1.0}, cov=1.0)],
        [pgm.LinearGaussianCPD(z, {state: 1.0}, cov=noise)],
    )
    scales = np.array([1e4, 1e-4, 1e-4])
    values = 1e-4 * np.random.default_rng(1).normal(size=(runs, 3, 1))
    sights = pgm.sightings(values, [1, 2, 3], {scale: scales[:, None]})
    posterior = pgm.filter(model, {z: sights}, steps=3)
    variance, means = 1.0, np.zeros(runs)
    for step in (1, 2, 3):
        ahead, own = variance + 1.0, scales[step - 1] ** 2
        variance = ahead * own / (ahead + own)
        means = variance * (means / ahead + values[:, step - 1, 0] / own)
        np.testing.assert_allclose(posterior[state].cov[:, step, 0, 0], variance, rtol=1e-12)
        np.testing.assert_allclose(posterior[state].mean[:, step, 0], means, rtol=1e-9)


@pytest.mark.parametrize("runs", [1, MANY])
def test_an_axis_of_runs_stays(runs):
    given = recording("plain")
    wide = of_run(given, np.full(runs, 1))
    found = pgm.filter(MODELS["plain"], wide)
    assert found[x].mean.shape == (runs, T + 1, 3)
    assert found.log_evidence.shape == found.status.converged.shape == (runs,)
    one = pgm.filter(MODELS["plain"], of_run(given, 1) | {u: wide[u]})
    np.testing.assert_allclose(one[x].mean, found[x].mean, atol=1e-10)


@pytest.mark.parametrize("lead", [(), (3,), (MANY,)])
def test_no_steps_and_no_readings(lead):
    model = MODELS["plain"]
    start = pgm.filter(model, {u: np.zeros((*lead, 0, 2))})
    np.testing.assert_array_equal(start[x].mean, np.zeros((*lead, 1, 3)))
    ahead = pgm.filter(model, {u: np.ones((*lead, 3, 2))})
    np.testing.assert_array_equal(ahead.log_evidence, np.zeros(lead))
    assert ahead[x].mean.shape == (*lead, 4, 3)
    np.testing.assert_array_equal(ahead[x].mean, ahead.predicted[x].mean)


@rules
@pytest.mark.parametrize("name", ["plain", "grouped", "everything"])
def test_iterated_smoothing_is_that_of_each_run(name, rule):
    asked = {"iterations": 3, "tolerance": 0.0, "lineariser": RULES[rule]}
    batch = pgm.smooth(MODELS[name], recording(name), **asked)
    alone = pgm.smooth(MODELS[name], of_run(recording(name), 1), **asked)
    assert batch.status.iterations == alone.status.iterations == 3
    assert_same(of(batch, 1, ("smoothed",)), of(alone, None, ("smoothed",)), 1e-8)


def test_runs_may_have_any_leading_axes_and_broadcast():
    given, square = recording("plain"), WHICH[:6].reshape(2, 3)
    folded = pgm.smooth(MODELS["plain"], of_run(given, square))
    assert folded[x].mean.shape == (2, 3, T + 1, 3)
    assert_same(of(folded, (1, 1)), of(smoothed("plain", "taylor", square[1, 1])), 1e-9)
    crossed = {u: given[u][[0, 1], None], SIGHT.z: of_run(given, WHICH[:3])[SIGHT.z]}
    crossed = pgm.smooth(MODELS["plain"], crossed)
    assert crossed[x].mean.shape == (2, 3, T + 1, 3)
    for command, sight in ((0, 0), (1, 2)):
        alone = {u: given[u][command], SIGHT.z: of_run(given, sight)[SIGHT.z]}
        due = pgm.smooth(MODELS["plain"], alone)
        assert_same(of(crossed, (command, sight)), of(due), 1e-9)


@pytest.mark.parametrize("runs", [RUNS, MANY])
@pytest.mark.parametrize("shared", ["values", "landmarks", "sights", "controls"])
def test_any_of_the_evidence_may_be_shared(shared, runs):
    """All runs have one and the same, without their axis; the rest is each run's own."""
    which, one = np.arange(runs) % RUNS, of_run(recording("plain"), 1)
    evidence = of_run(recording("plain"), which)
    evidence[u] = evidence[u] + 1e-3 * which[:, None, None]

    def drawn(run=None):
        ours = evidence if run is None else of_run(evidence, run)
        values = (one if shared in ("values", "sights") else ours)[SIGHT.z].values
        landmarks = (one if shared in ("landmarks", "sights") else ours)[SIGHT.z].given
        sights = pgm.sightings(np.nan_to_num(values, nan=1.0), one[SIGHT.z].step, landmarks)
        return {u: (one if shared == "controls" else ours)[u], SIGHT.z: sights}

    batch = pgm.smooth(MODELS["plain"], drawn())
    for run in (0, runs - 1):
        assert_same(of(batch, run), of(pgm.smooth(MODELS["plain"], drawn(run))), 1e-9)


def test_iterating_to_convergence_stops_each_run_by_itself():
    """A run that is done waits unchanged for the others."""
    given = recording("everything", runs=8)
    asked = {"iterations": 40, "tolerance": 1e-6}
    batch, iterations = pgm.smooth(MODELS["everything"], given, **asked), set()
    for run in range(0, 8, 2):
        alone = pgm.smooth(MODELS["everything"], of_run(given, run), **asked)
        iterations.add(alone.status.iterations)
        assert batch.status.converged[run] == alone.status.converged
        assert_same(of(batch, run, ("smoothed",)), of(alone, None, ("smoothed",)), 1e-8)
    assert len(iterations) > 1, "all runs took equally long: the test says nothing"
