"""Chains linearised in machine code at all steps at once, and controlled, against NumPy's."""

import numpy as np
import pytest
from carts import drawn
from crossed import crossed
from numpy.testing import assert_allclose
from test_compiled import assert_posterior, both
from test_compiled_control import CONTROL, X, Z, readings, steep
from zoo import MODELS, RULES, model_of, of_run, recording

import pgm

pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")
# Runs that have not settled are compared as well.
pytestmark = pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")

# Three models in turn, so that runs settle one by one.
WHICH = np.arange(9) % 3
NAMES = ["plain", "wrapping drive", "noise by control", "a certain start", "everything"]
DAMPING = {"free": 0.0, "damped": 0.3, "controlled": CONTROL}


def assert_same(model, evidence, told="compiled", **options):
    found, due = both(pgm.smooth, model, evidence, **options)
    assert_posterior(found, due)
    for one, other in zip(found.status.residuals, due.status.residuals, strict=True):
        assert_allclose(one, other, rtol=1e-4, atol=1e-8)
    assert found.status.compilation.startswith(told)
    return found, due


@crossed(("name", "rule", "damping"), NAMES, ["taylor", "unscented"], list(DAMPING))
def test_models_of_all_kinds(name, rule, damping):
    assert name in MODELS
    model, evidence = model_of(name, WHICH), of_run(recording(name), WHICH)
    options = {"iterations": 12, "lineariser": RULES[rule], "damping": DAMPING[damping]}
    assert_same(model, evidence, told="", **options)


@crossed(("rule", "damping", "runs"), ["taylor", "unscented", "hermite"], list(DAMPING), [(), (9,)])
def test_bent_sensors(rule, damping, runs):
    options = {"iterations": 5, "lineariser": RULES[rule], "damping": DAMPING[damping]}
    assert_same(steep(), readings(runs), **options)


@crossed(("rule", "damping", "runs"), ["taylor", "unscented"], ["free", "controlled"], [(), (9,)])
def test_robust_noise(rule, damping, runs):
    evidence = readings(runs, outliers=True)
    options = {"iterations": 5, "lineariser": RULES[rule], "damping": DAMPING[damping]}
    found, due = assert_same(steep(noise=pgm.Huber(2.0)), evidence, **options)
    assert_allclose(found.weights[Z], due.weights[Z], atol=1e-7)


@pytest.mark.parametrize("damping", DAMPING)
def test_gates(damping):
    options = {"iterations": 5, "gate": 0.9, "damping": DAMPING[damping]}
    found, due = assert_same(steep(), readings((9,)), **options)
    assert str(found.rejected[Z]) == str(due.rejected[Z])


@crossed(("runs", "rule", "damping"), [2, 9], ["taylor", "unscented"], list(DAMPING))
def test_hidden_controls_and_several_states(rule, runs, damping):
    model, evidence, steps, _ = drawn(3, True, runs=runs)
    options = {"lineariser": RULES[rule], "damping": DAMPING[damping], "iterations": 8}
    assert_same(model, evidence, steps=steps, **options)


@pytest.mark.parametrize("damping", DAMPING)
def test_a_start(damping):
    start = {X: np.full((8, 2), 0.5)}
    options = {"iterations": 5, "damping": DAMPING[damping], "start": start}
    assert_same(steep(), readings(()), **options)
    found, due = assert_same(steep(), readings(()), gate=0.9, **options)
    assert any(np.any(gated) for gated in due.rejected.values())
    assert str(found.rejected[Z]) == str(due.rejected[Z])


def test_runs_that_numpy_linearises(monkeypatch):
    """Where machine code is not sure the plan's arrays are replaced: later ones are bound anew."""
    from pgm.beliefs.moments.compiled.points import Linearised

    once, calls = Linearised.linearise, []

    def doubtful(self, at, active):
        calls.append(once(self, at, active))
        return calls[-1] and len(calls) % 3 != 1

    monkeypatch.setattr(Linearised, "linearise", doubtful)
    for damping in DAMPING.values():
        options = {"iterations": 6, "lineariser": pgm.Unscented(), "damping": damping}
        assert_same(steep(noise=pgm.Huber(2.0)), readings((9,)), **options)
    assert len(calls) > 6
