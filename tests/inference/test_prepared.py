"""Prepared calls: the posteriors of ordinary ones, for other values of the same form."""

import gc
import pickle
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec

import numpy as np
import pytest
from crossed import crossed
from numpy.testing import assert_array_equal

import pgm

MACHINE = pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed")
CHOICES = [False, pytest.param(True, marks=MACHINE)]

X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
U = pgm.Variable("u", components=("v", "omega"))
Z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
M = pgm.Variable("m", components=("east", "north"))
G = pgm.Variable("g", components=("east", "north"))
STEPS = 12


def drive(x, u):
    heading = x[..., 2] + 0.25 * u[..., 1]
    step = 0.5 * u[..., 0]
    return x + np.stack([step * np.cos(heading), step * np.sin(heading), 0.5 * u[..., 1]], axis=-1)


def sight(x, m):
    away = m - x[..., :2]
    bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
    return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)


def robot(noise=None):
    """A robot that sees landmarks, and has fixes at each step."""
    fix = pgm.LinearGaussianCPD(G, {X: np.eye(2, 3)}, cov=0.5, noise=noise)
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, [0, 0, 0], [0.01, 0.01, 0.0025])],
        [pgm.NonlinearGaussianCPD(X, (X.previous, U), drive, cov=[0.0025, 0.0025, 0.0009])],
        [pgm.NonlinearGaussianCPD(Z, (X, M), sight, cov=[0.04, 0.0025]), fix],
    )


def evidence(seed, runs=(), missing=0.2, step=(9, 0, 3, 3, 12)):
    """Sightings in any order, of which some are missing; and fixes."""
    rng = np.random.default_rng(seed)
    step = np.array(step)
    marks = np.array([[7.0, 1.0], [-6.0, 8.0], [4.0, 12.0]])[rng.integers(3, size=len(step))]
    values = sight(np.zeros((*runs, 1, 3)), marks) + 0.2 * rng.normal(size=(*runs, len(step), 2))
    fixes = rng.normal(size=(*runs, STEPS, 2))
    fixes[rng.random(fixes.shape) < missing] = np.nan
    return {
        U: np.array([1.0, 0.2]) + 0.1 * rng.normal(size=(STEPS, 2)),
        Z: pgm.sightings(values, step=step, given={M: marks}),
        G: fixes,
    }


def assert_same(found, due):
    assert_array_equal(found[X].mean, due[X].mean)
    assert_array_equal(found[X].cov, due[X].cov)
    assert_array_equal(found.log_evidence, due.log_evidence)
    assert_array_equal(found.filtered[X].cov, due.filtered[X].cov)
    assert_array_equal(found.predicted[X].mean, due.predicted[X].mean)
    assert_array_equal(found.innovations[Z].residual, due.innovations[Z].residual)
    assert_array_equal(found.joint(X.at(3), X.at(7)).cov, due.joint(X.at(3), X.at(7)).cov)
    assert found.status.compilation == due.status.compilation
    assert found.log_evidence_kind == due.log_evidence_kind


SCHEDULES = {
    "filter": pgm.Filtering(),
    "iterated": pgm.Filtering(iterations=3, tolerance=0.0),
    "gated": pgm.Filtering(gate=0.9),
    "smoother": pgm.Smoothing(),
    "default": None,
    "lag": pgm.FixedLag(3),
}


@pytest.mark.parametrize("compiled", CHOICES)
@crossed(("name", "runs", "noise"), list(SCHEDULES), [(), (3,), (2, 5)], [None, pgm.Huber(1.5)])
def test_posteriors_are_those_of_ordinary_calls(name, runs, compiled, noise):
    graph = pgm.compile(robot(noise), STEPS, compiled=compiled)
    run = pgm.prepare(graph, evidence(0, runs), schedule=SCHEDULES[name])
    for seed in range(3):
        given = evidence(seed, runs)
        step = (9, 0, 3, 3, 12)
        given[Z] = pgm.sightings(given[Z].values, step=step, given=given[Z].given)
        assert_same(run(given), pgm.infer(graph, given, schedule=SCHEDULES[name]))


