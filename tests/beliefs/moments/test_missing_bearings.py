"""A sensor of range and bearing of which one is missing, against two sensors of one each."""

import numpy as np
import pytest
from crossed import crossed
from robots import LANDMARKS, P0, controls, drive_along, drive_cpd, m, u, x
from textbooks import assert_log, assert_same

import pgm
from models import sensors

T, RUNS, COUNT = 15, 4, 25
bias = pgm.Variable("bias")  # of the range
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
far = pgm.Variable("far")
way = pgm.Variable("way", components=("bearing",), angles=("bearing",))
NOISE = np.diag([0.04, 0.003])


def both(pose, place, shift):
    """Range, off by the bias, and bearing."""
    seen = sensors.range_bearing(pose, place)
    return seen + np.concatenate([shift, np.zeros_like(shift)], axis=-1)


def network(*observation):
    drift = pgm.LinearGaussianCPD(bias, {bias.previous: 1.0}, cov=1e-4)
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0, 0, 3.0], P0), pgm.GaussianCPD(bias, 0.0, 0.1)],
        [drive_cpd(), drift],
        observation,
    )


def vector(**options):
    return network(pgm.NonlinearGaussianCPD(z, (x, m, bias), both, NOISE, **options))


def scalars(**options):
    return network(
        pgm.NonlinearGaussianCPD(
            far, (x, m, bias), lambda *a: both(*a)[..., :1], NOISE[:1, :1], **options
        ),
        pgm.NonlinearGaussianCPD(
            way, (x, m, bias), lambda *a: both(*a)[..., 1:], NOISE[1:, 1:], **options
        ),
    )


@pytest.fixture(scope="module")
def drive():
    """Commands, steps, landmarks and readings; these are not complete."""
    rng = np.random.default_rng(3)
    commands = controls(rng, T)
    states = drive_along(commands, rng)
    step = rng.integers(0, T + 1, COUNT)
    places = LANDMARKS[rng.integers(0, 3, COUNT)]
    shape = (RUNS, COUNT, 2)
    values = both(states[step], places, np.full((COUNT, 1), 0.2))
    values = values + rng.normal(size=shape) @ np.sqrt(NOISE)
    values[..., 1] = (values[..., 1] + np.pi) % (2 * np.pi) - np.pi
    missing = rng.random(shape) < 0.35
    return commands, step, places, np.where(missing, np.nan, values)


def evidence(commands, step, places, values):
    given = {m: places}
    whole = {u: commands, z: pgm.sightings(values, step, given)}
    parts = {
        u: commands,
        far: pgm.sightings(values[..., :1], step, given),
        way: pgm.sightings(values[..., 1:], step, given),
    }
    return whole, parts


def never_both(values):
    """Of what is read whole, the range alone."""
    values = values.copy()
    values[~np.isnan(values).any(axis=-1), 1] = np.nan
    return values


def compare(found, due, tolerance=1e-9):
    for v in (x, bias):
        assert_same(found[v], due[v], tolerance)
    assert_log(found.log_evidence, due.log_evidence)


THRICE = {"iterations": 3, "tolerance": 0}
HELD = {"damping": pgm.LevenbergMarquardt(), "iterations": 6, "tolerance": 0}
RUNS_OF = {
    "filter": lambda model, seen, rule: pgm.filter(model, seen, lineariser=rule),
    "iterated": lambda model, seen, rule: pgm.filter(model, seen, lineariser=rule, **THRICE),
    "held": lambda model, seen, rule: pgm.filter(model, seen, lineariser=rule, **HELD),
    "smooth": lambda model, seen, rule: pgm.smooth(model, seen, lineariser=rule, **THRICE),
    "held smooth": lambda model, seen, rule: pgm.smooth(model, seen, lineariser=rule, **HELD),
    "balanced": lambda model, seen, rule: pgm.infer(
        pgm.compile(model, T, method=pgm.Balanced()),
        seen,
        schedule=pgm.Smoothing(iterations=4, tolerance=0),
        lineariser=rule,
    ),
}


