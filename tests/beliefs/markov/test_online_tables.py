"""Discrete filters online, against recorded evidence."""

import pickle

import numpy as np
import pytest
from markov.test_long import hidden, model
from markov.worlds import WORLDS, called, several
from numpy.testing import assert_allclose

import pgm

EQUAL = {"rtol": 1e-11, "atol": 1e-300}


def driven(world, robot):
    """List the beliefs of a loop over recorded evidence of plain arrays."""
    belief = robot.initial()
    beliefs = [belief]
    moves = {v for cpd in world.model.transition for v in cpd.parents if v in world.model.inputs}
    reads = {v for cpd in world.model.observation for v in cpd.parents if v in world.model.inputs}
    for t in range(world.steps):
        row = {v: at(value, t) for v, value in world.evidence.items()}
        belief = robot.predict(belief, {v: row[v] for v in moves})
        seen = {v: row[v] for v in (*world.model.sensors, *reads)}
        belief = robot.update(belief, seen)
        beliefs.append(belief)
    return beliefs


def at(value, t):
    """The row of a step."""
    if hasattr(value, "weights"):
        return pgm.soft(value.weights[t])
    return value[t] if np.ndim(value) > 1 else int(value[t])


@pytest.mark.parametrize("world", [several, called])
def test_a_loop_is_the_filter_and_the_fixed_lag(world):
    world = world(np.random.default_rng(5))
    beliefs = driven(world, pgm.OnlineFilter(world.model, lag=2))
    filtered = pgm.filter(world.model, world.evidence)
    for t, belief in enumerate(beliefs):
        assert belief.step == t
        until = pgm.smooth(world.model, {v: cut(e, t) for v, e in world.evidence.items()}, steps=t)
        for v in world.slices:
            if t or v in world.model.states:
                assert_allclose(belief[v].values, filtered[v.at(t)].values, **EQUAL)
            if t > 2 or v in world.model.states:
                due = until[v.at(max(0, t - 2))].values
                assert_allclose(belief.lagged[v].values, due, **EQUAL)
        assert_allclose(belief.log_evidence, until.log_evidence, rtol=1e-12, atol=1e-13)
    assert str(beliefs[-1].lagged.kind) == "fixed-lag (2)"


def test_a_window_far_from_the_start_has_the_inputs_of_its_own_steps():
    a, u, z = pgm.Discrete("a", 3), pgm.Discrete("u", 2), pgm.Discrete("z", 2)
    rng = np.random.default_rng(8)
    motion, seen = rng.dirichlet(np.ones(3), (3, 2)), rng.dirichlet(np.ones(2), 3)
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(a, table=[0.5, 0.3, 0.2])],
        transition=[pgm.TableCPD(a, given=(a.previous, u), table=motion)],
        observation=[pgm.TableCPD(z, given=a, table=seen)],
    )
    moves, reads = rng.integers(2, size=9), rng.integers(2, size=9)
    robot = pgm.OnlineFilter(model, lag=3)
    belief = robot.initial()
    for move, read in zip(moves, reads, strict=True):
        belief = robot.update(robot.predict(belief, {u: move}), {z: read})
    due = pgm.smooth(model, {u: moves, z: reads})
    assert_allclose(belief.lagged[a].values, due[a.at(6)].values, **EQUAL)


def cut(value, t):
    """The first rows of evidence."""
    return pgm.soft(value.weights[:t]) if hasattr(value, "weights") else value[:t]


def test_several_measurements_and_none():
    world = WORLDS["sparse"](np.random.default_rng(5))
    robot = pgm.OnlineFilter(world.model)
    (z,), x = world.model.sensors, world.slices[0]
    belief = robot.update(robot.predict(robot.initial()), {z: pgm.sightings([1, 0])})
    again = robot.update(robot.update(robot.predict(robot.initial()), {z: "1"}), {z: 0})
    due = pgm.filter(world.model, {z: pgm.sightings([1, 0], step=[1, 1])}, steps=1)
    for found in (belief, again):
        assert_allclose(found[x].values, due[x.at(1)].values, rtol=1e-13)
        assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-13)
    still = robot.update(belief, {z: -1})
    assert_allclose(still[x].values, belief[x].values, rtol=1e-13)
    assert robot.update(belief, {}).log_evidence == belief.log_evidence


