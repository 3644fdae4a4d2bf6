"""Online filters of modes and continuous states: step by step what `filter` finds at once."""

import copy
import pickle

import numpy as np
import pytest

import pgm
from pgm.errors import Unanswered
from tests.beliefs.hypotheses.test_switching_chains import (
    MODE,
    READ,
    X,
    Z,
    far,
    observed_world,
    walk,
)
from tests.beliefs.hypotheses.test_unknown_sightings import (
    MARK,
    MARKS,
    MODEL,
    STEPS,
    open_sightings,
)
from tests.beliefs.hypotheses.test_unknown_sightings import READ as SEEN
from tests.beliefs.hypotheses.test_unknown_sightings import Z as SIGHTED


@pytest.mark.parametrize("belief", [None, pgm.Gaussians(7), pgm.Gaussians(mix=True)])
def test_steps_are_those_of_the_filter(belief):
    whole = pgm.filter(walk(), READ, belief=belief)
    robot = pgm.OnlineFilter(walk(), belief=belief)
    known = robot.initial()
    assert far(known[X].mean, 0.0) == 0.0
    for step, value in enumerate(READ[Z], 1):
        known = robot.predict(known)
        assert str(known.kind) == "predicted"
        known = robot.update(known, {Z: value})
        assert far(known[X].mean, whole[X.at(step)].mean) < 1e-12
        assert far(known[X].cov, whole[X.at(step)].cov) < 1e-12
        assert far(known[MODE].probabilities, whole[MODE.at(step)].probabilities) < 1e-12
    assert far(known.log_evidence, whole.log_evidence) < 1e-12
    assert known.step == 5
    assert "mode" in repr(known)


def test_a_step_may_be_updated_more_than_once_and_with_inputs():
    model, ground, evidence = observed_world()
    robot = pgm.OnlineFilter(model)
    known = robot.initial()
    whole = pgm.filter(model, evidence)
    for step in range(4):
        inputs = {v: values[:, step] for v, values in evidence.items() if v is not Z}
        known = robot.predict(known, inputs)
        known = robot.update(known, {Z: evidence[Z][:, step], ground: inputs[ground]})
    assert far(known[X].mean, whole[X.at(4)].mean) < 1e-12
    assert far(known.log_evidence, whole.log_evidence) < 1e-12
    twice = pgm.OnlineFilter(walk())
    one = twice.update(twice.predict(twice.initial()), {Z: [1.0]})
    both = twice.update(one, {Z: [0.5]})
    wanted = pgm.filter(walk(), {Z: pgm.sightings([[1.0], [0.5]], step=[1, 1])}, steps=1)
    assert far(both[X].mean, wanted[X.at(1)].mean) < 1e-12
    assert far(both.log_evidence, wanted.log_evidence) < 1e-12


def test_one_robot_becomes_many_with_its_first_evidence_of_runs():
    robot = pgm.OnlineFilter(walk())
    alone = robot.update(robot.predict(robot.initial()), {Z: [1.0]})
    many = robot.update(robot.predict(alone), {Z: [[0.0], [2.0], [4.0]]})
    assert many[X].mean.shape == (3, 1)
    for run, value in enumerate((0.0, 2.0, 4.0)):
        one = robot.update(robot.predict(alone), {Z: [value]})
        assert far(many[X].mean[run], one[X].mean) < 1e-12
        assert far(many.log_evidence[run], one.log_evidence) < 1e-12
    with pytest.raises(pgm.EvidenceError, match="do not broadcast to one set of runs"):
        robot.update(robot.predict(many), {Z: [[0.0], [2.0]]})


@pytest.mark.parametrize("association", ["sum", "joint"])
def test_open_sightings_are_taken_in_online(association):
    gate = 1 - 1e-12 if association == "joint" else None
    belief = pgm.Gaussians(40)
    options = {"association": association, "gate": gate}
    whole = pgm.filter(MODEL, open_sightings(**options), steps=2, belief=belief)
    robot = pgm.OnlineFilter(MODEL, belief=belief)
    known = robot.initial()
    for step in (1, 2):
        unknown = {MARK: pgm.unknown(MARKS, **options)}
        known = robot.predict(known)
        known = robot.update(known, {SIGHTED: pgm.sightings(SEEN[step == STEPS], given=unknown)})
    state = MODEL.states[0]
    assert far(known.log_evidence, whole.log_evidence) < 1e-12
    assert far(known[state].mean, whole[state.at(2)].mean) < 1e-12
    found = known.associations[SIGHTED].probability
    assert far(found[-1], whole.associations[SIGHTED].probability[-1]) < 1e-12


def test_filters_and_beliefs_are_copied_together():
    robot = pgm.OnlineFilter(walk(), belief=pgm.Gaussians(3))
    known = robot.predict(robot.initial())
    for again in (copy.deepcopy((robot, known)), pickle.loads(pickle.dumps((robot, known)))):
        other, belief = again
        found = other.update(belief, {Z: [1.0]})
        assert far(found[X].mean, robot.update(known, {Z: [1.0]})[X].mean) == 0.0
    with pytest.raises(pgm.ModelError, match="is no belief to go on from"):
        pgm.OnlineFilter(walk(q=(0.1, 1.0))).predict(known)
    with pytest.raises(pgm.PgmError, match="lag"):
        pgm.OnlineFilter(walk(), lag=3)
    with pytest.raises(pgm.EvidenceError, match="there is no x"):
        known[X.at(3)]
    with pytest.raises(Unanswered, match="have none online"):
        known.lagged  # noqa: B018
    assert np.isfinite(known.log_evidence)