@crossed(("method", "runs"), list(RUNS_OF), [RUNS, 1])
def test_taylor(drive, method, runs):
    *rest, values = drive
    values = values if runs > 1 else values[0]
    whole, parts = evidence(*rest, values)
    run = RUNS_OF[method]
    due = run(scalars(), parts, pgm.Taylor())
    compare(run(vector(), whole, pgm.Taylor()), due)
    compare(run(vector(grouped=True), whole, pgm.Taylor()), due)


@crossed(("method", "runs"), list(RUNS_OF), [RUNS, 1])
def test_sigma_points_of_what_is_never_read_whole(drive, method, runs):
    *rest, values = drive
    values = never_both(values if runs > 1 else values[0])
    whole, parts = evidence(*rest, values)
    run = RUNS_OF[method]
    compare(run(vector(), whole, pgm.Unscented()), run(scalars(), parts, pgm.Unscented()))


def test_grouped_sightings_keep_the_cross_terms_of_what_is_read(drive):
    """The ranges of a group whose bearings are all missing are a group of ranges."""
    *rest, values = drive
    whole, parts = evidence(*rest, np.where([False, True], np.nan, values))
    rule = pgm.Unscented()
    for method in ("filter", "held", "smooth", "balanced"):
        run = RUNS_OF[method]
        found = run(vector(grouped=True), whole, rule)
        due = run(scalars(grouped=True), parts, rule)
        compare(found, due)
    assert np.abs(found[x].mean - run(vector(), whole, rule)[x].mean).max() > 1e-6


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()])
@pytest.mark.parametrize("iterations", [1, 3])
def test_online(drive, rule, iterations):
    commands, step, places, values = drive
    for rows in (values, values[0]):
        order = np.argsort(step, kind="stable")
        seen = {u: commands, z: pgm.sightings(rows, step, {m: places})}
        due = pgm.filter(vector(), seen, lineariser=rule, iterations=iterations, tolerance=0)
        robot = pgm.OnlineFilter(vector(), rule, pgm.Filtering(iterations, tolerance=0))
        belief = robot.initial()
        for t in range(T + 1):
            belief = robot.predict(belief, {u: commands[t - 1]}) if t else belief
            now = order[step[order] == t]
            read = {z: pgm.sightings(rows[..., now, :], given={m: places[now]})}
            belief = robot.update(belief, read)
            assert_same(belief[x], due[x.at(t)])
        assert_log(belief.log_evidence, due.log_evidence)


def test_an_audit_weighs_what_was_read(drive):
    whole, parts = evidence(*drive)
    found, due = (
        pgm.audit(pgm.smooth(model, seen, iterations=5, tolerance=0), samples=200, rng=1)
        for model, seen in ((vector(), whole), (scalars(), parts))
    )
    assert_log(found.log_weights, due.log_weights, 1e-7)


def test_whiteness_of_a_component_that_is_read_alone(drive):
    *rest, values = drive
    whole, parts = evidence(*rest, np.where([False, True], np.nan, values))
    found, due = (
        pgm.consistency.whiteness(pgm.filter(model, seen).innovations[each], lags=4)
        for model, seen, each in ((vector(), whole, z), (scalars(), parts, far))
    )
    np.testing.assert_allclose(found.autocorrelation, due.autocorrelation, atol=1e-9)
    np.testing.assert_allclose(found.statistic, due.statistic, rtol=1e-7)


def test_an_exact_component_that_is_contradicted_is_named():
    exact = pgm.LinearGaussianCPD(z, {x: [[1.0, 0, 0], [0, 0, 1.0]]}, cov=np.diag([0.0, 0.1]))
    still = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=np.zeros((3, 3)))
    prior = pgm.GaussianCPD(x, [0, 0, 0], P0)
    model = pgm.DynamicBayesianNetwork([prior], [still], [exact])
    filtered = pgm.filter(model, {z: [[1.0, 0.2], [np.nan, 0.4], [1.0, np.nan]]})
    np.testing.assert_allclose(filtered[x].mean[1:, 0], 1.0, rtol=1e-15)
    with pytest.raises(pgm.NumericalError, match=r"z at step 3.*contradicts"):
        pgm.filter(model, {z: [[1.0, 0.2], [np.nan, 0.4], [1.5, np.nan]]})
