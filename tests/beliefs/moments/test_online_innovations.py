"""Innovations and predictions of readings in a loop are those of the record; K r is what moves."""

import copy
import pickle
import warnings
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from robots import LANDMARKS, SENSORS, m, network, u, x
from test_compiled_drawn_models import RULES, Drawn

import pgm

SIGHT = SENSORS["range_bearing"]
needs_llvm = pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed")
SETTINGS = (
    {},
    {"gate": 0.9},
    {"schedule": pgm.Filtering(iterations=3, tolerance=0.0)},
    {"lag": 3},
)


class Noisy(Drawn):
    """Drawn models, some of whose sensors have robust noise."""

    sensors_below = 1, 4

    def loss(self):
        return [None, pgm.Huber(1.5), pgm.StudentT(4.0)][self.rng.integers(3)]


def drive(model, robot, steps):
    """Pairs of beliefs, before and after each update of a drawn model."""
    belief = robot.initial()
    for k in range(steps):
        inputs = {v: model.evidence[v][..., k, :] for v in (model.u,) if v in model.evidence}
        readings = {z.child: model.evidence[z.child][..., k, :] for z in model.sensors}
        before = robot.predict(belief, inputs)
        belief = robot.update(before, readings)
        yield before, belief


def close(found, due, unit):
    """Numbers are the same to 10⁻⁷ units, and NaN alike."""
    assert_array_equal(np.isnan(found), np.isnan(due))
    apart = np.abs(np.nan_to_num(found - due)) / np.where(unit > 0.0, unit, 1e-300)
    assert apart.max(initial=0.0) < 1e-7


def check(seed, compiled):
    rule, settings = RULES[seed % len(RULES)], SETTINGS[seed % len(SETTINGS)]
    model = Noisy(1000 + seed)
    kept = {k: v for k, v in settings.items() if k == "gate"}
    if "schedule" in settings:
        kept = {"iterations": 3, "tolerance": 0.0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            due = pgm.filter(model.network, model.evidence, lineariser=rule, **kept)
            due = due.innovations
        except pgm.PgmError:
            return 0
        robot = pgm.OnlineFilter(model.network, rule, compiled=compiled, **settings)
        for k, (before, belief) in enumerate(drive(model, robot, model.steps)):
            if belief.status.digits is not None or before.status.digits is not None:
                return k
            moved = {}
            for z, own in due.items():
                found = belief.innovations[z]
                residual, cov = own.residual[..., k, :], own.cov[..., k, :, :]
                std = np.sqrt(np.einsum("...ii->...i", cov))
                if z.dimension == 1:
                    residual, cov, std = residual[..., 0], cov[..., 0, 0], std[..., 0]
                close(found.residual, residual, std)
                both = std**2 if z.dimension == 1 else std[..., None] * std[..., None, :]
                close(found.cov, cov, both)
                close(found.nis, own.nis[..., k + 1], 1.0 + np.nan_to_num(own.nis[..., k + 1]))
                assert_array_equal(found.dof, own.dof[..., k + 1])
                assert_array_equal(found.rejected, own.rejected[..., k])
                r = np.nan_to_num(found.residual)
                for hidden, gain in found.gain.items():
                    step = (
                        gain * r[..., None] if z.dimension == 1 else (gain @ r[..., None])[..., 0]
                    )
                    moved[hidden] = moved.get(hidden, 0.0) + step
            for hidden, step in moved.items():
                one, other = before[hidden], belief[hidden]
                last = 8.0 * np.spacing(np.abs(one.mean) + np.abs(other.mean))
                apart = np.abs(step - (other.mean - one.mean))
                assert (apart <= 1e-6 * one.std + last).all()
    return model.steps


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=needs_llvm)])
def test_drawn_models(compiled):
    assert sum(check(seed, compiled) for seed in range(6)) > 30


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6, 150))
def test_many_drawn_models(seed):
    check(seed, bool(seed % 2) and not needs_llvm.args[0])


def sighted(count):
    seen = {m: LANDMARKS[:count]}
    return {SIGHT.z: pgm.sightings(np.tile([5.0, 1.0], (count, 1)), given=seen)}