@pytest.mark.parametrize("compiled", CHOICES)
@pytest.mark.parametrize("rule", [pgm.Unscented(), pgm.Cubature()])
def test_rules_of_points(rule, compiled):
    graph = pgm.compile(robot(), STEPS, compiled=compiled)
    run = pgm.prepare(graph, evidence(0), lineariser=rule)
    for missing in (0.0, 0.5, 0.0):
        given = evidence(5, missing=missing)
        assert_same(run(given), pgm.infer(graph, given, lineariser=rule))


def test_constants_lists_and_a_balanced_tree():
    graph = pgm.compile(robot(), STEPS, method=pgm.Balanced())
    given = evidence(1) | {U: pgm.constant([1.0, 0.2])}
    run = pgm.prepare(graph, given)
    other = {v: value for v, value in evidence(2).items() if v != U} | {U: pgm.constant([0.5, 0.1])}
    other[G] = other[G].tolist()
    assert_array_equal(run(other)[X].mean, pgm.infer(graph, other)[X].mean)


def test_evidence_of_another_form_is_refused():
    graph = pgm.compile(robot(), STEPS)
    given = evidence(0)
    run = pgm.prepare(graph, given)
    z = given[Z]
    cases = {
        r"g has shape \(2, 12, 2\), and \(12, 2\) was": given | {G: np.zeros((2, 12, 2))},
        r"g has shape \(11, 2\), and \(12, 2\) was": given | {G: np.zeros((11, 2))},
        "sightings of z are at other steps": given
        | {Z: pgm.sightings(z.values, [9, 0, 3, 4, 12], z.given)},
        "lacks g": {U: given[U], Z: z},
        "has q beside": given | {pgm.Variable("q"): 0.0},
        "lacks g and has q beside": {U: given[U], Z: z, pgm.Variable("q"): given[G]},
        r"g has shape \(\); \(..., T, 2\) was due": given | {G: None},
        "lacks m of z's sightings": given | {Z: pgm.sightings(z.values, z.step)},
        "u is a constant, and an array was": given | {U: pgm.constant([1.0, 0.2])},
        "NaN, masked or infinite": given | {U: np.full((12, 2), np.nan)},
        "infinite entries": given | {G: np.full((12, 2), np.inf)},
        r"z has shape \(4, 2\), and \(5, 2\) was": given
        | {Z: pgm.sightings(z.values[:4], z.step, z.given)},
        "lacks sightings of z": given | {Z: np.zeros((12, 2))},
        "evidence maps variables to values": [1.0],
    }
    for words, other in cases.items():
        with pytest.raises(pgm.EvidenceError, match=words):
            run(other)
    for step in (z.step.tolist(), z.step.astype(np.int32)):
        assert_same(run(given | {Z: pgm.sightings(z.values, step, z.given)}), run(given))
    with pytest.raises(pgm.EvidenceError, match="are at other steps"):
        run(given | {Z: pgm.sightings(z.values, z.step[:, None], z.given)})
    assert_same(run(given), pgm.infer(graph, given))


@pytest.mark.parametrize("where", [U, M])
def test_an_input_that_is_missing_is_refused_by_its_step(where):
    run = pgm.prepare(pgm.compile(robot(), STEPS), evidence(0))
    given = evidence(1)
    (given[U] if where == U else given[Z].given[M])[2] = np.nan
    told = []
    for call in (run, lambda given: pgm.smooth(robot(), given)):
        with pytest.raises(pgm.EvidenceError, match=r"first at step 3") as refused:
            call(given)
        told.append((str(refused.value), refused.value.step))
    assert told[0] == told[1]


