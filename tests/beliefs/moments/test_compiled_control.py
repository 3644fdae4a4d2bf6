"""Iterated updates in machine code whose steps are judged by their cost, against NumPy's."""

import numpy as np
import pytest
from carts import drawn
from crossed import crossed
from robots import SENSORS, network, sighted
from test_compiled import assert_posterior, both
from zoo import RULES, model_of, of_run, recording

import pgm

pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")
# Runs that have not settled are compared as well.
pytestmark = pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")

CONTROL = pgm.LevenbergMarquardt()
# Three models in turn, so that the runs of a pack settle one by one.
WHICH = np.arange(9) % 3
X = pgm.Variable("x", components=("p", "q"))
Y, Z = pgm.variables("y z")


def drifts(state):
    return state + 0.1 * np.sin(state)


def bent(state):
    """A step along it often overshoots."""
    return 3.0 * np.arctan(2.0 * state[..., :1])


def squared(state):
    return (state[..., :1] - 1.0) ** 2 + state[..., 1:]


def steep(**sensor):
    """A prior so wide, and sensors so bent, that full steps raise the cost."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, [0.0, 0.0], 4.0)],
        [pgm.NonlinearGaussianCPD(X, (X.previous,), drifts, cov=0.5)],
        [
            pgm.NonlinearGaussianCPD(Y, (X,), bent, cov=0.2, **sensor),
            pgm.NonlinearGaussianCPD(Z, (X,), squared, cov=0.5),
        ],
    )


def readings(runs, steps=6, *, outliers=False):
    rng = np.random.default_rng(3)
    found = {}
    for variable in (Y, Z):
        values = rng.normal(scale=3.0, size=(*runs, steps + 1, 1))
        values[rng.random(values.shape) < 0.2] = np.nan
        if outliers:
            values[rng.random(values.shape) < 0.2] += 30.0
        found[variable] = values
    return found


@crossed(("iterations", "rule", "runs"), [2, 12], ["taylor", "unscented"], [(), (9,)])
def test_steps_that_raise_the_cost_are_held_back(runs, rule, iterations):
    options = {"lineariser": RULES[rule], "iterations": iterations}
    found, due = both(pgm.filter, steep(), readings(runs), damping=CONTROL, **options)
    assert_posterior(found, due, smooth=False)
    assert found.status.compilation.startswith("compiled")
    free = pgm.filter(steep(), readings(runs), **options)
    assert np.nanmax(abs(free[X].mean - found[X].mean)) > 1e-3


@crossed(("runs", "control"), [(), (9,)], [(0.5, 2.0, 3), (1e-6, 1e4, 1), (1e13, 3.0, 2)])
def test_weights_and_tries(control, runs):
    options = {"iterations": 8, "damping": pgm.LevenbergMarquardt(*control)}
    found = both(pgm.filter, steep(), readings(runs), **options)
    assert_posterior(*found, smooth=False)
    assert found[0].status.compilation.startswith("compiled")


@crossed(("noise", "runs"), [pgm.Huber(2.0), pgm.StudentT(4.0), pgm.Cauchy(2.0)], [(), (9,)])
def test_robust_noise(noise, runs):
    evidence = readings(runs, outliers=True)
    options = {"iterations": 6, "damping": CONTROL}
    found = both(pgm.filter, steep(noise=noise), evidence, **options)
    assert_posterior(*found, smooth=False, tolerance=1e-8)
    assert found[0].status.compilation.startswith("compiled")


def test_expected_losses_are_left_to_numpy():
    rule = {"lineariser": pgm.Unscented()}
    options = {"iterations": 6, "damping": CONTROL, **rule}
    found = both(pgm.filter, steep(noise=pgm.Huber(2.0)), readings(()), **options)
    assert_posterior(*found, smooth=False)
    assert "expected losses judge steps" in found[0].status.compilation


@pytest.mark.parametrize("runs", [(), (9,)])
def test_gates(runs):
    evidence = readings(runs)
    options = {"iterations": 6, "damping": CONTROL, "gate": 0.9}
    found, due = both(pgm.filter, steep(), evidence, **options)
    assert_posterior(found, due, smooth=False)
    assert found.status.compilation.startswith("compiled")


@crossed(("name", "rule"), ["plain", "a certain start"], ["taylor", "unscented"])
def test_angles(name, rule):
    model, evidence = model_of(name, WHICH), of_run(recording(name), WHICH)
    options = {"lineariser": RULES[rule], "iterations": 20, "damping": CONTROL}
    assert_posterior(*both(pgm.filter, model, evidence, **options), smooth=False)


def test_hidden_controls_and_several_sensors():
    model, evidence, steps, _ = drawn(3, True)
    options = {"steps": steps, "iterations": 20, "damping": CONTROL}
    found = both(pgm.filter, model, evidence, **options)
    assert_posterior(*found, smooth=False)
    assert found[0].status.compilation.startswith("compiled")


def test_a_point_beyond_the_domain_of_a_function_costs_more_than_any():
    def root(state):
        with np.errstate(invalid="ignore"):
            return np.sqrt(state[..., :1])

    sensor = SENSORS["range_bearing"].cpd()
    assert_posterior(
        *both(pgm.filter, network(sensor), sighted(2), iterations=4, damping=CONTROL), smooth=False
    )
    model = steep()
    model = model.replace(
        prior=[pgm.GaussianCPD(X, [4.0, 0.0], 4.0)],
        observation=[pgm.NonlinearGaussianCPD(Y, (X,), root, cov=0.01)],
    )
    evidence = {Y: np.full((3, 1), 0.4)}
    options = {"iterations": 10, "damping": CONTROL}
    assert_posterior(*both(pgm.filter, model, evidence, **options), smooth=False)
