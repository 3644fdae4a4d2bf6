"""Flat priors in a robot's loop: the filter of the record, whose limits are tested elsewhere."""

import pickle
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from test_flat_priors import INF, MODELS, STEPS, constant_velocity, evidence_for, record, x, z

import pgm

HAVE_LLVM = find_spec("llvmlite") is not None
MANY = {"iterations": 20, "tolerance": 1e-9}


def known(name):
    model, _ = MODELS[name]
    return model(INF)


def loop(model, evidence, runs=(), **options):
    """Beliefs before and after each step's readings."""
    robot = pgm.OnlineFilter(model, **options)
    belief = robot.initial()
    for k in range(STEPS):
        readings = {v: np.broadcast_to(rows[k], (*runs, 1)) for v, rows in evidence.items()}
        before = robot.predict(belief)
        belief = robot.update(before, readings)
        yield before, belief


def alike(found, due, tolerance=1e-9):
    assert_array_equal(np.isinf(found), np.isinf(due))
    assert_allclose(
        np.where(np.isinf(due), 0.0, found),
        np.where(np.isinf(due), 0.0, due),
        rtol=tolerance,
        atol=tolerance,
    )


@pytest.mark.parametrize("compiled", [False, True] if HAVE_LLVM else [False])
@pytest.mark.parametrize("runs", [(), (2,)])
@pytest.mark.parametrize("name", list(MODELS))
def test_a_loop_is_the_filter_of_the_record(name, runs, compiled):
    """Beliefs, innovations, predictions and log-evidence, before all is known and after."""
    model = known(name)
    evidence = evidence_for(model, missing=True)
    due = pgm.filter(model, evidence)
    whole = pgm.filter(
        model, {v: np.broadcast_to(e, (*runs, *e.shape)) for v, e in evidence.items()}
    )
    for k, (before, belief) in enumerate(loop(model, evidence, runs, compiled=compiled), start=1):
        for v in model.states:
            for found, record_ in ((before[v], due.predicted[v]), (belief[v], due[v])):
                shape = found.mean.shape[:-1]
                lost = np.isinf(record_.std[k])
                mean = np.where(lost, 0.0, record_.mean[k])
                alike(np.where(lost, 0.0, found.mean), np.broadcast_to(mean, (*shape, lost.size)))
                alike(found.cov, np.broadcast_to(record_.cov[k], found.cov.shape))
        for sensor in evidence:
            found, own = belief.innovations[sensor], due.innovations[sensor]
            alike(found.residual, np.broadcast_to(own.residual[k - 1, 0], runs))
            alike(found.cov, np.broadcast_to(own.cov[k - 1, 0, 0], runs))
            alike(found.nis, np.broadcast_to(own.nis[k], runs))
            assert (found.dof == own.dof[k]).all()
            ahead = before.predicted[sensor]
            alike(ahead.cov, np.broadcast_to(due.predicted[sensor].cov[k - 1], ahead.cov.shape))
    assert_allclose(belief.log_evidence, whole.log_evidence, rtol=1e-9)
    assert "predicted" in str(before)


def test_what_is_known_goes_on_in_float64():
    """And in machine code, from the step at which all is known."""
    model = constant_velocity(INF)
    beliefs = [after for _, after in loop(model, {z: record()}, compiled=HAVE_LLVM)]
    assert [np.isinf(each[x].cov).any() for each in beliefs[:3]] == [True, False, False]
    assert beliefs[0].careful is not None
    assert beliefs[-1].careful is None
    assert beliefs[-1].status.digits is None
    again = pickle.loads(pickle.dumps(beliefs[0]))
    assert np.isnan(again.innovations[z].residual)
    assert np.isnan(again.innovations[z].gain[x]).all()
    found = beliefs[2].innovations[z].gain[x]
    assert np.isfinite(found).all()


@pytest.mark.parametrize("name", list(MODELS))
def test_gates_and_a_watch(name):
    """Unknown directions are not judged; what is known is, and an absurd reading is rejected."""
    model = known(name)
    evidence = evidence_for(model)
    evidence[z] = evidence[z] + np.where(np.arange(STEPS)[:, None] == 4, 50.0, 0.0)
    due = pgm.filter(model, evidence, gate=0.999)
    beliefs = [after for _, after in loop(model, evidence, gate=0.999, watch=True)]
    for sensor in evidence:
        for k, belief in enumerate(beliefs):
            assert belief.rejected[sensor].rejected == due.rejected[sensor].rejected[k]
            alike(belief.rejected[sensor].square, due.rejected[sensor].square[[k]])
    assert due.rejected[z].rejected[4]
    assert_array_equal([belief.lost for belief in beliefs], due.lost.at[1:])
    assert_allclose(beliefs[-1].log_evidence, due.log_evidence, rtol=1e-9)