@pytest.mark.parametrize("runs", [(), (3,)])
@pytest.mark.parametrize("count", [0, 1, 3])
def test_rows_are_those_of_the_readings(runs, count):
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    control = np.broadcast_to([1.0, 0.1], (*runs, 2))
    before = robot.predict(robot.initial(), {u: control})
    assert dict(before.innovations) == {}
    found = robot.update(before, sighted(count)).innovations
    if not count:
        assert dict(found) == {}
        return
    found = found[SIGHT.z]
    assert found.residual.shape == (*runs, count, 2)
    assert found.cov.shape == (*runs, count, 2, 2)
    assert found.gain[x].shape == (*runs, count, 3, 2)
    assert found.nis.shape == found.dof.shape == runs
    row = {SIGHT.z: [5.0, 1.0], m: LANDMARKS[0]}
    alone = robot.update(before, row).innovations[SIGHT.z]
    assert (alone.residual.shape, alone.gain[x].shape) == ((*runs, 2), (*runs, 3, 2))
    assert_allclose(alone.residual, found.residual[..., 0, :], rtol=1e-12)


def test_a_sensor_that_was_not_read_has_none():
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    belief = robot.update(robot.predict(robot.initial(), {u: [1.0, 0.1]}), sighted(1))
    with pytest.raises(pgm.EvidenceError, match="no innovations of x"):
        belief.innovations[x]


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=needs_llvm)])
def test_arrays_that_are_used_again_do_not_change_them(compiled):
    robot = pgm.OnlineFilter(network(SIGHT.cpd()), compiled=compiled)
    belief, value, mark = robot.initial(), np.empty((1, 2)), np.empty((1, 2))
    for k in range(9):
        value[:], mark[:] = (5.0 + 0.1 * k, 1.0), LANDMARKS[k % 3]
        belief = robot.predict(belief, {u: [1.0, 0.1]})
        belief = robot.update(belief, {SIGHT.z: pgm.sightings(value, given={m: mark})})
        if k == 7:
            found = belief
    value[:], mark[:] = 99.0, 99.0
    again = pickle.loads(pickle.dumps(found)), copy.deepcopy(found), found
    shown = [each.innovations[SIGHT.z] for each in again]
    evidence = {
        u: np.tile([1.0, 0.1], (8, 1)),
        SIGHT.z: pgm.sightings(
            [[5.0 + 0.1 * k, 1.0] for k in range(8)],
            step=np.arange(8) + 1,
            given={m: LANDMARKS[np.arange(8) % 3]},
        ),
    }
    due = pgm.filter(network(SIGHT.cpd()), evidence).innovations[SIGHT.z]
    for each in shown:
        assert_allclose(each.residual[0], due.residual[-1], rtol=1e-8)
        assert_allclose(each.nis, due.nis[-1], rtol=1e-8)


def test_a_function_that_has_changed_since_is_told():
    dt = [0.5]
    z = pgm.Variable("z")
    seen = pgm.NonlinearGaussianCPD(z, x, lambda s: dt[0] * s[..., :1] ** 2, cov=0.1)
    robot = pgm.OnlineFilter(network(seen))
    belief = robot.update(robot.predict(robot.initial(), {u: [1.0, 0.1]}), {z: [3.0]})
    dt[0] = 1.0
    with pytest.raises(pgm.ModelError, match="otherwise by now"):
        belief.innovations[z]


def test_a_further_update_has_its_own():
    """Of the second update alone, at the belief that the first has left."""
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    first = robot.update(robot.predict(robot.initial(), {u: [1.0, 0.1]}), sighted(1))
    second = robot.update(first, {SIGHT.z: pgm.sightings([[8.0, 0.5]], given={m: LANDMARKS[1:2]})})
    fresh = network(SIGHT.cpd(), prior=pgm.GaussianCPD(x, first[x].mean, first[x].cov))
    again = pgm.OnlineFilter(fresh)
    due = again.update(
        again.initial(), {SIGHT.z: pgm.sightings([[8.0, 0.5]], given={m: LANDMARKS[1:2]})}
    ).innovations[SIGHT.z]
    assert_allclose(second.innovations[SIGHT.z].residual, due.residual, rtol=1e-9)
    assert_allclose(second.innovations[SIGHT.z].gain[x], due.gain[x], rtol=1e-9)


