"""Evidence that does not fit is refused before any function of the model is called."""

import numpy as np
import pytest
from robots import DRIVE, LANDMARKS, P0, SENSORS, Q, u, x
from textbooks import assert_same, refusal

import pgm
from pgm import EvidenceError

m = pgm.Variable("m", components=("east", "north"))
z, POSE = SENSORS["range_bearing"].z, SENSORS["pose"]
fix = pgm.Variable("fix", components=x.components, angles=x.angles)
gauge, wheel, speed = pgm.variables("gauge wheel speed")
CALLS = []


def counting(function):
    def counted(*arguments):
        CALLS.append(function)
        return function(*arguments)

    return counted


MOVE = pgm.NonlinearGaussianCPD(
    x,
    (x.previous, u),
    counting(DRIVE),
    pgm.noise(counting(lambda c: np.ones((*c.shape[:-1], 1, 1)) * Q), given=u),
)
SIGHT = pgm.NonlinearGaussianCPD(
    z, (x, m), counting(SENSORS["range_bearing"].function), SENSORS["range_bearing"].cov
)
FIX = pgm.NonlinearGaussianCPD(fix, x, counting(POSE.function), POSE.cov)
GAUGE = pgm.LinearGaussianCPD(gauge, {x: [[1.0, 0, 0]]}, cov=0.1)
MODEL = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(x, [0, 0, 0], P0)], transition=[MOVE], observation=[SIGHT, FIX, GAUGE]
)
# The same with a control of its own CPD, and a sensor of it.
HIDDEN = MODEL.replace(
    transition=[
        pgm.NonlinearGaussianCPD(x, (x.previous, u), counting(DRIVE), Q),
        pgm.GaussianCPD(u, [1.0, 0.1], 0.1 * np.eye(2)),
    ],
    observation=[pgm.LinearGaussianCPD(wheel, {u: [[1.0, 0]]}, cov=0.1)],
)

T = 4
U = np.tile([1.0, 0.1], (T, 1))
GOOD = {u: U}
SEEN, AT = np.tile([5.0, 1.0], (3, 1)), LANDMARKS[[0, 0, 1]]


def holed(array, row, value=np.nan, column=None):
    out = np.array(array, dtype=float)
    out[..., row, slice(None) if column is None else column] = value
    return out


def smooth(evidence, model=MODEL, **options):
    return lambda: pgm.smooth(model, evidence, **options)


def sights(values=SEEN, step=(1, 2, 4), given=None):
    """Evidence with sightings of z."""
    rows = pgm.sightings(values, step=step, given={m: AT} if given is None else given)
    return GOOD | {z: rows}


def row(name, evidence, *words, model=MODEL, steps=None, **attributes):
    return refusal(name, smooth(evidence, model, steps=steps), EvidenceError, *words, **attributes)