@pytest.mark.parametrize("name", list(MODELS))
def test_a_lag_with_iterations(name):
    """Its windows begin with the flat prior; lagged beliefs are those of the record."""
    model = known(name)
    evidence = evidence_for(model, missing=True)
    schedule = pgm.FixedLag(2, **MANY)
    *_, (before, belief) = loop(model, evidence, schedule=schedule)
    due = pgm.smooth(model, evidence, lag=2, **MANY)
    for v in model.states:
        alike(belief.lagged[v].cov, due[v].cov[-3])
        alike(belief[v].cov, due[v].cov[-1])
    assert_allclose(belief.log_evidence, due.log_evidence, rtol=1e-9)
    filtered = pgm.filter(model, evidence)
    for found, sensor in zip((before.predicted[v] for v in evidence), evidence, strict=True):
        alike(found.cov, filtered.predicted[sensor].cov[-1])
    first = next(loop(model, evidence, schedule=schedule))
    for sensor in evidence:
        alike(first[0].predicted[sensor].cov, filtered.predicted[sensor].cov[0])
        alike(first[1].innovations[sensor].nis, filtered.innovations[sensor].nis[1])


def test_a_lag_of_one_linearisation_is_refused_as_long_as_it_reaches_what_is_unknown():
    model = constant_velocity(INF)
    due = pgm.smooth(model, {z: record()}, lag=2)
    beliefs = [belief for _, belief in loop(model, {z: record()}, lag=2)]
    for belief in beliefs[:4]:
        with pytest.raises(pgm.NumericalError, match=r"a flat prior .*FixedLag\(2, iterations=2\)"):
            _ = belief.lagged
    for belief in beliefs[4:]:
        alike(belief.lagged[x].cov, due[x].cov[belief.step - 2])
    schedule = pgm.FixedLag(2, iterations=2)
    for _, belief in list(loop(model, {z: record()}, schedule=schedule))[1:]:
        alike(belief.lagged[x].cov, due[x].cov[belief.step - 2])


def test_a_nonlinear_sensor_waits_for_what_its_rule_can_stand():
    """Taylor needs no variance; sigma points have none to stand at, and say so."""
    seen = pgm.Variable("seen")
    model = constant_velocity(INF)
    sensors = [
        *model.observation,
        pgm.NonlinearGaussianCPD(seen, x, lambda s: s[..., :1] ** 2, 0.1),
    ]
    model = model.replace(observation=sensors)
    evidence = {z: record(), seen: record() ** 2}
    due = pgm.filter(model, evidence)
    *_, (_, belief) = loop(model, evidence)
    alike(belief[x].mean, due[x].mean[-1])
    alike(belief[x].cov, due[x].cov[-1])
    robot = pgm.OnlineFilter(model, pgm.Unscented())
    before = robot.predict(robot.initial())
    for ask in (
        lambda: robot.update(before, {seen: [1.0]}),
        lambda: before.predicted[seen],
    ):
        with pytest.raises(pgm.LinearisationError, match="still has an infinite variance"):
            ask()
    belief = robot.update(before, {z: [1.0]})
    belief = robot.update(robot.predict(belief), {z: [1.0]})
    assert np.isfinite(robot.update(belief, {seen: [1.0]})[x].mean).all()


def test_sightings_without_identity():
    m, seen = pgm.Variable("m"), pgm.Variable("seen")
    model = constant_velocity(INF)
    sees = pgm.LinearGaussianCPD(seen, {x: [[1.0, 0.0]], m: -1.0}, cov=0.1)
    model = model.replace(observation=[*model.observation, sees])
    nameless = pgm.unknown([[0.0], [5.0]], gate=0.99, association="likelihood")
    robot = pgm.OnlineFilter(model)
    readings = {seen: pgm.sightings([[1.0]], given={m: nameless})}
    belief = robot.initial()
    with pytest.raises(pgm.EvidenceError, match="cannot be compared with candidates"):
        robot.update(belief, readings)
    for _ in range(2):
        belief = robot.update(robot.predict(belief), {z: [1.0]})
    assert robot.update(belief, readings).associations[seen]
