"""Tables that are functions of inputs: small numbers in them, and their errors."""

import numpy as np
import pytest
from markov.test_long import exactly
from numpy.testing import assert_allclose

import pgm

x, z, v = pgm.Discrete("x", 2), pgm.Discrete("z", 2), pgm.Variable("v")


def network(motion, sensor=lambda v: np.array([[0.9, 0.1], [0.2, 0.8]])):
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(x, table=[0.5, 0.5])],
        transition=[pgm.TableCPD(x, given=x.previous, inputs=v, table=motion)],
        observation=[pgm.TableCPD(z, given=x, inputs=v, table=sensor)],
    )


@pytest.mark.parametrize("exponent", [-3.0, -80.0, -200.0])
@pytest.mark.parametrize("online", [False, True])
def test_small_entries_are_seen_when_they_come(exponent, online):
    def sensor(v):
        small = 10.0 ** v[0]
        return np.array([[1.0 - small, small], [small, 1.0 - small]])

    model = network(lambda v: np.eye(2), sensor)
    seen = [1, 1, 0, 0, 0]
    table = sensor(np.array([exponent]))
    filtered, smoothed = exactly([0.5, 0.5], np.eye(2), [np.ones(2), *table[:, seen].T])
    if online:
        robot = pgm.OnlineFilter(model)
        belief = robot.initial()
        for state, due in zip(seen, filtered[1:], strict=True):
            belief = robot.predict(belief, {v: exponent})
            belief = robot.update(belief, {z: state, v: exponent})
            assert_allclose(belief[x].values, due, rtol=1e-9, atol=1e-300)
        return
    evidence = {z: seen, v: np.full((5, 1), exponent)}
    posterior = pgm.smooth(model, evidence)
    assert_allclose(posterior.filtered[x].values, filtered, rtol=1e-9, atol=1e-300)
    assert_allclose(posterior[x].values, smoothed, rtol=1e-9, atol=1e-300)


def test_impossible_evidence_is_so_at_its_step():
    model = network(lambda v: np.eye(2), lambda v: np.array([[1.0, 0.0], [1.0, 0.0]]))
    with pytest.raises(pgm.EvidenceError, match="z at step 2 has probability zero"):
        pgm.filter(model, {z: [0, 1, 0], v: np.zeros((3, 1))})


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        (lambda v: np.eye(3) if v[0] > 1 else np.eye(2), r"table at step 2 has shape \(3, 3\)"),
        (lambda v: np.eye(2) * (0.5 if v[0] > 1 else 1), "at step 2 sum to 0.5"),
        (lambda v: np.eye(2) * (np.nan if v[0] > 1 else 1), "table at step 2 has entries that"),
        (lambda v: np.eye(2) if v[0] < 1 else None, "at step 2 must return numbers, not"),
        (lambda v: 1 / 0 if v[0] > 1 else np.eye(2), "failed at step 2: ZeroDivisionError"),
    ],
)
def test_the_step_of_an_error_is_told(motion, message):
    with pytest.raises(pgm.ModelError, match=message) as caught:
        pgm.filter(network(motion), {z: [0, 0, 0], v: [[0.0], [2.0], [0.0]]})
    assert caught.value.step == 2