SHAPES = [
    row("controls of 3 components", {u: np.zeros((T, 3))}, "u", "(4, 3)", "T, 2)", variable=u),
    row("controls without time", {u: [1.0, 0.1]}, "u", "(2,)", "T, 2)", variable=u),
    row("a number for controls", {u: 1.0}, "u", "()", "T, 2)", variable=u),
    row("words for controls", {u: "fast"}, "u", "numbers", "str", variable=u),
    row("ragged controls", {u: [[1, 2], [3]]}, "u", "numbers", "unequal length", variable=u),
    row("no controls", {u: None}, "u", variable=u),
    row(
        "a scalar without its axis",
        GOOD | {gauge: np.zeros(T)},
        "gauge",
        "(4,)",
        "value[..., None]",
        variable=gauge,
    ),
    row(
        "measurements of 2 components", GOOD | {fix: np.zeros((T, 2))}, "(4, 2)", "3)", variable=fix
    ),
    row("a constant of 3", {u: pgm.constant([1, 2, 3])}, "u", "(3,)", "2)", steps=T, variable=u),
    row("sightings of 1 component", sights([[5.0]], [1], {m: AT[:1]}), "(1, 1)", variable=z),
    row("sightings without rows", sights([5.0, 1.0], [1], {m: AT[:1]}), "(2,)", variable=z),
    row("landmarks of 3", sights(given={m: np.zeros((3, 3))}), "m", "(3, 3)", variable=m),
    row("2 landmarks for 3", sights(given={m: AT[:2]}), "3", "2", "m", variable=m, cpd=SIGHT),
    row("2 steps for 3", sights(step=[1, 2]), "3 measurements", "2 steps", variable=z),
    row("step 5 of 4", sights(step=[1, 5, 2]), "z", "5", "0..4", variable=z, step=5),
    row("step -1", sights(step=[1, -1, 2]), "z", "-1", "0..4", variable=z, step=-1),
    row("steps that are no integers", sights(step=[1.0, 2, 3]), "whole", "float64", variable=z),
    row("steps in a column", sights(step=[[1], [2], [3]]), "whole", "(3, 1)", variable=z),
    row("one step for all", sights(step=1), "whole", "()", variable=z),
    row("sightings without steps", sights(step=None), "z", "step=", variable=z),
    row("sightings without values", sights(values=None), "z", "no values", variable=z),
    row(
        "runs that do not broadcast",
        {u: np.zeros((3, T, 2)), fix: np.zeros((2, T, 3))},
        "(3,)",
        "(2,)",
        "broadcast",
    ),
    row(
        "runs that do not broadcast with the prior's",
        {u: np.zeros((3, T, 2))},
        "(3,)",
        "(2,)",
        "broadcast",
        model=MODEL.replace(prior=[pgm.GaussianCPD(x, np.zeros((2, 3)), P0)]),
    ),
]

LENGTHS = [
    row(
        "5 steps of controls, 4 of readings",
        {u: np.zeros((5, 2)), fix: np.zeros((4, 3))},
        "5",
        "4",
        "u",
        "fix",
    ),
    row("steps=5 and 4 rows", GOOD, "u", "4", "5", steps=5, variable=u),
    row("nothing tells T", {u: pgm.constant([1, 0.1])}, "steps="),
    row("steps=-1", {u: pgm.constant([1, 0.1])}, "-1", steps=-1),
    row("steps=2.5", {u: pgm.constant([1, 0.1])}, "2.5", steps=2.5),
    refusal(
        "a graph of 5 steps",
        lambda: pgm.infer(pgm.compile(MODEL, steps=5), GOOD),
        EvidenceError,
        "u",
        "4",
        "5",
        variable=u,
    ),
]

NUMBERS = [
    row("NaN in controls", {u: holed(U, 2)}, "u", "NaN", variable=u),
    row("infinite controls", {u: holed(U, 2, np.inf)}, "u", "infinite", variable=u),
    row("NaN in a constant", {u: pgm.constant([1, np.nan])}, "u", "NaN", steps=T, variable=u),
    row("NaN in a landmark", sights(given={m: holed(AT, 1)}), "m", "NaN", variable=m),
    row(
        "a partly infinite reading",
        GOOD | {fix: holed(np.zeros((T, 3)), 1, np.inf, column=0)},
        "fix",
        "infinite",
        "a component not taken is NaN",
        variable=fix,
    ),
    row("a partly known landmark", sights(given={m: holed(AT, 1, column=0)}), "NaN", variable=m),
    row("an infinite reading", sights(holed(SEEN, 1, -np.inf)), "z", "infinite", variable=z),
]

