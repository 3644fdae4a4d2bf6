"""Sightings of unknown identity in machine code, against the general kernels."""

import re
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from test_compiled import both
from textbooks import assert_belief

import pgm
from pgm.beliefs.moments.association import association
from pgm.beliefs.moments.compiled import sweep

pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("v", "turn"))
m = pgm.Variable("m", components=("east", "north"))
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
y = pgm.Variable("y", components=("east", "north"))
c = pgm.Variable("c")
T = 12
MARKS = np.array([[4.0, 2.0], [-3.0, 4.0], [4.0, 2.0], [2.0, -4.0], [6.0, 5.0]])
CONTROLS = np.tile([1.0, 0.3], (T, 1))
# Some steps have several sightings, some none.
STEPS = {z: np.array([0, 1, 2, 4, 4, 4, 5, 6, 7, 9, 10, 11, 12]), y: np.arange(1, T + 1)}


def drive(x, u):
    heading = x[..., 2] + 0.5 * u[..., 1]
    moved = [u[..., 0] * np.cos(heading), u[..., 0] * np.sin(heading), u[..., 1]]
    return x + np.stack(moved, axis=-1)


def range_bearing(x, m):
    away = m - x[..., :2]
    bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
    return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)


def branching(x, m):
    return range_bearing(x, m) if np.all(m[..., 0] < 1e9) else np.zeros((*m.shape[:-1], 2))


def by_candidate(m):
    return 0.1 + 0.02 * np.abs(m)


def network(seen=range_bearing):
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, mean=[0, 0, 0], cov=np.square([0.3, 0.3, 0.1]))],
        transition=[
            pgm.NonlinearGaussianCPD(
                x, given=(x.previous, u), function=drive, cov=np.square([0.1, 0.1, 0.05])
            )
        ],
        observation=[
            pgm.NonlinearGaussianCPD(z, given=(x, m), function=seen, cov=np.square([0.3, 0.1])),
            pgm.LinearGaussianCPD(
                y,
                given={m: np.eye(2), x: -np.eye(2, 3)},
                cov=pgm.noise(by_candidate, given=m, diagonal=True),
            ),
            pgm.LinearGaussianCPD(c, given={x: [[0.0, 0.0, 1.0]]}, cov=0.01),
        ],
    )


MODEL = network()


def evidence(runs=(), missing=False, seed=1, sensors=(z, y), **named):
    """What some robots see of landmarks that nobody named, some of it clutter."""
    rng, unknown = (
        np.random.default_rng(seed),
        pgm.unknown(MARKS, **({"association": "likelihood"} | named)),
    )
    here = [np.zeros((*runs, 3))]
    for control in CONTROLS:
        noise = rng.normal(size=(*runs, 3)) * [0.1, 0.1, 0.05]
        here.append(drive(here[-1], np.broadcast_to(control, (*runs, 2))) + noise)
    truth, found = np.stack(here, axis=-2), {u: CONTROLS}
    for sensor, steps in STEPS.items():
        which = MARKS[rng.integers(0, len(MARKS), (*runs, len(steps)))]
        at = truth[..., steps, :]
        values = range_bearing(at, which) if sensor == z else which - at[..., :2]
        values = values + 0.2 * rng.normal(size=values.shape)
        clutter = rng.random(values.shape[:-1]) < 0.1
        values[clutter] += rng.uniform(-6, 6, (int(clutter.sum()), 2))
        if missing:
            values[rng.random(values.shape) < 0.2] = np.nan
        if sensor in sensors:
            found[sensor] = pgm.sightings(values, step=steps, given={m: unknown})
    found[c] = truth[..., 1:, 2:] + 0.1 * rng.normal(size=(*runs, T, 1))
    return found


def assert_associated(found, due):
    """The same choices, of the same probability."""
    for sensor, others in due.associations.items():
        ours = found.associations[sensor]
        assert_array_equal(ours.candidate, others.candidate)
        assert_array_equal(ours.step, others.step)
        assert_allclose(ours.probability, others.probability, atol=1e-9)


def assert_same(found, due):
    """The same choices and beliefs."""
    assert_associated(found, due)
    (state,) = due.graph.model.states
    assert_belief(found[state], due[state].mean, due[state].cov, 1e-10)
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)


CLUTTER = {"spurious": 0.1, "new": 0.05, "volume": 60.0}