def test_runs_begin_where_evidence_has_them():
    world = several(np.random.default_rng(5))
    u, (z, w) = world.model.inputs[0], world.model.sensors
    robot = pgm.OnlineFilter(world.model, lag=3)
    belief = robot.update(robot.predict(robot.initial(), {u: 1}), {z: 2, w: 0, u: 1})
    belief = robot.predict(belief, {u: [0, 1, 1]})
    belief = robot.update(belief, {z: [0, -1, 2], w: [1, 0, 1], u: [0, 1, 1]})
    evidence = {
        u: [[1, 0], [1, 1], [1, 1]],
        z: [[2, 0], [2, -1], [2, 2]],
        w: [[0, 1], [0, 0], [0, 1]],
    }
    due, smoothed = pgm.filter(world.model, evidence), pgm.smooth(world.model, evidence)
    for v in world.model.states:
        assert_allclose(belief[v].values, due[v.at(2)].values, **EQUAL)
        assert_allclose(belief.lagged[v].values, smoothed[v.at(0)].values, **EQUAL)
    assert_allclose(belief.log_evidence, due.log_evidence, rtol=1e-12)


@pytest.mark.parametrize("lag", [None, 60])
def test_a_hypothesis_comes_back_online(lag):
    rng = np.random.default_rng(0)
    x, z, *_ = hidden(rng, 2, 2)
    parts = np.array([0.5, 0.5]), np.eye(2), np.array([[1 - 1e-12, 1e-12], [1e-12, 1 - 1e-12]])
    network = model(x, z, *parts)
    robot = pgm.OnlineFilter(network, lag=lag)
    belief = robot.initial()
    for state in [1] * 40 + [0] * 41:
        belief = robot.update(robot.predict(belief), {z: state})
    assert_allclose(belief[x].values, [1.0, 1e-12], rtol=1e-9)
    if lag:
        assert_allclose(belief.lagged[x].values, [1.0, 1e-12], rtol=1e-9)


def test_a_filter_in_another_process():
    world = several(np.random.default_rng(5))
    robot = pgm.OnlineFilter(world.model, lag=1)
    pair = robot, robot.initial()
    other, belief = pickle.loads(pickle.dumps(pair))
    a, b = world.model.states
    moved = other.predict(belief, {world.model.inputs[0]: 0})
    due = robot.predict(robot.initial(), {world.model.inputs[0]: 0})
    assert_allclose(moved[b].values, due[b].values, rtol=1e-15)
    assert repr(robot) == f"OnlineFilter(over [{a!r}, {b!r}], lag=1)"


def test_errors():
    world = several(np.random.default_rng(5))
    robot = pgm.OnlineFilter(world.model)
    u, (z, w) = world.model.inputs[0], world.model.sensors
    with pytest.raises(pgm.ModelError, match="linearises nothing"):
        pgm.OnlineFilter(world.model, pgm.Unscented())
    with pytest.raises(pgm.ModelError, match="takes one of them"):
        pgm.OnlineFilter(world.model, schedule=pgm.Filtering(), lag=2)
    with pytest.raises(pgm.ModelError, match=r"takes pgm.Filtering\(...\) or"):
        pgm.OnlineFilter(world.model, schedule=pgm.Smoothing())
    start = robot.initial()
    with pytest.raises(pgm.EvidenceError, match="without a lag"):
        _ = start.lagged
    with pytest.raises(pgm.EvidenceError, match="the belief at step 0 is over"):
        start[world.slices[0]]
    with pytest.raises(pgm.EvidenceError, match="no evidence for u"):
        robot.predict(start)
    with pytest.raises(pgm.EvidenceError, match=r"inputs of the transition, \[u\], not z"):
        robot.predict(start, {u: 0, z: 1})
    with pytest.raises(pgm.EvidenceError, match="none of its states"):
        robot.update(start, {z: 7})
    with pytest.raises(pgm.ModelError, match="no belief to go on from"):
        pgm.OnlineFilter(world.model, lag=2).predict(start, {u: 0})
    with pytest.raises(pgm.EvidenceError, match="at step 0, but its parent c is a control"):
        robot.update(start, {w: 0, u: 0})
    x, z, *_ = hidden(np.random.default_rng(0), 2, 2)
    still = model(x, z, np.array([1.0, 0.0]), np.eye(2), np.eye(2))
    robot = pgm.OnlineFilter(still)
    with pytest.raises(pgm.EvidenceError, match="measurement of z at step 1 has probability zero"):
        robot.update(robot.predict(robot.initial()), {z: 1})
