"""Drawn models online: steps in machine code are those of NumPy, or refused as there."""

import gc
import os
import warnings
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec

import numpy as np
import pytest
from test_compiled_drawn_models import RULES, Drawn

import pgm

pytestmark = pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed")


def of_one_run(first):
    """The first drawn model of one run from a seed on."""
    return next(model for model in map(Drawn, range(first, first + 1000)) if not model.runs)


def steps(model, robot, count=None):
    """The beliefs of a run, each with the belief before it, and at last the refusal if one came."""
    belief = robot.initial()
    for k in range(model.steps):
        inputs = {model.u: model.evidence[model.u][k]} if model.u in model.evidence else {}
        readings = {z.child: model.evidence[z.child][k] for z in model.sensors}
        if k % 3 == 2 and model.sensors:  # sightings, of which there are two, or none
            first = model.sensors[0].child
            readings[first] = pgm.sightings(np.repeat(readings[first][None], k % 2 + 1, axis=0))
        try:
            belief = robot.predict(belief, inputs)
            yield belief
            if readings:
                belief = robot.update(belief, readings)
                yield belief
        except pgm.PgmError as error:
            yield error
            return


SETTINGS = (
    {"gate": 0.9, "watch": True},
    {"lag": 3},
    {"schedule": pgm.Filtering(iterations=3, tolerance=0.0)},
    {},
)


def check(seed):
    model = of_one_run(1000 * seed)
    rule, settings = RULES[seed % len(RULES)], SETTINGS[seed % len(SETTINGS)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plain, quick = (
            list(steps(model, pgm.OnlineFilter(model.network, rule, compiled=each, **settings)))
            for each in (False, True)
        )
    assert len(plain) == len(quick)
    for due, found in zip(plain, quick, strict=True):
        if isinstance(due, pgm.PgmError):
            assert (type(due), str(due)) == (type(found), str(found))
            return
        if due.status.digits is not None:
            return  # from here on there are few digits, and both say so
        assert_alike(found, due)
        if "lag" in settings:
            one, other = map(lagged, (due, found))
            if isinstance(one, str):
                assert one == other
            else:
                assert_alike(other, one)
        if "watch" in settings:
            assert found.lost == due.lost
            for variable, its in due.rejected.items():
                own = found.rejected[variable]
                assert own.rejected.tolist() == its.rejected.tolist()
                assert own.square == pytest.approx(its.square, rel=1e-6, abs=1e-9, nan_ok=True)


def lagged(belief):
    """The belief a lag before, or the words of its refusal."""
    try:
        return belief.lagged
    except pgm.PgmError as error:
        return str(error)


def assert_alike(found, due):
    for variable in due.layout.slice if due.step else due.layout.states:
        one, other = due[variable], found[variable]
        unit = np.maximum(one.std, 1e-5 * np.abs(one.mean) * (one.std == 0.0) + 1e-300)
        assert (np.abs(one.mean - other.mean) / unit).max() < 1e-7
        assert (np.abs(one.cov - other.cov) / np.outer(unit, unit)).max() < 1e-7
    assert found.log_evidence == pytest.approx(due.log_evidence, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_drawn_models(seed):
    check(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3, 200))
def test_many_drawn_models(seed):
    check(seed)


def linear():
    x, u, z = pgm.Variable("x", ("place", "speed")), pgm.Variable("u"), pgm.Variable("z")
    network = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 1.0], np.eye(2))],
        [pgm.LinearGaussianCPD(x, {x.previous: [[1, 0.1], [0, 1]], u: [[0], [0.1]]}, cov=0.1)],
        [pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, cov=0.3)],
    )
    return network, x, u, z


def test_linear_steps_are_compiled_unasked_once_that_pays(monkeypatch):
    monkeypatch.setattr("pgm.beliefs.moments.online.moment_steps._LONG", 20)
    network, x, u, z = linear()
    robots = [pgm.OnlineFilter(network, compiled=each) for each in (False, None)]
    beliefs = [robot.initial() for robot in robots]
    for k in range(60):
        given, read = {u: np.array([0.1 * k])}, {z: np.array([0.5])}
        beliefs = [
            r.update(r.predict(b, given), read) for r, b in zip(robots, beliefs, strict=True)
        ]
    due, found = (belief[x] for belief in beliefs)
    np.testing.assert_allclose(found.mean, due.mean, rtol=1e-12)
    assert robots[0].compilation == "by NumPy: compiled=False"
    assert robots[1].compilation == (
        "compiled, but for: 40 × machine code is made for longer work, or by compiled=True"
    )


def test_functions_are_recorded_only_if_that_is_asked_for():
    robot = pgm.OnlineFilter(of_one_run(0).network)
    assert (
        robot.compilation
        == "by NumPy: compiled=True would record the model's functions as they are"
    )


def run(robot, network, x, u, z, count=300):
    belief, made = robot.initial(), []
    for k in range(count):
        belief = robot.predict(belief, {u: np.array([np.sin(k)])})
        belief = robot.update(belief, {z: pgm.sightings(np.full((k % 4, 1), 0.1 * k))})
        made.append(belief)
    return [np.append(belief[x].mean, belief.log_evidence) for belief in made]


@pytest.mark.slow
def test_beliefs_outlive_their_filter_under_garbage_collection():
    network, *variables = linear()
    due = run(pgm.OnlineFilter(network, compiled=False), network, *variables)
    before = gc.get_threshold()
    gc.set_threshold(2, 2, 2)
    try:
        with ThreadPoolExecutor(4) as pool:
            every = list(
                pool.map(
                    lambda _: run(pgm.OnlineFilter(network, compiled=True), network, *variables),
                    range(8),
                )
            )
    finally:
        gc.set_threshold(*before)
    for found in every:
        np.testing.assert_allclose(found, due, rtol=1e-9)
        np.testing.assert_array_equal(found, every[0])


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
def test_a_filter_goes_on_in_a_forked_process():
    network, *variables = linear()
    robot = pgm.OnlineFilter(network, compiled=True)
    due = run(robot, network, *variables)
    child = os.fork()
    if not child:
        same = np.array_equal(run(robot, network, *variables), due)
        again = np.array_equal(
            run(pgm.OnlineFilter(network, compiled=True), network, *variables), due
        )
        os._exit(0 if same and again else 1)
    assert os.waitpid(child, 0)[1] == 0