MEANING = [
    row("evidence for a state", GOOD | {x: np.zeros((T, 3))}, "x", "hidden", "sensor", variable=x),
    row("evidence for a hidden control", {u: U}, "u", "hidden", model=HIDDEN, variable=u),
    row(
        "an unknown variable",
        GOOD | {speed: np.zeros((T, 1))},
        "speed",
        "the network does not have",
        "fix",
        variable=speed,
    ),
    row("a variable at a step", {u.at(1): [1, 0.1]}, "u[1]", variable=u.at(1)),
    row(
        "a name that the model has otherwise",
        GOOD | {pgm.Variable("z"): np.zeros((T, 1))},
        "z",
        variable=pgm.Variable("z"),
    ),
    row("an input of the motion lacks", {fix: np.zeros((T, 3))}, "u", "x", variable=u, cpd=MOVE),
    row("an input of a sensor lacks", sights(given={}), "m", "z", variable=m, cpd=SIGHT),
    row(
        "a parent twice",
        sights() | {m: np.zeros((T, 2))},
        "m",
        "top level",
        "sightings",
        "once",
        variable=m,
        cpd=SIGHT,
    ),
    row(
        "a parent twice, as a constant",
        sights() | {m: pgm.constant([1, 2])},
        "once",
        variable=m,
        cpd=SIGHT,
    ),
    row("a stranger in given", sights(given={m: AT, u: SEEN}), "u", "z", variable=u, cpd=SIGHT),
    row(
        "a hidden parent in given", sights(given={m: AT, x: SEEN}), "x", "z", variable=x, cpd=SIGHT
    ),
    row(
        "step 0 with a landmark by rows",
        sights(step=[0, 1, 2], given={}) | {m: np.zeros((T, 2))},
        "z",
        "m",
        "step 0",
        "given=",
        variable=m,
        cpd=SIGHT,
        step=0,
    ),
    row(
        "step 0 of a sensor of a hidden control",
        {wheel: pgm.sightings([[1.0]], step=[0])},
        "wheel",
        "u",
        "step 0",
        model=HIDDEN,
        steps=T,
        variable=wheel,
        step=0,
    ),
    row(
        "sightings of an input",
        {u: pgm.sightings(U, step=[1, 2, 3, 4])},
        "u",
        "array",
        steps=T,
        variable=u,
    ),
    row(
        "a constant reading",
        GOOD | {fix: pgm.constant([0, 0, 0])},
        "fix",
        "sightings",
        variable=fix,
    ),
    refusal("no mapping", smooth([U]), EvidenceError, "maps variables", "list"),
    row("names for variables", {"u": U}, "u"),
]

TABLE = SHAPES + LENGTHS + NUMBERS + MEANING


@pytest.mark.parametrize("refused", TABLE, ids=lambda r: r.name)
def test_evidence_is_refused_before_any_call(refused):
    CALLS.clear()
    refused.check()
    assert not CALLS


@pytest.mark.parametrize("refused", TABLE[:3], ids=lambda r: r.name)
def test_evidence_errors_are_value_errors(refused):
    error = refused.check()
    assert isinstance(error, ValueError)
    assert isinstance(error, pgm.PgmError)


@pytest.mark.parametrize(
    ("evidence", "step"),
    [
        ({u: holed(U, 2)}, 3),
        ({u: holed(np.stack([U, U]), 2, np.inf)}, 3),
        (GOOD | {fix: holed(np.zeros((T, 3)), 1, np.inf, column=0)}, 2),
        (GOOD | {fix: holed(np.zeros((T, 3)), 0, np.inf)}, 1),
        (sights(given={m: holed(AT, 2)}), 4),
        (sights(holed(SEEN, 1, np.inf, column=0)), 2),
        (sights(step=[4, 0, 2], values=holed(SEEN, 1, np.inf)), 0),
    ],
)
def test_bad_numbers_say_at_which_step(evidence, step):
    with pytest.raises(EvidenceError, match=rf"step {step}\b") as caught:
        pgm.filter(MODEL, evidence)
    assert caught.value.step == step


@pytest.mark.parametrize("infer", [pgm.filter, pgm.smooth])
def test_the_good_evidence_is_taken(infer):
    """Else the rows would say nothing."""
    readings = holed(holed(np.zeros((T, 3)), 2), 1, column=0)
    evidence = sights(holed(SEEN, 1, column=1), step=[0, 4, 4]) | {fix: readings}
    assert infer(MODEL, evidence)[x].mean.shape == (T + 1, 3)
    assert infer(HIDDEN, {wheel: np.ones((T, 1))})[u].mean.shape == (T, 2)


def test_a_sensor_without_evidence_is_pruned():
    """Its inputs need no evidence then."""
    posterior = pgm.smooth(MODEL, GOOD)
    assert z not in posterior.innovations


# ---- online

ROBOT = pgm.OnlineFilter(MODEL)
BELIEF = ROBOT.predict(ROBOT.initial(), {u: [1.0, 0.1]})
SIGHTED = {z: pgm.sightings([[5.0, 1.0]], given={m: LANDMARKS[:1]})}
OTHER = pgm.OnlineFilter(HIDDEN)


