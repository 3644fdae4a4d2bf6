"""Further updates of one step online: each draws anew, and knows the one before."""

import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.examples import walk, x, z
from tests.beliefs.own.ensemble import EnsembleKalman
from tests.beliefs.own.kalman import Kalman


def updated(belief, readings):
    """The belief at step 1 after an update for each reading."""
    robot = pgm.OnlineFilter(walk, belief=belief)
    found = robot.predict(robot.initial())
    for reading in readings:
        found = robot.update(found, {z: [reading]})
    return found


@pytest.mark.parametrize("readings", [[4.0, 3.0], [4.0, 3.0, -1.0, 0.5]])
def test_an_ensemble_learns_from_each(readings):
    """The posterior of a Gaussian of variance 2 by readings of variance 2, in closed form."""
    found = updated(EnsembleKalman(40_000), readings)
    precision = 0.5 + 0.5 * len(readings)
    assert_allclose(found[x].mean, [0.5 * sum(readings) / precision], atol=0.03)
    assert_allclose(found[x].cov, [[1.0 / precision]], rtol=0.04)
    assert_allclose(found.log_evidence, updated(None, readings).log_evidence, atol=0.05)
    assert_allclose(updated(Kalman(), readings)[x].mean, updated(None, readings)[x].mean)


class Drawing(Kalman):
    """It keeps a number that it drew in each method."""

    def __init__(self):
        self.drawn = []

    def drew(self, at):
        self.drawn.append(next(float(rng.normal()) for rng in at.generators(7)))

    def begin(self, at):
        self.drew(at)
        return super().begin(at)

    def predict(self, at, belief):
        self.drew(at)
        return super().predict(at, belief)

    def take(self, at, belief):
        self.drew(at)
        self.drew(at)
        return super().take(at, belief)


def test_random_numbers_are_of_a_step_a_method_an_update_and_a_call():
    family = Drawing()
    robot = pgm.OnlineFilter(walk, belief=family)
    belief = robot.predict(robot.initial())
    for reading in (1.0, 2.0, 3.0):
        belief = robot.update(belief, {z: [reading]})
    assert len(set(family.drawn)) == len(family.drawn) == 8
    robot.update(robot.predict(belief), {z: [4.0]})
    assert len(set(family.drawn)) == 11
    recorded = Drawing()
    pgm.filter(walk, {z: [[1.0]]}, belief=recorded)
    assert recorded.drawn == family.drawn[:4]


def test_a_log_evidence_is_read_only():
    found = updated(Kalman(), [1.0])
    assert not found.log_evidence.flags.writeable
    assert not pgm.filter(walk, {z: [[1.0]]}, belief=Kalman()).log_evidence.flags.writeable
