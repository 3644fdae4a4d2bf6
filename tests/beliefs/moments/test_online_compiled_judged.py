"""Robots that are lost, lags, robust noise and iterations online: machine code as NumPy."""

import pickle
import warnings

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


@pytest.mark.parametrize("iterations", [1, 3])
def test_robust_noise_is_weighed_and_iterations_end_unsettled_alike(iterations):
    x, z, y = pgm.Variable("x"), pgm.Variable("z"), pgm.Variable("y")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [1.0], 1.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.1)],
        [
            pgm.NonlinearGaussianCPD(
                z, given=(x,), function=lambda v: v + 0.3 * v**2, cov=0.5, noise=pgm.StudentT(4.0)
            ),
            pgm.LinearGaussianCPD(y, {x: 1.0}, cov=0.5, noise=pgm.Huber(1.5)),
        ],
    )
    schedule = pgm.Filtering(iterations=iterations, tolerance=1e-4, gate={z: 0.99})
    runs = []
    for robot in pair(model, schedule=schedule, watch=True):
        belief, beliefs, rng = robot.initial(), [], np.random.default_rng(3)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            for k in range(20):
                far = 6.0 * (k % 5 == 4)
                readings = {z: pgm.sightings(1.0 + far + rng.normal(size=(1 + k % 3, 1)))}
                if k % 2:
                    readings[y] = np.array([1.0 + far])
                belief = robot.update(robot.predict(belief), readings)
                beliefs.append(belief)
        runs.append((robot, beliefs, [str(each.message) for each in said]))
    (_, due, words), (quick, found, again) = runs
    assert quick.compilation == "compiled"
    for each, its in zip(found, due, strict=True):
        assert_same(each, its)
    assert {bool(each.status.converged) for each in due} >= {False}
    assert words == again
    assert bool(words) == (iterations > 1)
    assert any(each.rejected[z].rejected.any() for each in due)