def online(name, call, *words, **attributes):
    return refusal(name, call, EvidenceError, *words, **attributes)


ONLINE = [
    online("no control", lambda: ROBOT.predict(BELIEF), "u", variable=u, cpd=MOVE),
    online(
        "a control of 3", lambda: ROBOT.predict(BELIEF, {u: [1, 2, 3]}), "u", "(3,)", variable=u
    ),
    online("NaN", lambda: ROBOT.predict(BELIEF, {u: [np.nan, 0]}), "u", "NaN", variable=u),
    online(
        "a reading to predict",
        lambda: ROBOT.predict(BELIEF, {u: [1, 0], fix: [0, 0, 0]}),
        "fix",
        "update",
        variable=fix,
        step=2,
    ),
    online(
        "sightings with steps",
        lambda: ROBOT.update(BELIEF, {fix: pgm.sightings([[0, 0, 0]], step=[1])}),
        "fix",
        "step=",
        variable=fix,
    ),
    online(
        "a measurement of 2",
        lambda: ROBOT.update(BELIEF, {fix: [0, 0]}),
        "fix",
        "(2,)",
        variable=fix,
    ),
    online(
        "a landmark lacks",
        lambda: ROBOT.update(BELIEF, {z: [5.0, 1.0]}),
        "m",
        "z",
        variable=m,
        cpd=SIGHT,
    ),
    online(
        "2 landmarks for 1",
        lambda: ROBOT.update(BELIEF, {z: pgm.sightings([[5.0, 1.0]], given={m: LANDMARKS[:2]})}),
        "m",
        variable=m,
        cpd=SIGHT,
    ),
    online(
        "partly infinite",
        lambda: ROBOT.update(BELIEF, {fix: [np.inf, 0, 0]}),
        "infinite",
        variable=fix,
    ),
    online("a state", lambda: ROBOT.update(BELIEF, {x: [0, 0, 0]}), "x", "hidden", variable=x),
    online("a stranger", lambda: ROBOT.update(BELIEF, {speed: 1.0}), "speed", variable=speed),
    online(
        "a control read before there is one",
        lambda: OTHER.update(OTHER.initial(), {wheel: [1.0]}),
        "wheel",
        "u",
        "step 0",
        variable=wheel,
        step=0,
    ),
    online(
        "a control asked for before there is one",
        lambda: OTHER.initial()[u],
        "u",
        "step 0",
        variable=u,
        step=0,
    ),
    online("another step", lambda: BELIEF[x.at(5)], "x[5]", "step 1", variable=x.at(5), step=1),
    online("an observed variable", lambda: BELIEF[fix], "fix", variable=fix),
    online(
        "runs that do not broadcast",
        lambda: ROBOT.predict(ROBOT.predict(BELIEF, {u: np.zeros((3, 2))}), {u: np.zeros((2, 2))}),
        "(3,)",
        "(2,)",
    ),
]


@pytest.mark.parametrize("refused", ONLINE, ids=lambda r: r.name)
def test_an_online_filter_stays_usable_after_a_refusal(refused):
    before = ROBOT.update(BELIEF, SIGHTED)
    refused.check()
    after = ROBOT.update(BELIEF, SIGHTED)
    assert_same(after[x], before[x], 0.0)
    assert after.log_evidence == before.log_evidence
    assert after.step == 1


def test_a_contradiction_online_leaves_the_belief_as_it_was():
    exact = MODEL.replace(observation=[pgm.LinearGaussianCPD(fix, {x: 1.0}, cov=np.zeros((3, 3)))])
    robot = pgm.OnlineFilter(exact)
    known = robot.update(robot.initial(), {fix: [1.0, 2.0, 0.5]})
    with pytest.raises(pgm.NumericalError, match=r"fix.*step 0"):
        robot.update(known, {fix: [1.5, 2.0, 0.5]})
    again = robot.update(known, {fix: [1.0, 2.0, 0.5]})
    assert_same(again[x], known[x], 1e-9)
    ahead = robot.update(robot.predict(known, {u: [1.0, 0.1]}), {fix: [2.0, 2.4, 0.7]})
    np.testing.assert_allclose(ahead[x].mean, [2.0, 2.4, 0.7])
