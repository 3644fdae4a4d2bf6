"""Gates: against a textbook filter that leaves sightings out, and against evidence without them."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from crossed import crossed
from numpy.testing import assert_allclose, assert_array_equal
from robots import DRIVE, LANDMARKS, P0, SENSORS, Q, controls, drive_along, m, network, u, x
from scipy.stats import chi2
from textbooks import wrapped

import pgm
from pgm.beliefs.moments.parts import split as parts
from pgm.kernels import mahalanobis

SIGHT, FIX = SENSORS["range_bearing"], copy(SENSORS["position"])
z = SIGHT.z
fix = FIX.z = pgm.Variable("fix", components=("east", "north"))
MODEL = network(SIGHT.cpd(), FIX.cpd())
T, RUNS = 12, 7
LEVEL = 0.95


def drawn(runs=RUNS, seed=5):
    """Two sightings a step and a fix at every other one, a third of which are wrong."""
    rng = np.random.default_rng(seed)
    commands = controls(rng, T)
    states = np.stack([drive_along(commands, rng) for _ in range(runs)])
    when = np.repeat(np.arange(T + 1), 2)[::-1]
    where = LANDMARKS[rng.integers(0, 3, when.size)]
    values = SIGHT.draw(states[:, when], where, rng)
    fixes, at = FIX.draw(states[:, ::2], None, rng), np.arange(0, T + 1, 2)
    wrong = rng.random((runs, when.size)) < 0.3
    values[..., 0] += np.where(wrong, rng.uniform(2.0, 9.0, wrong.shape), 0.0)
    fixes[rng.random((runs, at.size)) < 0.3] += 6.0
    values[0, 3] = np.nan
    return {
        u: commands,
        z: pgm.sightings(values, step=when, given={m: where}),
        fix: pgm.sightings(fixes, step=at),
    }


def without(evidence, rejected):
    """Evidence in which what was rejected is missing."""
    found = dict(evidence)
    for sensor, those in rejected.items():
        own = evidence[sensor]
        values = np.where(those.rejected[..., None], np.nan, own.values)
        found[sensor] = pgm.sightings(values, step=own.step, given=own.given)
    return found


EVIDENCE = drawn()


def textbook(run, gates):
    """An extended Kalman filter that leaves out the sightings beyond a gate: means, decisions."""
    left_out = {sensor: np.zeros(EVIDENCE[sensor].step.size, dtype=bool) for sensor in (z, fix)}
    mean, cov, means = np.zeros(3), P0, []
    for step in range(T + 1):
        if step:
            command = EVIDENCE[u][step - 1]
            slope = DRIVE.by_state(mean, command)
            mean, cov = DRIVE(mean, command), slope @ cov @ slope.T + Q
        rows, off, noises = [], [], []
        for kind, sensor in ((SIGHT, z), (FIX, fix)):
            for k in np.flatnonzero(EVIDENCE[sensor].step == step):
                value = EVIDENCE[sensor].values[run, k]
                known = [EVIDENCE[z].given[m][k]] if sensor is z else []
                if np.isnan(value).any():
                    continue
                row = kind.by_state(mean, *known)
                miss = wrapped(value - kind.function(mean, *known), sensor.angle_mask)
                square = miss @ np.linalg.solve(row @ cov @ row.T + kind.cov, miss)
                if square > chi2.ppf(gates.get(sensor, 1.0), 2):
                    left_out[sensor][k] = True
                    continue
                rows, off, noises = [*rows, row], [*off, miss], [*noises, kind.cov]
        if rows:
            whole, noise = np.vstack(rows), np.zeros((2 * len(rows), 2 * len(rows)))
            for k, each in enumerate(noises):
                noise[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = each
            gain = cov @ whole.T @ np.linalg.inv(whole @ cov @ whole.T + noise)
            mean, cov = mean + gain @ np.concatenate(off), cov - gain @ whole @ cov
        means.append(mean)
    return np.array(means), left_out


@pytest.mark.parametrize("gate", [LEVEL, {z: 0.999}, {z: 0.9, fix: 0.99}], ids=str)
def test_a_filter_leaves_out_as_the_textbook_does(gate):
    gates = gate if isinstance(gate, dict) else {z: gate, fix: gate}
    found = pgm.filter(MODEL, EVIDENCE, gate=gate)
    assert set(found.rejected) == set(gates)
    for run in range(RUNS):
        means, left_out = textbook(run, gates)
        assert_allclose(found[x].mean[run], means, atol=1e-8)
        for sensor in gates:
            assert_array_equal(found.rejected[sensor].rejected[run], left_out[sensor])
    assert 10 < found.rejected[z].rejected.sum() < 100
    assert np.isnan(found.rejected[z].square[0, 3])


@crossed(
    ("run", "runs"),
    {
        "filter": lambda e, **k: pgm.filter(MODEL, e, **k),
        "iterated": lambda e, **k: pgm.filter(MODEL, e, iterations=4, tolerance=0, **k),
        "smoother": lambda e, **k: pgm.smooth(MODEL, e, **k),
        "iterated smoother": lambda e, **k: pgm.smooth(
            MODEL, e, iterations=4, tolerance=0, lineariser=pgm.Unscented(), **k
        ),
        "lag": lambda e, **k: pgm.smooth(MODEL, e, lag=3, **k),
        "windows": lambda e, **k: pgm.smooth(MODEL, e, lag=3, iterations=3, tolerance=0, **k),
        "start": lambda e, **k: pgm.smooth(MODEL, e, start={x: np.zeros((T + 1, 3))}, **k),
    },
    [RUNS, 30],
)
def test_what_is_rejected_is_as_good_as_missing(run, runs):
    evidence = drawn(runs)
    found = run(evidence, gate=LEVEL)
    assert found.rejected[z].rejected.any()
    assert found.rejected[fix].rejected.any()
    due = run(without(evidence, found.rejected))
    assert_allclose(found[x].mean, due[x].mean, atol=1e-9)
    assert_allclose(found[x].cov, due[x].cov, atol=1e-9)
    assert_allclose(found.log_evidence, due.log_evidence, atol=1e-8)
    assert_allclose(found.predicted[x].mean, due.predicted[x].mean, atol=1e-9)


@pytest.mark.parametrize("noise", [pgm.StudentT(4), pgm.TruncatedLeastSquares(3.0)], ids=str)
def test_a_gate_goes_with_robust_noise(noise):
    model = network(SIGHT.cpd(noise=noise), FIX.cpd())
    for named in ({}, {"iterations": 3, "tolerance": 0}, {"lineariser": pgm.Unscented()}):
        found = pgm.filter(model, EVIDENCE, gate=LEVEL, **named)
        assert found.rejected[z].rejected.any()
        due = pgm.filter(model, without(EVIDENCE, found.rejected), **named)
        assert_allclose(found[x].mean, due[x].mean, atol=1e-9)
        assert_allclose(found.log_evidence, due.log_evidence, atol=1e-8)


def test_sightings_are_associated_with_the_gate_of_others():
    """A fix far off would lead the sightings of its step astray."""
    fixes = np.array([[0.0, 0.0], [40.0, 40.0]])
    where = np.array([[5.0, 0.0], [45.0, 45.0]])
    guess = pgm.unknown(where, association="likelihood")
    evidence = {
        u: np.zeros((1, 2)),
        fix: pgm.sightings(fixes, step=[0, 1]),
        z: pgm.sightings([[5.0, 0.0]], step=[1], given={m: guess}),
    }
    found = pgm.filter(MODEL, evidence, gate=0.999)
    assert_array_equal(found.associations[z].candidate, [0])
    assert_array_equal(found.rejected[fix].rejected, [False, True])
    assert_array_equal(found.rejected[z].rejected, [False])
    robot = pgm.OnlineFilter(MODEL, gate=0.999)
    belief = robot.update(robot.initial(), {fix: fixes[0]})
    belief = robot.predict(belief, {u: np.zeros(2)})
    now = {fix: fixes[1], z: pgm.sightings([[5.0, 0.0]], given={m: guess})}
    belief = robot.update(belief, now)
    assert_array_equal(belief.associations[z].candidate, [0])
    assert_allclose(belief[x].mean, found[x].mean[-1], atol=1e-12)


def test_schedules_with_gates_are_values():
    one, other = (pgm.Filtering(gate={z: 0.9, fix: 0.8}) for _ in range(2))
    assert one == other == pickle.loads(pickle.dumps(one))
    assert hash(one) == hash(pickle.loads(pickle.dumps(one)))
    assert one != pgm.Filtering(gate={z: 0.9})
    assert repr(pickle.loads(pickle.dumps(one))) == repr(one)


def test_innovations_of_what_was_rejected_can_be_told():
    found = pgm.filter(MODEL, EVIDENCE, gate=LEVEL)
    own, record = found.innovations[z], found.rejected[z]
    assert_array_equal(own.rejected, record.rejected)
    square = np.einsum("...i,...ij,...j", own.residual, np.linalg.inv(own.cov), own.residual)
    assert_allclose(square, record.square, rtol=1e-8)
    due = pgm.filter(MODEL, without(EVIDENCE, found.rejected)).innovations[z]
    assert_array_equal(own.nis, due.nis)
    assert_array_equal(own.dof, due.dof)
    assert not pgm.filter(MODEL, EVIDENCE).innovations[z].rejected.any()


@pytest.mark.parametrize("run", [0, slice(None)], ids=["one", "many"])
@pytest.mark.parametrize(
    "schedule", [None, pgm.FixedLag(3), pgm.FixedLag(3, iterations=2, tolerance=0)], ids=str
)
def test_online_decides_as_on_the_record(run, schedule):
    gate = {z: 0.9, fix: 0.99}
    named = {"gate": gate} if schedule is None else {"schedule": replace(schedule, gate=gate)}
    robot = pgm.OnlineFilter(MODEL, watch=True, **named)
    evidence = {
        k: v if k is u else pgm.sightings(v.values[run], step=v.step, given=v.given)
        for k, v in EVIDENCE.items()
    }
    whole = pgm.filter(MODEL, evidence, gate=gate)
    if schedule is not None:
        asked = {"iterations": schedule.iterations, "tolerance": schedule.tolerance}
        whole = pgm.smooth(MODEL, evidence, lag=schedule.lag, gate=gate, **asked)
    belief = robot.initial()
    for step in range(T + 1):
        if step:
            belief = robot.predict(belief, {u: EVIDENCE[u][step - 1]})
            assert not belief.rejected
        readings = {}
        for sensor in (z, fix):
            own, at = evidence[sensor], EVIDENCE[sensor].step == step
            given = {m: own.given[m][at]} if sensor is z else {}
            readings[sensor] = pgm.sightings(own.values[..., at, :], given=given)
        belief = robot.update(belief, readings)
        for sensor in belief.rejected:
            at = EVIDENCE[sensor].step == step
            assert_array_equal(
                belief.rejected[sensor].rejected, whole.rejected[sensor].rejected[..., at]
            )
            assert_allclose(
                belief.rejected[sensor].square, whole.rejected[sensor].square[..., at], rtol=1e-7
            )
    assert_allclose(belief[x].mean, whole[x].mean[..., -1, :], atol=1e-8)


def test_runs_in_parts_and_by_workers_decide_alike(monkeypatch):
    whole = pgm.filter(MODEL, EVIDENCE, gate=LEVEL)
    monkeypatch.setattr(parts, "MOST", 3)
    with ThreadPoolExecutor(2) as pool:
        for run, due in (
            (pgm.filter, whole),
            (pgm.smooth, pgm.smooth(MODEL, EVIDENCE, gate=LEVEL)),
        ):
            found = run(MODEL, EVIDENCE, gate=LEVEL, executor=pool)
            assert_array_equal(found.rejected[z].rejected, whole.rejected[z].rejected)
            assert_allclose(found[x].mean, due[x].mean, rtol=1e-12)
            assert_array_equal(found.lost.at, due.lost.at)
    kept = pgm.filter(MODEL, EVIDENCE, gate=LEVEL, keep=x)
    assert_allclose(kept[x].mean, whole[x].mean, rtol=1e-12)
    for what in ("rejected", "lost"):
        with pytest.raises(pgm.EvidenceError, match="not kept"):
            getattr(kept, what)


def test_an_infinite_prediction_is_not_judged():
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, np.inf)],
        transition=[pgm.LinearGaussianCPD(a, given={a.previous: 1.0}, cov=0.01)],
        observation=[pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=1.0)],
    )
    readings = np.array([[500.0], [500.5], [90.0], [499.0]])
    for run in (pgm.filter, pgm.smooth):
        found = run(model, {b: readings}, gate=0.99)
        assert_array_equal(found.rejected[b].rejected, [False, False, True, False])
        readings[2] = np.nan
        assert_allclose(found[a].mean, run(model, {b: readings})[a].mean)
        readings[2] = 90.0


@pytest.mark.parametrize("batch", [(), (1,), (5,), (3, 5)])
def test_squared_lengths(batch):
    rng = np.random.default_rng(0)
    root, off = rng.normal(size=(4, 4, *batch)), rng.normal(size=(4, *batch))
    cov = np.einsum("ij...,lj...->il...", root, root)
    due = np.empty(batch)
    for place in np.ndindex(batch):
        own = off[:, *place]
        due[place] = own @ np.linalg.solve(cov[:, :, *place], own)
    assert_allclose(mahalanobis.squares(off, cov), due, rtol=1e-7)
    cov[3], cov[:, 3], off[3] = cov[0], cov[:, 0], off[0]  # determined
    cov[3, 3] = cov[0, 0]
    part = mahalanobis.squares(off[:3], cov[:3, :3])
    assert_allclose(mahalanobis.squares(off, cov), part, rtol=1e-6)
    assert np.isnan(mahalanobis.squares(off, -cov)).all()


A, B = pgm.variables("a b")
STATIC = pgm.compile(
    pgm.BayesianNetwork(
        [pgm.GaussianCPD(A, 0.0, 1.0), pgm.LinearGaussianCPD(B, given={A: 1.0}, cov=1.0)]
    )
)
RAIN, WET = (pgm.Discrete(name, states=("no", "yes")) for name in ("rain", "wet"))
EVEN = [[0.5, 0.5], [0.5, 0.5]]
TABLES = pgm.DynamicBayesianNetwork(
    [pgm.TableCPD(RAIN, table=[0.5, 0.5])],
    [pgm.TableCPD(RAIN, given=(RAIN.previous,), table=EVEN)],
    [pgm.TableCPD(WET, given=(RAIN,), table=EVEN)],
)
CARTS = pgm.compile(MODEL, T, method=pgm.Balanced())


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: pgm.Filtering(gate=1.0), pgm.ModelError, "probability between 0 and 1"),
        (lambda: pgm.FixedLag(2, gate="no"), pgm.ModelError, "FixedLag: a gate"),
        (lambda: pgm.Smoothing(gate={z: 2.0}), pgm.ModelError, "a gate of z"),
        (lambda: pgm.Filtering(gate={"z": 0.9}), pgm.ModelError, "sensors' variables"),
        (lambda: pgm.filter(MODEL, EVIDENCE, gate={x: 0.9}), pgm.EvidenceError, "no sensor"),
        (lambda: pgm.OnlineFilter(MODEL, gate={x: 0.9}), pgm.EvidenceError, "no sensor"),
        (
            lambda: pgm.OnlineFilter(MODEL, schedule=pgm.Filtering(), gate=0.9),
            pgm.ModelError,
            "gate of its own",
        ),
        (
            lambda: pgm.infer(CARTS, EVIDENCE, schedule=pgm.Smoothing(gate=0.9)),
            pgm.GraphError,
            "one predicted belief after another",
        ),
        (
            lambda: pgm.infer(STATIC, {B: 1.0}, schedule=pgm.Smoothing(gate=0.9)),
            pgm.GraphError,
            "dynamic networks",
        ),
        (
            lambda: pgm.filter(MODEL, EVIDENCE, gate=0.9, belief=pgm.Particles(10)),
            pgm.ModelError,
            "gate",
        ),
        (
            lambda: pgm.OnlineFilter(MODEL, gate=0.9, belief=pgm.Particles(10)),
            pgm.ModelError,
            "gate= is for beliefs that are Gaussian",
        ),
        (
            lambda: pgm.OnlineFilter(MODEL, watch=True, belief=pgm.Particles(10)),
            pgm.ModelError,
            "watch= is for",
        ),
        (
            lambda: pgm.OnlineFilter(TABLES, schedule=pgm.Filtering(gate=0.9)),
            pgm.ModelError,
            "gate= is for beliefs that are Gaussian",
        ),
        (
            lambda: pgm.filter(TABLES, {WET: ["yes"]}, gate=0.9),
            pgm.ModelError,
            "gate= is for beliefs that are Gaussian",
        ),
        (lambda: pgm.filter(MODEL, EVIDENCE).rejected[z], pgm.EvidenceError, "give gate="),
        (
            lambda: pgm.filter(MODEL, EVIDENCE, gate={z: 0.9}).rejected[fix],
            pgm.EvidenceError,
            "gates were those of",
        ),
    ],
)
def test_what_has_no_gate_is_refused(call, error, words):
    with pytest.raises(error, match=words):
        call()
