"""Fixed lags linearised once: x[t] given the readings up to t + lag; results of all kinds."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import naive
import numpy as np
import pytest
from carts import drawn, fix, lagged, place, push, speed, two_states
from crossed import crossed
from numpy.testing import assert_array_equal
from robots import SENSORS, network, sighted, x
from textbooks import assert_belief, assert_covs, assert_log, assert_means
from zoo import MODELS, RULES, TOLERANCE, assert_same, model_of, of, of_run, recording
from zoo import T as STEPS

import pgm
from pgm.beliefs.moments.parts import split as parts
from pgm.evidence import Sightings

ROBOT = network(SENSORS["range_bearing"].cpd())


def until(evidence, last):
    """The evidence of the steps up to a last one."""
    return {
        variable: pgm.sightings(
            given.values[..., given.step <= last, :],
            given.step[given.step <= last],
            {v: rows[..., given.step <= last, :] for v, rows in given.given.items()},
        )
        if isinstance(given, Sightings)
        else given[..., :last, :]
        for variable, given in evidence.items()
    }


@crossed(("seed", "lag"), range(3), [0, 1, 2, 3, 7, 12])
def test_beliefs_are_those_of_the_joint_given_the_readings_up_to_the_lag(seed, lag):
    model, evidence, steps, due = drawn(seed)
    found = lagged(model, evidence, lag, steps)
    assert found.kind == pgm.Kind(lag)
    assert repr(found.status) == "Status(nothing to iterate)"
    assert found.log_evidence_kind == "exact"
    for run in range(2):
        for t in range(steps + 1):
            for v in (place, speed, push) if t else (place, speed):
                mean, cov, _ = due(run, min(t + lag, steps), v.at(t))
                belief = found[v.at(t)]
                assert_means(belief.mean[run], mean, cov, 1e-11)
                assert_covs(belief.cov[run], cov, 1e-11)
                assert_means(found.filtered[v.at(t)].mean[run], due(run, t, v.at(t))[0], cov, 1e-11)
        assert_log(found.log_evidence[run], due(run, steps)[2], 1e-11)


@pytest.mark.parametrize("lag", [7, 40])
def test_a_lag_that_covers_the_record_is_the_smoother(lag):
    model, evidence, steps, _ = drawn(5, runs=40)
    found, due = lagged(model, evidence, lag, steps), pgm.smooth(model, evidence, steps=steps)
    for v in (place, speed, push):
        assert_belief(found[v], due[v].mean, due[v].cov, 1e-12)
    assert_array_equal(found.log_evidence, due.log_evidence)


def test_without_a_lag_it_is_the_filter():
    evidence = recording("everything")
    for options in ({}, {"iterations": 20, "damping": 0.2}):
        found = lagged(MODELS["everything"], evidence, 0, **options)
        due = pgm.filter(MODELS["everything"], evidence, **options)
        assert (found.kind, str(found.kind)) == (due.kind, "filtered")
        assert_same(of(found), of(due), 0.0)
        assert repr(found.status) == repr(due.status)


def test_a_long_chain_of_one_run_and_of_many():
    """All steps go back at once, in chunks."""
    rng = np.random.default_rng(8)
    model = two_states(rng).replace(observation=[pgm.LinearGaussianCPD(fix, {place: 1.0}, cov=0.3)])
    values = rng.normal(size=(2, 3200, 1))
    for readings in (values[0], np.concatenate([values] * 20)[:, :90]):
        found = pgm.smooth(model, {fix: readings}, lag=9)
        steps = readings.shape[-2]
        for t in (1, 70, steps - 10, steps - 9, steps - 1):
            last = min(t + 9, steps)
            due = pgm.smooth(model, {fix: readings[..., :last, :]})[place.at(t)]
            assert_belief(found[place.at(t)], due.mean, due.cov, 1e-11)


@crossed(("rule", "name"), ["taylor", "unscented"], list(MODELS))
def test_linearised_once_it_is_the_textbook_s_smoother_of_the_readings_so_far(name, rule):
    run, lag = 1, 2
    model, evidence = model_of(name, run), of_run(recording(name), run)
    found = lagged(model, evidence, lag, rule=RULES[rule])
    batch = lagged(MODELS[name], recording(name), lag, rule=RULES[rule])
    assert_same(of(batch, run), of(found), TOLERANCE.get(name, 1e-9))
    for t in (0, 3, STEPS - lag + 1, STEPS):
        last = min(t + lag, STEPS)
        due = naive.run(model, until(evidence, last), last, rule)
        mean, cov = due.smoothed[t]
        for variable in model.states:
            own, belief = due.slices[t][variable.at(t)], found[variable.at(t)]
            bound = TOLERANCE.get(name, 1e-9)
            assert_means(belief.mean, mean[own], cov[np.ix_(own, own)], bound)
            assert_covs(belief.cov, cov[np.ix_(own, own)], bound)


@pytest.mark.parametrize("iterations", [1, 3])
def test_what_is_kept_and_what_executors_find_is_the_same(iterations, monkeypatch):
    monkeypatch.setattr(parts, "MOST", 3)
    evidence = sighted(runs=7)
    call = partial(pgm.smooth, ROBOT, evidence, lag=2, iterations=iterations, tolerance=0)
    whole, kept = call(), call(keep=[x])
    assert (
        repr(kept).splitlines()[0] == "Posterior(fixed-lag (2), kept [x], steps 0..12, runs (7,))"
    )
    with ThreadPoolExecutor(2) as pool:
        for found in (kept, call(executor=pool), call(executor=pool, keep=x)):
            assert_belief(found[x], whole[x].mean, whole[x].cov, 1e-12)
            assert_log(found.log_evidence, whole.log_evidence, 1e-12)
            assert found.kind == whole.kind
        joined = call(executor=pool)
    for result in (joined, pickle.loads(pickle.dumps(whole))):
        assert_belief(result.filtered[x], whole.filtered[x].mean, whole.filtered[x].cov, 1e-12)
        two = [posterior.joint(x.at(3), x.at(5)) for posterior in (result, whole)]
        assert_belief(two[0], two[1].mean, two[1].cov, 1e-10)
        weights = [posterior.belief(4).log_integral for posterior in (result, whole)]
        assert_log(*weights, 1e-10)


def test_no_steps_and_no_readings():
    model = drawn(1, nonlinear=True)[0]
    for options in ({}, {"iterations": 3}):
        found = pgm.smooth(
            model, {fix: pgm.sightings([[0.5]], step=[0])}, steps=0, lag=2, **options
        )
        due = pgm.filter(model, {fix: pgm.sightings([[0.5]], step=[0])}, steps=0)
        assert_belief(found[place], due[place].mean, due[place].cov, 1e-9)
        found = pgm.smooth(model, {}, steps=3, lag=2, **options)
        due = pgm.filter(model, {}, steps=3)
        assert_belief(found[place], due[place].mean, due[place].cov, 1e-9)
        assert found.log_evidence == 0.0
