"""Online, CPDs all of whose parents are observed, or that have none, as in the filter."""

import numpy as np
import pytest
from textbooks import assert_log, assert_same

import pgm

x = pgm.Variable("x", components=("east", "heading"), angles=("heading",))
c = pgm.Variable("c", components=("v", "w"))  # a hidden control
u = pgm.Variable("u", components=("v", "w"))
m = pgm.Variable("m", components=("east", "north"))
z = pgm.Variable("z")
s = pgm.Variable("s", components=("range", "bearing"), angles=("bearing",))

T, COV = 3, np.array([[0.1, 0.02], [0.02, 0.2]])
RULES = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "cubature": pgm.Cubature(),
    "gauss-hermite": pgm.GaussHermite(3),
    "monte carlo": pgm.MonteCarlo(40, seed=1),
    "fresh": pgm.MonteCarlo(40, seed=1, fresh_per_run=True),
    "callable": lambda function, at: pgm.Taylor()(function, at),
}


def place(a):
    """Where an input leads, whatever was before."""
    return np.stack([np.sin(a[..., 0]) + a[..., 1], 3.0 * a[..., 0] * a[..., 1]], axis=-1)


def move(before, a):
    """A motion that depends on the state before."""
    shift = np.stack([a[..., 0] * np.cos(before[..., 1]), 0.3 * a[..., 1]], axis=-1)
    return before + shift


def sight(a):
    """A range and a bearing that say nothing of the state."""
    return np.stack([np.hypot(a[..., 0], a[..., 1]), 2 * np.arctan2(a[..., 1], a[..., 0])], axis=-1)


def spread(a):
    """A noise that grows with an input."""
    return COV * (1.0 + a[..., :1, None] ** 2)


DRIVE = pgm.NonlinearGaussianCPD(x, (x.previous, u), move, COV)
MODELS = {
    "motion": ([pgm.NonlinearGaussianCPD(x, u, place, COV)], []),
    "its noise": ([pgm.NonlinearGaussianCPD(x, u, place, pgm.noise(spread, given=u))], []),
    "singular": ([pgm.NonlinearGaussianCPD(x, u, place, np.diag([0.0, 0.1]))], []),
    "certain": ([pgm.NonlinearGaussianCPD(x, u, place, np.zeros((2, 2)))], []),
    "linear": ([pgm.LinearGaussianCPD(x, {u: [[1.0, 0.2], [0.0, 3.0]]}, cov=COV)], []),
    "no parents": ([pgm.GaussianCPD(x, [0.2, 3.0], COV)], []),
    "hidden control": (
        [
            pgm.NonlinearGaussianCPD(c, u, place, 0.1 * COV),
            pgm.NonlinearGaussianCPD(x, (x.previous, c), move, COV),
        ],
        [],
    ),
    "free control": (
        [
            pgm.GaussianCPD(c, [1.0, 0.4], 0.1 * COV),
            pgm.NonlinearGaussianCPD(x, (x.previous, c), move, COV),
        ],
        [],
    ),
    "sensor": ([DRIVE], [pgm.NonlinearGaussianCPD(s, m, sight, COV)]),
    "its own noise": ([DRIVE], [pgm.NonlinearGaussianCPD(s, m, sight, pgm.noise(spread, given=m))]),
    "grouped": ([DRIVE], [pgm.NonlinearGaussianCPD(s, m, sight, COV, grouped=True)]),
    "linear sensor": ([DRIVE], [pgm.LinearGaussianCPD(s, {m: np.eye(2)}, cov=COV)]),
    "sensor of nothing": ([DRIVE], [pgm.GaussianCPD(s, [1.0, 3.0], COV)]),
}

RULED = {"motion", "its noise", "hidden control", "sensor", "grouped"}


def network(kind):
    """A model whose state is read too, so that what has gone before matters."""
    transition, observation = MODELS[kind]
    heading = pgm.NonlinearGaussianCPD(z, x, lambda a: a[..., :1] * a[..., 1:], 0.3)
    prior = pgm.GaussianCPD(x, [0.1, 0.2], 0.3 * np.eye(2))
    return pgm.DynamicBayesianNetwork([prior], transition, [heading, *observation])


@pytest.mark.parametrize(("runs", "iterations", "count"), [((), 1, 1), ((), 1, 2), ((3,), 2, 2)])
@pytest.mark.parametrize(
    ("rule", "kind"),
    [(rule, kind) for kind in MODELS for rule in (RULES if kind in RULED else ["unscented"])],
)
def test_online_equals_the_filter(rule, kind, runs, iterations, count):
    rng = np.random.default_rng(4)
    model = network(kind)
    inputs = {u: rng.normal(size=(*runs, T, 2))} if u in model.inputs else {}
    readings = {v: rng.normal(size=(*runs, T * count, v.dimension)) for v in model.sensors}
    landmarks = {m: rng.normal(size=(*runs, T * count, 2))} if m in model.inputs else {}

    def seen(rows, step=None):
        return {
            v: pgm.sightings(
                z[..., rows, :],
                step=step,
                given={w: a[..., rows, :] for w, a in landmarks.items() if v == s},
            )
            for v, z in readings.items()
        }

    recorded = inputs | seen(slice(None), np.repeat(np.arange(1, T + 1), count))
    asked = {"iterations": iterations, "tolerance": 0}
    filtered = pgm.filter(model, recorded, steps=T, lineariser=RULES[rule], **asked)
    robot = pgm.OnlineFilter(model, RULES[rule], pgm.Filtering(**asked))
    belief = robot.initial()
    for t in range(T):
        belief = robot.predict(belief, {v: a[..., t, :] for v, a in inputs.items()})
        belief = robot.update(belief, seen(slice(t * count, (t + 1) * count)))
        for v in (*model.states, *model.controls):
            assert_same(belief[v], filtered[v.at(t + 1)])
    assert_log(belief.log_evidence, filtered.log_evidence)


@pytest.mark.parametrize("rule", RULES)
def test_a_motion_of_inputs_alone_forgets_the_past(rule):
    robot = pgm.OnlineFilter(network("motion"), RULES[rule])
    value = np.array([0.4, -1.2])
    belief = robot.predict(robot.initial(), {u: value})
    assert np.allclose(belief[x].mean, place(value), rtol=0, atol=1e-14)
    assert np.allclose(belief[x].cov, COV, rtol=0, atol=1e-14)
