"""Models of all kinds with rules of all kinds: one run, a few that differ, many, and online.

One run and many go through different kernels; both are held to a textbook written plainly.
"""

from functools import cache
from types import SimpleNamespace

import naive
import numpy as np
import pytest
from crossed import crossed
from numpy.testing import assert_allclose
from plain import evidence_of, linear_network
from textbooks import assert_belief, assert_log, exact_linear
from zoo import (
    MODELS,
    RULES,
    RUNS,
    SIGHT,
    STEP,
    TOLERANCE,
    T,
    assert_same,
    at_step,
    model_of,
    of,
    of_run,
    recording,
    smoothed,
)

import pgm

THOROUGH = ["taylor", "unscented", "negative weights", "bare function"]
FEW = ["plain", "grouped", "a certain start", "everything"]
CASES = [(name, rule) for name in MODELS for rule in THOROUGH]
CASES += [(name, rule) for name in FEW for rule in RULES if rule not in THOROUGH]
models = pytest.mark.parametrize("name", MODELS)
both = pytest.mark.parametrize("rule", ["taylor", "unscented"])


@pytest.mark.parametrize(("name", "rule"), CASES)
def test_each_run_of_a_batch_is_that_run_alone(name, rule):
    # Draws of its own depend on how many runs there are before it.
    run = 0 if rule == "fresh" else RUNS - 1
    batch, alone = smoothed(name, rule), smoothed(name, rule, run)
    assert_same(of(batch, run), of(alone), TOLERANCE.get(name, 1e-9))
    assert batch.status.converged[run] == alone.status.converged
    for sensor in alone.innovations:
        ours, theirs = batch.innovations[sensor], alone.innovations[sensor]
        assert_allclose(ours.residual[run], theirs.residual, rtol=0, atol=1e-8)
        assert_allclose(ours.cov[run], theirs.cov, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize(("name", "rule"), [case for case in CASES if case[1] in naive.RULES])
def test_they_are_the_textbooks(name, rule):
    run, tolerance = 1, TOLERANCE.get(name, 1e-9)
    model, posterior = model_of(name, run), smoothed(name, rule)
    due = naive.run(model, of_run(recording(name), run), T, rule)
    found = of(posterior, run)
    for (kind, variable), (mean, cov) in found.beliefs.items():
        steps = range(variable in model.controls, T + 1)
        places = [due.slices[step][variable.at(step)] for step in steps]
        moments = [getattr(due, kind)[step] for step in steps]
        means = np.array([mean[p] for (mean, _), p in zip(moments, places, strict=True)])
        covs = np.array([cov[np.ix_(p, p)] for (_, cov), p in zip(moments, places, strict=True)])
        assert_belief(SimpleNamespace(mean=mean, cov=cov), means, covs, tolerance)
    assert_log(found.log_evidence, due.log_evidence, tolerance)
    if name == "everything":  # whose readings of a step are of several sensors
        return
    innovations, close = posterior.innovations[SIGHT.z], {"rtol": 1e-7, "atol": 1e-9}
    for step, (residual, predictive) in due.innovations.items():
        rows = np.flatnonzero(step == STEP)
        there = ~np.isnan(residual)
        assert_allclose(innovations.residual[run, rows].ravel(), residual, **close)
        for k, row in enumerate(rows):
            own = slice(2 * k, 2 * k + 2)
            both = np.outer(there[own], there[own])
            cov = np.where(both, predictive[own, own], np.nan)
            assert_allclose(innovations.cov[run, row], cov, **close)
        if there.any():
            nis = residual[there] @ np.linalg.solve(
                predictive[np.ix_(there, there)], residual[there]
            )
            assert_allclose(innovations.nis[run, step], nis, rtol=1e-5)


@models
@both
def test_a_filter_of_many_runs(name, rule):
    """Keeps no more than beliefs until it is asked for more."""
    which = np.arange(40) % RUNS
    posterior = pgm.filter(
        model_of(name, which), of_run(recording(name), which), lineariser=RULES[rule]
    )
    for run in range(37, 40):
        due = of(smoothed(name, rule), which[run], ("filtered", "predicted"))
        assert_same(of(posterior, run, ("filtered", "predicted")), due, TOLERANCE.get(name, 1e-9))


@models
@crossed(("run", "rule"), {"batch": None, "one": 1}, ["taylor", "unscented", "fresh"])
def test_online_is_the_filter(name, rule, run):
    model = model_of(name, run)
    evidence = recording(name) if run is None else of_run(recording(name), run)
    due = pgm.filter(model, evidence, lineariser=RULES[rule])
    robot = pgm.OnlineFilter(model, RULES[rule])
    belief, tolerance = robot.initial(), TOLERANCE.get(name, 1e-9)
    for step in range(T + 1):
        inputs, readings = at_step(evidence, step)
        if step:
            belief = robot.predict(belief, inputs)
        assert_step(belief, due.predicted, tolerance)
        belief = robot.update(belief, readings)
        assert_step(belief, due, tolerance)
        assert (belief.cov == belief.cov.swapaxes(-1, -2)).all()
    assert belief.log_evidence.shape == belief.status.converged.shape == due.log_evidence.shape
    assert_log(belief.log_evidence, due.log_evidence, tolerance)


def assert_step(belief, marginals, tolerance):
    """Before they are told apart runs share one belief."""
    for variable in belief.layout.model.states:
        found, due = belief[variable], marginals[variable.at(belief.step)]
        mean = np.broadcast_to(found.mean, due.mean.shape)
        cov = np.broadcast_to(found.cov, due.cov.shape)
        assert_belief(SimpleNamespace(mean=mean, cov=cov), due.mean, due.cov, tolerance)


def by_function(cpd, slopes):
    """The same linear CPD as any function; its derivatives may be left to be found."""
    if not cpd.given or not isinstance(cpd.cov, np.ndarray):
        return cpd

    def mean(*values):
        return sum((values[k] @ F.T for k, F in enumerate(cpd.matrices.values())), cpd.offset)

    jacobian = {
        parent: lambda *values, F=F: np.broadcast_to(F, (*values[0].shape[:-1], *F.shape))
        for parent, F in cpd.matrices.items()
    }
    return pgm.NonlinearGaussianCPD(
        cpd.child, tuple(cpd.matrices), mean, cpd.cov, jacobian=jacobian if slopes else None
    )


@cache
def dense():
    """A linear network, the evidence of two runs, and what is due, in rational numbers."""
    linear, steps, inputs, readings = linear_network()
    evidence, due = [], []
    for shift in (0.0, 0.5):
        rows = [
            (sensor, step, [value[0] + shift], known) for sensor, step, value, known in readings
        ]
        exact = exact_linear(linear, steps, inputs, rows)
        smoothed = [
            {v: exact.joint[(v.at(k),)] for v in beliefs}
            for k, beliefs in enumerate(exact.filtered)
        ]
        evidence.append(evidence_of(inputs, rows))
        exact.smoothed = smoothed
        due.append(exact)
    return linear, evidence, due


@pytest.mark.parametrize(
    ("rule", "slopes"),
    [("taylor", False), *((rule, True) for rule in RULES if rule != "prior moments")],
)
def test_any_rule_of_linear_functions_is_the_dense_joint(rule, slopes):
    """Of hidden controls, an unknown, and several readings of two sensors at a step."""
    linear, evidence, due = dense()
    parts = (linear.prior, linear.transition, linear.observation)
    model = pgm.DynamicBayesianNetwork(
        *([by_function(cpd, slopes) for cpd in cpds] for cpds in parts)
    )
    batch = dict(evidence[0])
    for sensor in linear.sensors:
        values = np.stack([each[sensor].values for each in evidence])
        batch[sensor] = pgm.sightings(values, evidence[0][sensor].step)
    together = pgm.smooth(model, batch, lineariser=RULES[rule])
    for run in (0, 1):
        alone = pgm.smooth(model, evidence[run], lineariser=RULES[rule])
        for found in (of(alone), of(together, run)):
            for (kind, variable), (mean, cov) in found.beliefs.items():
                moments = [step[variable] for step in getattr(due[run], kind) if variable in step]
                means, covs = (np.array(part) for part in zip(*moments, strict=True))
                assert_belief(SimpleNamespace(mean=mean, cov=cov), means, covs, 1e-8)
            assert_log(found.log_evidence, due[run].joint.log_evidence, 1e-8)
