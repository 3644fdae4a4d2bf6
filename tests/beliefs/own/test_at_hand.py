"""What a slice has at hand in which method, and that it refuses the rest in words."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from tests.beliefs.own.ensemble import EnsembleKalman

x, u, z = pgm.variables("x u z")
MODEL = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(x, 0.0, 1.0)],
    [pgm.LinearGaussianCPD(x, {x.previous: 1.0, u: 1.0}, cov=0.1)],
    [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.5)],
)
EVIDENCE = {u: [[1.0], [10.0], [100.0]], z: [[1.0], [11.0], [111.0]]}


def asking(method, ask):
    """An ensemble of which one method asks its slice."""

    def asks(self, at, *beliefs):
        ask(at, *beliefs)
        return getattr(EnsembleKalman, method)(self, at, *beliefs)

    return type("Asking", (EnsembleKalman,), {method: asks})(20)


def online(belief):
    robot = pgm.OnlineFilter(MODEL, belief=belief)
    return robot.update(robot.predict(robot.initial(), {u: [1.0]}), {z: [1.0]})


def offline(belief):
    return pgm.filter(MODEL, EVIDENCE, belief=belief)


@pytest.mark.parametrize("run", [online, offline])
def test_no_transition_leads_to_step_0(run):
    family = asking("begin", lambda at: at.moved(np.zeros((1, 5, 1)), at.generators(1)))
    with pytest.raises(pgm.ModelError, match=r"step 0.*no transition leads to step 0; prior"):
        run(family)


def test_inputs_are_those_that_lead_to_the_step():
    found = {}
    family = asking("take", lambda at, belief: found.update({at.step: at.inputs[u].item()}))
    offline(family)
    assert found == {1: 1.0, 2: 10.0, 3: 100.0}
    found.clear()
    online(asking("predict", lambda at, belief: found.update({at.step: at.inputs[u].item()})))
    assert found == {1: 1.0}


@pytest.mark.parametrize(
    "ask",
    [
        lambda at, belief: at.inputs,
        lambda at, belief: at.cpds,
        lambda at, belief: at.moved(belief, at.generators(1)),
        lambda at, belief: at.mean(belief),
        lambda at, belief: at.log_density(belief, belief),
    ],
    ids=["inputs", "cpds", "moved", "mean", "log_density"],
)
def test_online_an_update_has_no_inputs(ask):
    with pytest.raises(pgm.ModelError, match=r"Slice\(step 1.*an update has no inputs .* predict"):
        online(asking("take", ask))


def test_on_the_way_back_the_transition_is_that_to_the_next_step():
    found, drawn = {}, {}

    def ask(at, known, predicted, later):
        found[at.step] = at.inputs[u].item() if at.step else 0.0, at.next.inputs[u].item()
        assert at.next.step == at.step + 1
        moved = at.next.mean(known)
        assert_allclose(moved, known + found[at.step][1], rtol=1e-14)
        assert at.next.log_density(later, known).shape == known.shape[:2]
        drawn[at.step] = at.generators(0)[0].normal(), at.next.generators(0)[0].normal()

    pgm.smooth(MODEL, EVIDENCE, belief=asking("back", ask))
    assert found == {2: (10.0, 100.0), 1: (1.0, 10.0), 0: (0.0, 1.0)}
    assert len({each for pair in drawn.values() for each in pair}) == 6


@pytest.mark.parametrize("method", ["begin", "predict", "take"])
def test_on_the_way_forward_there_is_no_next_step(method):
    with pytest.raises(pgm.ModelError, match="the step after is known on the way back alone"):
        offline(asking(method, lambda at, *beliefs: at.next))


def test_a_transition_asked_by_itself_needs_the_points_before():
    def ask(at, belief):
        (cpd,) = at.cpds
        cpd.mean(belief)

    with pytest.raises(pgm.ModelError, match=r"is given x\[t-1\]: give points of the step before"):
        offline(asking("predict", ask))


@pytest.mark.parametrize("run", [online, offline])
@pytest.mark.parametrize("method", ["begin", "predict"])
def test_a_prediction_knows_no_measurements(run, method):
    with pytest.raises(pgm.ModelError, match="come before the measurements of their step"):
        run(asking(method, lambda at, *beliefs: at.measurements))


def test_points_may_be_lists_and_generators_are_one_a_run():
    class Lists(EnsembleKalman):
        def predict(self, at, belief):
            return at.moved(belief.tolist(), at.generators(self.seed))

    found, due = offline(Lists(20)), offline(EnsembleKalman(20))
    assert_allclose(found[x].mean, due[x].mean, rtol=1e-12)
    one = asking("predict", lambda at, belief: at.moved(belief, at.generators(0)[0]))
    with pytest.raises(pgm.ModelError, match="a sequence of 1, one a run"):
        offline(one)


def test_a_family_that_refers_to_itself_is_shown():
    family = EnsembleKalman(3)
    family.myself = family
    assert repr(family) == "EnsembleKalman(n=3, seed=0, myself=...)"