@pytest.mark.parametrize(
    ("runs", "missing", "named", "schedule"),
    [
        ((), False, {"gate": 0.99, **CLUTTER}, pgm.Smoothing()),
        ((17,), False, {"gate": 0.99, **CLUTTER}, pgm.Filtering()),
        ((17,), True, {"weights": [1.0, 2.0, 1.0, 0.0, 1.0]}, pgm.Filtering(gate=0.999)),
    ],
)
def test_sightings_of_several_sensors(runs, missing, named, schedule):
    """Two of the candidates are one and the same."""
    graphs = [pgm.compile(MODEL, T, compiled=choice) for choice in (True, False)]
    for seed in (1, 2):  # the same code, of other numbers
        seen = evidence(runs, missing, seed, **named)
        found, due = (pgm.infer(graph, seen, schedule=schedule) for graph in graphs)
        assert found.status.compilation == "compiled"
        assert_same(found, due)


def test_in_loops(monkeypatch):
    """As of slices of many components."""
    monkeypatch.setattr(sweep.sweeps, "made", partial(sweep.sweeps.made, loops=True))
    seen = evidence(gate=0.99, **CLUTTER)
    found, due = both(pgm.filter, network(), seen)
    assert found.status.compilation == "compiled"
    assert_same(found, due)


def test_a_function_that_is_called_back():
    seen = evidence((2,), gate=0.99, sensors=(z,))
    found, due = both(pgm.filter, network(branching), seen, lineariser=pgm.Cubature())
    assert found.status.compilation.startswith("compiled, z called back")
    assert_same(found, due)


def test_a_function_that_has_changed():
    scale = [1.0]

    def seen(x, m):
        return range_bearing(x, scale[0] * m)

    graphs = [pgm.compile(network(seen), T, compiled=choice) for choice in (True, False)]
    for factor in (1.0, 1.4):
        scale[0] = factor
        found, due = (
            pgm.infer(graph, evidence(sensors=(z,)), schedule=pgm.Filtering()) for graph in graphs
        )
        assert_same(found, due)


p, w = pgm.Variable("p", components=("a", "b")), pgm.Variable("w", components=("a", "b"))


def walk(prior=1.0):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(p, [0.0, 0.0], prior)],
        [pgm.LinearGaussianCPD(p, given={p.previous: np.eye(2)}, cov=0.01)],
        [pgm.LinearGaussianCPD(w, given={m: np.eye(2), p: -np.eye(2)}, cov=0.04)],
    )


MIRRORED = np.array([[3.0, 1.0], [3.0, -1.0], [9.0, 9.0]])


def near(values, **named):
    step = np.arange(values.shape[-2])
    return {
        w: pgm.sightings(
            values,
            step=step,
            given={m: pgm.unknown(MIRRORED, **({"association": "likelihood"} | named))},
        )
    }


def test_candidates_that_are_as_likely_are_left(monkeypatch):
    """Rounding would choose between mirror images."""
    values = np.tile([3.0, 0.8], (17, 4, 1))
    values[4, 1, 1], values[4, 0] = 0.0, np.nan
    runs, general = [], association._by_numpy

    def watched(graph, bound, *rest):
        runs.append((bound.runs, bound.first_run))
        general(graph, bound, *rest)

    monkeypatch.setattr(association, "_by_numpy", watched)
    found = pgm.filter(walk(), near(values), steps=3, compiled=True)
    assert runs == [(1, 4)]
    assert "associations compiled, but for: two candidates" in found.status.compilation
    assert found.status.compilation.endswith("in 1 of 17 runs")
    due = pgm.filter(walk(), near(values), steps=3, compiled=False)
    assert_same(found, due)
    assert_allclose(found.associations[w].probability[4, 1, :2], 0.5)


def test_innovations_that_are_no_measure_are_refused_alike(monkeypatch):
    """Beside the variance that both components share, their noise is rounding."""
    model, told, swept = walk(prior=1e16 * np.ones((2, 2))), [], []
    general = sweep.forward
    monkeypatch.setattr(
        sweep, "forward", lambda *a, **o: swept.append(general(*a, **o)) or swept[-1]
    )
    for choice in (True, False):
        with pytest.raises(pgm.NumericalError, match="candidates cannot be compared") as refusal:
            pgm.filter(model, near(np.full((3, 2), 2.0)), steps=2, compiled=choice)
        told.append((str(refusal.value), refusal.value.step, refusal.value.cpd))
    assert told[0] == told[1]
    assert swept[0].left == [slice(0, 1)]


def test_what_is_left_to_numpy_is_told():
    def told(values, compiled=None, **named):
        steps, seen = len(values) - 1, near(values, **named)
        return pgm.filter(walk(), seen, steps=steps, compiled=compiled).status.compilation

    values = np.full((4, 2), 2.0)
    joint = told(values, True, association="joint", gate=0.99)
    assert re.match("compiled; associations not compiled: .* a step are associated together", joint)
    assert told(values, False) == "by NumPy: compiled=False"
    # They are worth compiling before the filter is.
    longer = told(np.full((500, 2), 2.9))
    assert longer.startswith("by NumPy: machine code is made for longer work")
    assert longer.endswith("; associations compiled")