def test_those_of_a_window_are_of_its_last_linearisation():
    """A lag with iterations: those of the newest step, as on the record; of all its updates."""
    model = network(SIGHT.cpd())
    controls, steps = np.tile([1.0, 0.1], (6, 1)), np.repeat(np.arange(1, 7), 2)
    seen = {m: np.repeat(LANDMARKS, 4, axis=0)}
    asked = pgm.sightings(step=steps, given=seen)
    drawn = model.sample({u: controls, SIGHT.z: asked}, rng=3)
    values, many = drawn[SIGHT.z], {"iterations": 30, "tolerance": 1e-9}
    due = pgm.smooth(model, drawn.evidence, lag=2, **many).innovations[SIGHT.z]
    robot = pgm.OnlineFilter(model, schedule=pgm.FixedLag(2, **many))
    belief = robot.initial()
    for k in range(6):
        belief = robot.predict(belief, {u: controls[k]})
        for j in (2 * k, 2 * k + 1):
            read = pgm.sightings(values[[j]], given={m: seen[m][[j]]})
            belief = robot.update(belief, {SIGHT.z: read})
    found = belief.innovations[SIGHT.z]
    assert_allclose(found.residual, due.residual[-2:], rtol=1e-6)
    assert_allclose(found.cov, due.cov[-2:], rtol=1e-6)
    assert_allclose(found.nis, due.nis[-1], rtol=1e-6)


# ---- before a reading is taken


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=needs_llvm)])
@pytest.mark.parametrize("seed", [1, 3, 4, 6])
def test_predictions_are_what_innovations_are_of(seed, compiled):
    """Of drawn models, runs and rules; robust noise counts with its own covariance."""
    rule, model = RULES[seed % len(RULES)], Noisy(1000 + seed)
    robot = pgm.OnlineFilter(model.network, rule, compiled=compiled)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for before, belief in drive(model, robot, model.steps):
            if belief.status.digits is not None:
                break
            for sensor in model.sensors:
                z, found = sensor.child, belief.innovations[sensor.child]
                mean, cov = before.predicted[z].mean, before.predicted[z].cov
                value = model.evidence[z][..., belief.step - 1, :]
                left, spread = value - mean, cov
                left[..., z.angle_mask] = (left[..., z.angle_mask] + np.pi) % (2 * np.pi) - np.pi
                if z.dimension == 1:
                    left, spread = left[..., 0], spread[..., 0, 0]
                taken = ~np.isnan(found.residual)
                far = 8.0 * np.spacing(np.abs(mean).max())
                np.testing.assert_allclose(left[taken], found.residual[taken], rtol=1e-6, atol=far)
                if sensor.noise is None:
                    there = ~np.isnan(found.cov)
                    np.testing.assert_allclose(spread[there], found.cov[there], rtol=1e-7)


def test_predictions_have_a_row_for_each_of_given():
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    belief = robot.predict(robot.initial(), {u: [1.0, 0.1]})
    found = belief.predicted.of(SIGHT.z, given={m: LANDMARKS})
    assert (found.mean.shape, found.cov.shape) == ((3, 2), (3, 2, 2))
    alone = belief.predicted.of(SIGHT.z, given={m: pgm.constant(LANDMARKS[1])})
    assert_allclose(alone.mean, found.mean[1], rtol=1e-12)
    wide = robot.predict(robot.initial(), {u: np.tile([1.0, 0.1], (4, 1))})
    assert_allclose(wide.predicted.of(SIGHT.z, {m: LANDMARKS}).cov[2], found.cov, rtol=1e-12)
    assert belief.predicted[x].mean.tolist() == belief[x].mean.tolist()


def test_what_cannot_be_predicted_is_refused():
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    before = robot.predict(robot.initial(), {u: [1.0, 0.1]})
    for ask, words in (
        (lambda: before.predicted[SIGHT.z], r"depends on \[m\], which nothing tells"),
        (lambda: before.predicted[u], "u is no sensor"),
        (lambda: before.predicted[SIGHT.z.at(3)], "measurements at step 1, not of"),
        (lambda: before.predicted.of(SIGHT.z, 3), "takes a mapping of observed parents to rows"),
        (lambda: before.predicted.of(SIGHT.z, {m: [1.0, 2.0]}), r"\(\.\.\., M, 2\) was due"),
        (lambda: before.predicted.of(SIGHT.z, {u: [[1.0, 2.0]], m: [[0.0, 0.0]]}), "no observed"),
        (lambda: robot.update(before, sighted(1)).predicted[SIGHT.z], "knows measurements of its"),
    ):
        with pytest.raises(pgm.EvidenceError, match=words):
            ask()
    cloud = pgm.OnlineFilter(network(SIGHT.cpd()), belief=pgm.Particles(10, seed=1)).initial()
    with pytest.raises(pgm.EvidenceError, match=r"innovations: .* have none online"):
        _ = cloud.innovations
