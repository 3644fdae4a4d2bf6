"""Models that a search of drawn ones has found to differ in machine code, against NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from crossed import crossed
from numpy.testing import assert_allclose
from test_compiled import assert_posterior, both

import pgm
from pgm.beliefs.moments.passes import forward
from pgm.linearisation import family

pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")

X = pgm.Variable("x", components=("a", "b"))
Z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))


def walk(sensor, size=2, before=()):
    x = X if size == 2 else pgm.Variable("x", components=tuple(f"c{k}" for k in range(size)))
    given = {x.previous: 0.9} | {cpd.child: np.ones((size, 1)) for cpd in before}
    move = pgm.LinearGaussianCPD(x, given, cov=0.1)
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, np.zeros(size), 1.0)], [*before, move], sensor(x)
    )


def sight(**options):
    def seen(state):
        return np.stack([state[..., 0], 3.0 + np.arctan(state[..., 1])], axis=-1)

    return lambda x: [pgm.NonlinearGaussianCPD(Z, x, seen, cov=0.05, **options)]


def readings(runs):
    rng = np.random.default_rng(4)
    values = rng.normal(size=(*runs, 6, 2)) * [1.0, 0.4] + [0.0, 3.0]
    values[..., 3, 0] += 20.0
    values[..., 1, 0] = np.nan
    values[..., 1] += 2 * np.pi * rng.integers(-3, 4, (*runs, 6))
    return {Z: values}


@crossed(("runs", "rule"), [(), (9,)], [pgm.Unscented(), pgm.GaussHermite(3)])
def test_an_angle_that_is_the_same_everywhere(rule, runs):
    def still(state):
        return np.concatenate([state[..., :1], np.full(state[..., :1].shape, 3.0)], axis=-1)

    model = walk(lambda x: [pgm.NonlinearGaussianCPD(Z, x, still, cov=0.05)])
    assert_posterior(*both(pgm.smooth, model, readings(runs), lineariser=rule))


@pytest.mark.parametrize("size", [2, 8])
def test_a_control_without_hidden_parents_for_packs_of_runs(size):
    """Its matrix has no entries."""
    u, command = pgm.variables("u command")
    control = pgm.NonlinearGaussianCPD(u, command, np.tanh, cov=0.1)
    model = walk(sight(), size, before=[control])
    evidence = readings((9,)) | {command: np.linspace(-1.0, 1.0, 6)[:, None]}
    assert_posterior(*both(pgm.smooth, model, evidence))


@crossed(
    ("infer", "iterations", "runs", "noise"),
    [pgm.filter, pgm.smooth],
    [1, 3],
    [(), (9,)],
    [None, pgm.Huber(1.345), pgm.StudentT(1.0)],
)
@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
def test_what_a_gate_rejects_has_an_innovation(infer, iterations, runs, noise):
    model = walk(sight(noise=noise))
    found, due = both(infer, model, readings(runs), gate=0.99, iterations=iterations)
    assert due.rejected[Z].rejected.any()
    one, other = found.innovations[Z], due.innovations[Z]
    assert_allclose(one.residual, other.residual, rtol=1e-7, atol=1e-8)
    assert_allclose(one.cov, other.cov, rtol=1e-7)


@crossed(
    ("iterations", "runs", "size", "rule", "noise"),
    [1, 3],
    [(), (9,)],
    [2, 8],
    [pgm.Taylor(), pgm.Unscented(), pgm.MonteCarlo(40)],
    [pgm.Huber(1.345), pgm.StudentT(4.0)],
)
@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
def test_robust_sightings_of_which_a_step_has_one_and_then_several(
    iterations, runs, size, rule, noise
):
    """One alone is weighed by itself, in code that is not that of several; some are missing."""
    model, values = walk(sight(noise=noise), size), readings(runs)[Z]
    graphs = [pgm.compile(model, steps=6, compiled=choice) for choice in (True, False)]
    for step in ([1, 2, 3, 4, 5, 6], [1, 2, 2, 4, 4, 4], [0, 1, 3, 4, 5, 6]):
        seen = {Z: pgm.sightings(values, step=step)}
        found, due = (
            pgm.infer(graph, seen, schedule=pgm.Smoothing(iterations=iterations), lineariser=rule)
            for graph in graphs
        )
        assert_posterior(found, due)
        assert_allclose(found.weights[Z], due.weights[Z], atol=1e-8)


@crossed(
    ("iterations", "infer", "runs", "rule"),
    [1, 3],
    [pgm.filter, pgm.smooth],
    [(), (9,)],
    [pgm.Taylor(), pgm.MonteCarlo(40)],
)
@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
def test_called_sightings_of_a_step_beside_a_robust_sensor(infer, iterations, runs, rule):
    """Each has the linearisation at its own landmark when weights are found."""
    mark, far = pgm.Variable("mark"), pgm.Variable("far")

    def off(state, mark):
        if np.any(state > 1e9):
            return mark
        return np.arctan(state[..., :1] - mark)

    def sensors(x):
        yield from sight(noise=pgm.Huber(1.345))(x)
        yield pgm.NonlinearGaussianCPD(far, (x, mark), off, cov=0.01, lineariser=rule)

    rng = np.random.default_rng(2)
    step, marks = np.repeat([1, 2, 3, 5], 3), rng.normal(size=(12, 1))
    seen = pgm.sightings(rng.normal(size=(*runs, 12, 1)), step=step, given={mark: marks})
    evidence = readings(runs) | {far: seen}
    model = walk(lambda x: list(sensors(x)))
    assert_posterior(*both(infer, model, evidence, iterations=iterations), smooth=False)


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
def test_runs_left_by_a_stored_sweep_keep_their_linearisations(monkeypatch):
    """Memory of a plan's slopes that is not written yet holds anything."""
    made = family.vacant

    def spoilt(*shape):
        room = made(*shape)
        room.fill(7.7)
        return room

    def left(plan, schedule, *arguments, **options):
        found = swept(plan, schedule, *arguments, **options)
        return replace(found, left=[slice(4, 5)]) if schedule is None and found else found

    swept = forward.compiled.forward
    monkeypatch.setattr(family, "vacant", spoilt)
    monkeypatch.setattr(forward.compiled, "forward", left)

    def off(state):
        return np.sin(state) if np.any(state < 1e9) else state

    def sensors(x):
        return [pgm.NonlinearGaussianCPD(pgm.Variable("y", components=("p", "q")), x, off, cov=0.1)]

    model = walk(sensors)
    evidence = {model.sensors[0]: np.random.default_rng(3).normal(size=(9, 6, 2))}
    assert_posterior(*both(pgm.smooth, model, evidence, iterations=2, lineariser=pgm.Unscented()))
