"""The windows of a lag in machine code against those of NumPy."""

import numpy as np
import pytest
from carts import drawn
from crossed import crossed
from numpy.testing import assert_allclose, assert_array_equal
from test_compiled import assert_log, both
from test_compiled_control import X, Y, Z, readings, steep
from textbooks import assert_belief
from zoo import MODELS, RULES, model_of, of_run, recording

import pgm

pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")
# Runs that have not settled are compared as well.
pytestmark = pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")

# Three models in turn, so that the runs of a pack settle one by one.
WHICH = np.arange(9) % 3
NAMES = [name for name in MODELS if name not in ("grouped", "an exact range", "sharp readings")]


def assert_lagged(found, due, tolerance=1e-9, told="compiled"):
    """All that a posterior tells is that of another one."""
    model = due.graph.model
    for variable in (*model.states, *model.controls):
        for kind in ("filtered", "predicted"):
            one, other = (getattr(each, kind)[variable] for each in (found, due))
            assert_belief(one, other.mean, other.cov, tolerance)
        assert_belief(found[variable], due[variable].mean, due[variable].cov, tolerance)
    assert_log(found.log_evidence, due.log_evidence, tolerance)
    assert_array_equal(found.status.converged, due.status.converged)
    assert len(found.status.residuals) == len(due.status.residuals)
    for one, other in zip(found.status.residuals, due.status.residuals, strict=True):
        assert_allclose(one, other, rtol=1e-5, atol=1e-9)
    assert found.status.compilation.startswith(told)


@crossed(("name", "rule", "many"), NAMES, ["taylor", "unscented"], [False, True])
def test_models_of_all_kinds(name, rule, many):
    model, evidence = model_of(name, 1), of_run(recording(name), 1)
    if many:
        model, evidence = model_of(name, WHICH), of_run(recording(name), WHICH)
    options = {"lag": 3, "iterations": 12, "lineariser": RULES[rule]}
    assert_lagged(*both(pgm.smooth, model, evidence, **options), told="")


@crossed(("damping", "lag", "runs"), [0.0, 0.4], [0, 1, 2, 9], [(), (9,)])
def test_lags(lag, runs, damping):
    options = {"lag": lag, "iterations": 5, "damping": damping}
    assert_lagged(*both(pgm.smooth, steep(), readings(runs), **options))


@pytest.mark.parametrize("tolerance", [0.0, 1e-2])
def test_runs_of_a_pack_settle_by_themselves(tolerance):
    options = {"lag": 3, "iterations": 8, "tolerance": tolerance}
    assert_lagged(*both(pgm.smooth, steep(), readings((11,)), **options))


@crossed(
    ("noise", "rule", "runs"),
    [pgm.Huber(2.0), pgm.StudentT(4.0)],
    ["taylor", "unscented"],
    [(), (9,)],
)
def test_robust_noise(noise, rule, runs):
    evidence = readings(runs, outliers=True)
    options = {"lag": 3, "iterations": 4, "lineariser": RULES[rule]}
    found, due = both(pgm.smooth, steep(noise=noise), evidence, **options)
    assert_lagged(found, due, tolerance=1e-8)
    for sensor in (Y, Z):
        assert_allclose(found.weights[sensor], due.weights[sensor], atol=1e-7)


@pytest.mark.parametrize("runs", [(), (9,)])
def test_gates(runs):
    found, due = both(pgm.smooth, steep(), readings(runs), lag=3, iterations=4, gate=0.9)
    assert any(np.any(gated) for gated in due.rejected.values())
    assert_lagged(found, due)
    for sensor in (Y, Z):
        assert str(found.rejected[sensor]) == str(due.rejected[sensor])


@crossed(("seed", "runs", "rule"), range(3), [2, 9], ["taylor", "unscented"])
def test_hidden_controls_and_several_states(seed, runs, rule):
    """Sensors that are seldom read leave windows with nothing to linearise."""
    model, evidence, steps, _ = drawn(seed, True, runs=runs)
    options = {"lag": 2, "iterations": 6, "steps": steps, "lineariser": RULES[rule]}
    assert_lagged(*both(pgm.smooth, model, evidence, **options))


def test_runs_whose_readings_are_too_sharp_are_left_to_numpy():
    """They are answered by the general kernels alone, digit for digit."""
    model = steep().replace(prior=[pgm.GaussianCPD(X, [0.0, 0.0], 1e5)])
    evidence = readings((9,))
    for values in evidence.values():
        values[np.arange(9) != 4] = np.nan
    found, due = both(pgm.smooth, model, evidence, lag=3, iterations=3)
    assert_lagged(found, due, told="compiled, but for: readings are too sharp")
    assert found.status.compilation.endswith("in 1 of 9 runs")
    alone = pgm.smooth(model, of_run(evidence, 4), lag=3, iterations=3, compiled=False)
    assert_array_equal(found[X].mean[4], alone[X].mean)


def test_an_affine_chain_settles_at_once():
    model, evidence, steps, _ = drawn(1, False)
    noise = pgm.LinearGaussianCPD(Z, {X: [[1.0, 0.5]]}, cov=0.2, noise=pgm.Huber(2.0))
    found, due = both(pgm.smooth, model, evidence, lag=2, iterations=4, steps=steps)
    assert_belief(found[model.states[0]], due[model.states[0]].mean, due[model.states[0]].cov, 1e-9)
    robust = steep().replace(observation=[noise])
    evidence = {Z: readings(())[Z]}
    assert_lagged(*both(pgm.smooth, robust, evidence, lag=2, iterations=4))
