"""Gauss–Newton steps in machine code against the general kernels, and a dense least squares."""

import numpy as np
import pytest
from carts import drawn
from crossed import crossed
from numpy.testing import assert_allclose
from robots import DRIVE, P0, SENSORS, Q, network, sighted, u, x
from scipy.optimize import least_squares
from test_compiled import assert_posterior, both
from textbooks import wrapped
from zoo import MODELS, SIGHT, lost, model_of, of_run, recording

import pgm
from pgm.beliefs.moments.passes import forward
from pgm.beliefs.moments.smoothers import smoother

pytest.importorskip("llvmlite", reason="machine code is written by LLVM")

ORDINARY = ["plain", "numerical jacobians", "wrapping drive", "noise by control"]
ORDINARY += ["noise by landmark", "a start for each run", "an unknown heading", "everything"]


@pytest.fixture
def alone(monkeypatch):
    """The general kernels refused, but to choices that are not compiled."""
    for module, name in ((smoother, "_iterated"), (forward, "_stepwise")):
        monkeypatch.setattr(module, name, plain_only(getattr(module, name)))


def plain_only(general):
    def refused(first, *arguments, **options):
        plan = getattr(first, "plan", first)
        assert plan.layout.compiled is False, "runs were left to the general kernels"
        return general(first, *arguments, **options)

    return refused


def loose(name, run=None):
    """A model of which no noise is singular."""
    model = model_of(name, run)
    if name != "everything":
        return model
    still = pgm.LinearGaussianCPD(lost, {lost.previous: 1.0}, cov=1e-3 * np.eye(2))
    return model.replace(transition=[*model.transition[:-1], still])


def assert_same(found, due):
    assert_posterior(found, due)
    ours, theirs = np.asarray(found.status.residuals), np.asarray(due.status.residuals)
    assert_allclose(ours, theirs, rtol=1e-7, atol=1e-8)


@crossed(("name", "run"), ORDINARY, {"batch": None, "one": 1})
def test_models_of_all_kinds(alone, name, run):
    evidence = recording(name) if run is None else of_run(recording(name), run)
    assert_same(*both(pgm.smooth, loose(name, run), evidence, iterations=20))


@crossed(
    ("given", "options"),
    {"filtered": False, "start": True},
    [
        {"iterations": 2, "tolerance": 0},
        {"iterations": 40},
        {"iterations": 5, "tolerance": 0, "damping": 0.4},
        {"iterations": 40, "tolerance": 0.03},
    ],
)
def test_schedules_and_starts(alone, options, given):
    evidence = recording("plain")
    filtered = pgm.smooth(MODELS["plain"], evidence, compiled=False)[x].mean
    start = {x: filtered + np.array([0.3, -0.2, 2 * np.pi])} if given else None
    graphs = [pgm.compile(MODELS["plain"], 8, compiled=choice) for choice in (True, False)]
    schedule = pgm.Smoothing(**options)
    assert_same(*(pgm.infer(graph, evidence, schedule=schedule, start=start) for graph in graphs))


@pytest.mark.parametrize("steps", [1, 3, 30])
def test_hidden_controls_and_few_readings(alone, steps):
    model, evidence, *_ = drawn(5, nonlinear=True, steps=steps)
    assert_same(*both(pgm.smooth, model, evidence, steps=steps, iterations=3))


def test_linear_models_are_not_linearised_again():
    model, evidence, steps, _ = drawn(5)
    assert_same(*both(pgm.smooth, model, evidence, steps=steps, iterations=3))


@pytest.mark.parametrize("threads", [1, 2])
def test_runs_that_converge_one_after_another(alone, threads):
    evidence = recording("plain")
    values = evidence[SIGHT.z].values + np.array([0.0, 0.3, 1.2])[:, None, None]
    given = {u: evidence[u], SIGHT.z: replace_values(evidence[SIGHT.z], values)}
    options = {"iterations": 30, "tolerance": 1e-3}
    found = pgm.smooth(MODELS["plain"], given, compiled=pgm.Compiled(threads=threads), **options)
    due = pgm.smooth(MODELS["plain"], given, compiled=False, **options)
    assert due.status.converged.all()
    assert len(set(map(tuple, np.array(due.status.residuals).T))) == 3
    assert_same(found, due)


def replace_values(sightings, values):
    return pgm.sightings(values, sightings.step, sightings.given)


@pytest.mark.parametrize("name", ["a motion without noise", "an exact range", "grouped"])
def test_others_are_left_to_the_general_kernels(name):
    found = both(pgm.smooth, MODELS[name], recording(name), iterations=20)
    assert_posterior(*found, 1e-7)


@pytest.mark.parametrize("function", [np.sqrt, np.log])
def test_what_is_refused_is_refused_alike(function):
    """Far off the function has no value, though that of the logarithm has a slope."""
    bent = pgm.NonlinearGaussianCPD(
        SENSORS["range_only"].z, (x,), lambda s: function(s[..., :1] + 5.0), cov=0.1
    )
    values = np.full((12, 1), 2.0)
    evidence, told = {u: np.ones((12, 2)), bent.child: values}, []
    start = np.full((13, 3), -9.0)
    for choice in (True, False):
        graph = pgm.compile(network(bent), 12, compiled=choice)
        with pytest.raises(pgm.PgmError) as refusal:
            pgm.infer(graph, evidence, schedule=pgm.Smoothing(iterations=3), start={x: start})
        told.append((type(refusal.value), str(refusal.value)))
    assert told[0] == told[1]


def test_the_optimum_is_that_of_a_dense_least_squares(alone):
    model, evidence = network(SIGHT.cpd()), sighted()
    found = pgm.smooth(model, evidence, compiled=True, iterations=50, tolerance=1e-12)[x]
    readings, commands = evidence[SIGHT.z], evidence[u]
    white = [np.linalg.inv(np.linalg.cholesky(cov)) for cov in (P0, Q, SIGHT.cov)]
    landmarks = next(iter(readings.given.values()))

    def residuals(flat):
        states = flat.reshape(-1, 3)
        off = readings.values - SIGHT.function(states[readings.step], landmarks)
        moved = states[1:] - DRIVE(states[:-1], commands)
        parts = states[:1], moved, wrapped(off, SIGHT.z.angle_mask)
        return np.concatenate([(part @ w.T).ravel() for part, w in zip(parts, white, strict=True)])

    start = found.mean.ravel() + 0.01
    due = least_squares(residuals, start, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert_allclose(found.mean.ravel(), due.x, atol=1e-7)
    cov = np.linalg.inv(due.jac.T @ due.jac).reshape(13, 3, 13, 3)
    each = np.arange(13)
    assert_allclose(found.cov, cov[each, :, each], atol=1e-6)