def test_what_cannot_be_prepared_is_refused():
    net = pgm.BayesianNetwork([pgm.GaussianCPD(X, [0, 0, 0], 1.0)])
    with pytest.raises(pgm.GraphError, match="prepare takes a graph of a dynamic network"):
        pgm.prepare(pgm.compile(net), {})
    graph = pgm.compile(robot(), STEPS)
    given = evidence(0)
    left = pgm.unknown([[7.0, 1.0], [4.0, 12.0]], association="likelihood")
    opened = given | {Z: pgm.sightings(given[Z].values, given[Z].step, {M: left})}
    with pytest.raises(pgm.EvidenceError, match="associated anew in each call"):
        pgm.prepare(graph, opened)
    with pytest.raises(TypeError, match="no argument keep="):
        pgm.prepare(graph, given, keep=[X])
    balanced = pgm.compile(robot(), STEPS, method=pgm.Balanced())
    with pytest.raises(pgm.GraphError, match="gate="):
        pgm.prepare(balanced, given, schedule=pgm.Smoothing(gate=0.9))


@pytest.mark.parametrize("compiled", CHOICES)
def test_a_function_that_changes_is_seen_as_it_is(compiled):
    gain = [0.5]
    x, z = pgm.variables("x z")
    move = pgm.NonlinearGaussianCPD(x, (x.previous,), lambda a: gain[0] * np.cos(a), cov=0.1)
    see = pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.1)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(x, 0.0, 1.0)], [move], [see])
    blank = {z: np.full((5, 1), np.nan)}
    graph = pgm.compile(model, 5, compiled=compiled)
    run = pgm.prepare(graph, blank, schedule=pgm.Filtering())
    for each in (*[0.5] * 9, *[3.0] * 9, 0.5):
        gain[0] = each
        due = 0.0
        for _ in range(5):
            due = each * np.cos(due)
        assert abs(run(blank)[x].mean[-1, 0] - due) < 1e-12


@pytest.mark.parametrize("compiled", CHOICES)
def test_posteriors_stand_by_themselves(compiled):
    """What evidence, and other runs, become later changes no posterior."""
    graph = pgm.compile(robot(), STEPS, compiled=compiled)
    run, given = pgm.prepare(graph, evidence(0)), evidence(1)
    found = run(given)
    mean = found[X].mean.copy()
    given[G][:] = 7.0
    given[Z].values[:] = 1.0
    given[U][:] = 0.0
    for seed in range(5):
        run(evidence(seed))
    gc.collect()
    assert_array_equal(found[X].mean, mean)
    assert_same(found, pgm.infer(graph, evidence(1)))


@pytest.mark.parametrize("compiled", CHOICES)
def test_threads_run_it_at_the_same_time(compiled):
    graph = pgm.compile(robot(), STEPS, compiled=compiled)
    run = pgm.prepare(graph, evidence(0))
    due = [pgm.infer(graph, evidence(seed))[X].mean for seed in range(8)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda k: run(evidence(k % 8))[X].mean, range(80)))
    for k, each in enumerate(found):
        assert_array_equal(each, due[k % 8])


@pytest.mark.parametrize("compiled", CHOICES)
def test_it_is_pickled_with_its_graph(compiled):
    graph = pgm.compile(robot(), STEPS, compiled=compiled)
    run = pgm.prepare(graph, evidence(0))
    due = run(evidence(1))[X].mean
    assert_array_equal(pickle.loads(pickle.dumps(run))(evidence(1))[X].mean, due)
    assert_array_equal(pgm.infer(pickle.loads(pickle.dumps(graph)), evidence(1))[X].mean, due)


@MACHINE
def test_many_runs_hold_no_more_memory_than_one():
    graph = pgm.compile(robot(), STEPS, compiled=True)
    run, given = pgm.prepare(graph, evidence(0)), evidence(1)
    for _ in range(5):
        run(given)
    gc.collect()
    tracemalloc.start()
    for _ in range(20):
        run(given)
    gc.collect()
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 30_000
