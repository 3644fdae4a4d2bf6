"""Values can be copied and pickled, and not be changed."""

import copy
import pickle

import numpy as np
import pytest

import pgm
from models import motion, sensors

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("v", "omega", "dt"))
m = pgm.Variable("m", components=("east", "north"))
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
MODEL = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(x, np.zeros(3), np.eye(3))],
    transition=[
        pgm.NonlinearGaussianCPD(
            x,
            (x.previous, u),
            motion.velocity,
            0.01 * np.eye(3),
            jacobian={x.previous: motion.velocity_by_state},
        )
    ],
    observation=[pgm.NonlinearGaussianCPD(z, (x, m), sensors.range_bearing, 0.01 * np.eye(2))],
)
EVIDENCE = {
    u: np.tile([1.0, 0.1, 0.5], (4, 1)),
    z: pgm.sightings([[2.0, 0.1]], step=[2], given={m: [[3.0, 0.5]]}),
}
POSTERIOR = pgm.smooth(MODEL, EVIDENCE)
VALUES = {
    "variable": x,
    "gaussian": POSTERIOR[x],
    "canonical form": POSTERIOR.belief(2),
    "affine": pgm.AffineGaussian(np.eye(2), np.zeros(2), np.eye(2)),
    "cpd": MODEL.transition[0],
    "network": MODEL,
    "graph": pgm.compile(MODEL, 4),
    "sightings": EVIDENCE[z],
    "posterior": POSTERIOR,
    "online filter": pgm.OnlineFilter(MODEL),
    "sample": MODEL.sample(EVIDENCE, rng=0),
}
WAYS = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda value: pickle.loads(pickle.dumps(value)),
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
def test_values_are_copied(value, way):
    twin = way(value)
    assert type(twin) is type(value)
    assert repr(twin).split(" object at")[0] == repr(value).split(" object at")[0]


def test_a_pickled_posterior_answers_alike():
    twin = pickle.loads(pickle.dumps(POSTERIOR))
    np.testing.assert_array_equal(twin[x].mean, POSTERIOR[x].mean)
    np.testing.assert_array_equal(twin.message(3, 2).K, POSTERIOR.message(3, 2).K)


def test_results_cannot_be_changed():
    belief = pgm.OnlineFilter(MODEL).initial()
    found = POSTERIOR.innovations[z]
    for array in (belief.mean, belief.cov, found.residual, found.nis, POSTERIOR.status.converged):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 7
    with pytest.raises(TypeError):
        POSTERIOR.innovations[z] = None
    with pytest.raises(TypeError):
        MODEL.sample(EVIDENCE, rng=0).values[x] = None


def test_a_belief_belongs_to_its_model():
    other = MODEL.replace(observation=())
    with pytest.raises(pgm.ModelError, match="no belief of this filter's model"):
        pgm.OnlineFilter(other).predict(pgm.OnlineFilter(MODEL).initial(), {u: [1.0, 0.0, 0.1]})


def test_a_pickled_belief_goes_on_with_the_filter_beside_it():
    robot = pgm.OnlineFilter(MODEL)
    belief = robot.initial()
    moved = robot.predict(belief, {u: [1.0, 0.0, 0.1]})
    alone = pickle.loads(pickle.dumps(belief))
    with pytest.raises(pgm.ModelError, match=r"pickle.dumps\(\(robot, belief\)\)"):
        robot.predict(alone, {u: [1.0, 0.0, 0.1]})
    again, twin = pickle.loads(pickle.dumps((robot, belief)))
    np.testing.assert_array_equal(again.predict(twin, {u: [1.0, 0.0, 0.1]}).mean, moved.mean)
