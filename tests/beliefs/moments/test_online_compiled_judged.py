"""A robot that is kidnapped, and a lag that float64 loses, online in machine code as by NumPy."""

import pickle

import numpy as np
import pytest
from test_online_compiled import assert_same, is_compiled, pair

import pgm

pytest.importorskip("llvmlite")


def test_a_robot_that_is_kidnapped_is_lost_and_found():
    """A sensor that jumps, readings of two sensors of which one has a gate, and three updates."""
    x, z, y = pgm.Variable("x"), pgm.Variable("z"), pgm.Variable("y")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0], 1.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.1)],
        [pgm.LinearGaussianCPD(v, {x: 1.0}, cov=0.5) for v in (z, y)],
    )
    plain, quick = pair(model, gate={z: 0.95}, watch=True)
    due, found = plain.initial(), quick.initial()
    rng, lost = np.random.default_rng(1), []
    for k in range(120):
        off = 9.0 * (30 < k < 60)
        updates = (
            {z: pgm.sightings(off + 0.7 * rng.normal(size=(1 + k % 2, 1)))},
            {y: np.array([off + 0.7 * rng.normal()]), z: np.array([np.nan])},
            {},
        )
        due, found = plain.predict(due), quick.predict(found)
        assert_same(found, due)
        for readings in updates[: 1 + k % 3]:
            due, found = plain.update(due, readings), quick.update(found, readings)
            assert is_compiled(found), quick.compilation
        if k == 40:  # on from what was kept, in a filter without machine code of its own yet
            plain, due, quick, found = pickle.loads(pickle.dumps((plain, due, quick, found)))
            z, y = (cpd.child for cpd in quick.model.observation)
        assert_same(found, due)
        lost.append(bool(found.lost))
    assert quick.compilation.startswith("compiled, but for: 1 × the belief is")  # unpickled
    assert not any(lost[:30])
    assert any(lost[30:60])
    assert not any(lost[100:])


def test_lagged_beliefs_that_float64_loses_are_refused_alike():
    x, z = pgm.Variable("x"), pgm.Variable("z")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0], 1.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.1)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1e-9)],
    )
    said = []
    for robot in pair(model, lag=2):
        belief = robot.predict(robot.predict(robot.initial()))
        belief = robot.predict(robot.update(belief, {z: np.array([0.1])}))  # in twice the digits
        belief = robot.predict(belief)
        assert robot.compiled == is_compiled(belief)
        with pytest.raises(pgm.NumericalError) as error:
            belief.lagged  # noqa: B018
        said.append(str(error.value))
    assert said[0] == said[1]
