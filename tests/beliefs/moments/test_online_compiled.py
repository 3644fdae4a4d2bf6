"""Steps online in machine code: those of NumPy to 1e-9 deviations, and the same refusals."""

import pickle
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from robots import LANDMARKS, SENSORS, m, u, x
from textbooks import assert_belief, assert_log
from zoo import MODELS, RULES, at_step, of_run, recording

import pgm
from pgm import examples

pytest.importorskip("llvmlite")
SIGHT = SENSORS["range_bearing"]
z = SIGHT.z
CASES = [
    *((name, "taylor") for name in MODELS if name != "a start for each run"),
    *(("plain", rule) for rule in ("unscented", "negative weights", "hermite", "sobol")),
    ("everything", "unscented"),
    ("wrapping drive", "cubature"),
]
# Of these models steps are asked for all that they can tell.
ASKED = {
    "everything": {"gate": 0.6, "watch": True, "lag": 3},
    "grouped": {"schedule": pgm.Filtering(iterations=3, tolerance=0.0, gate=0.6)},
}
# The steps that machine code makes none of, since it does not know their noise or their rule.
GENERAL = {
    ("noise by control", "taylor"): {"predicted"},
    ("noise by landmark", "taylor"): {"filtered"},
    ("an exact range", "taylor"): {"filtered"},
    ("plain", "sobol"): {"predicted", "filtered"},
}


def is_compiled(belief):
    return "step" not in vars(belief)  # which is made when it is asked for


def pair(model, rule="taylor", **settings):
    return [
        pgm.OnlineFilter(model, RULES[rule], compiled=each, **settings) for each in (False, True)
    ]


def assert_equal(found, due):
    for variable in due.layout.slice if due.step else due.layout.states:
        assert_belief(found[variable], due[variable].mean, due[variable].cov, 1e-9)
    assert_log(found.log_evidence, due.log_evidence, 1e-9)
    assert (found.step, str(found.kind), found.lead) == (due.step, str(due.kind), ())
    own, its = found.status, due.status
    assert (own.iterations, own.converged.tolist()) == (its.iterations, its.converged.tolist())
    assert own.residuals == pytest.approx(its.residuals, rel=1e-3, abs=1e-7)
    assert str(own) == str(its) or its.residuals.size
    assert not found.mean.flags.writeable
    assert not found[variable].cov.flags.writeable


def assert_same(found, due):
    """All that a belief tells of its step, and of the step a lag before."""
    assert_equal(found, due)
    assert list(found.rejected) == list(due.rejected)
    for variable, its in due.rejected.items():
        own = found.rejected[variable]
        assert (own.gate, own.step.tolist()) == (its.gate, its.step.tolist())
        assert own.rejected.tolist() == its.rejected.tolist()
        assert own.square == pytest.approx(its.square, rel=1e-7, nan_ok=True)
    if due.watch is not None:
        own, its = (belief.watch.test(belief.step) for belief in (found, due))
        assert own.level == pytest.approx(its.level, rel=1e-7, abs=1e-9)
        since = its.level > 1e-9  # a sum of zero begins anew
        assert own.onset[since].tolist() == its.onset[since].tolist()
        for name in ("lost", "first", "declared", "why"):
            assert getattr(own, name).tolist() == getattr(its, name).tolist()
    if due.behind is not None:
        assert_equal(found.lagged, due.lagged)


def journey(robot, evidence, steps=9):
    """Each belief of a run, and the kinds of those made in machine code."""
    belief = robot.initial()
    yield belief, set()
    for step in range(steps):
        inputs, readings = at_step(evidence, step)
        if step:
            belief = robot.predict(belief, inputs)
            yield belief, {"predicted"} if is_compiled(belief) else set()
        if readings:
            belief = robot.update(belief, readings)
            yield belief, {"filtered"} if is_compiled(belief) else set()


@pytest.mark.parametrize(("name", "rule"), CASES)
def test_steps_are_those_of_numpy(name, rule):
    evidence, kinds, decided = of_run(recording(name), 1), set(), []
    plain, quick = pair(MODELS[name], rule, **ASKED.get(name, {}))
    for (due, _), (found, kind) in zip(
        journey(plain, evidence), journey(quick, evidence), strict=True
    ):
        kinds |= kind
        assert_same(found, due)
        decided += [each for its in found.rejected.values() for each in its.rejected]
    assert kinds == {"predicted", "filtered"} - GENERAL.get((name, rule), set())
    assert (0 < sum(decided) < len(decided)) == (name in ASKED)


def test_linear_steps_with_inputs_are_those_of_numpy():
    """Two states, inputs of the motion and of a sensor, which hold for one sighting or for all."""
    a, b = pgm.Variable("a", components=("place", "speed")), pgm.Variable("b")
    force, lift, level = pgm.Variable("force"), pgm.Variable("lift"), pgm.Variable("level")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, [0.0, 1.0], np.eye(2)), pgm.GaussianCPD(b, [1.0], 2.0)],
        transition=[
            pgm.LinearGaussianCPD(
                a, {a.previous: [[1.0, 0.1], [0.0, 1.0]], force: [[0.0], [0.1]]}, cov=0.1
            ),
            pgm.LinearGaussianCPD(b, {b.previous: 0.9, a: [[0.1, 0.0]]}, offset=[0.3], cov=0.2),
        ],
        observation=[
            pgm.LinearGaussianCPD(level, {a: [[1.0, 0.0]], b: 1.0, lift: 2.0}, offset=1.0, cov=0.3)
        ],
    )
    plain, quick = pair(model)
    due, found = plain.initial(), quick.initial()
    updates = (
        {level: np.array([2.0]), lift: np.array([0.1])},
        {level: pgm.sightings([[2.0], [1.0]], given={lift: [[0.1], [0.2]]})},
        {level: pgm.sightings([[2.0], [np.nan], [0.5]]), lift: np.array([0.4])},
        {level: [1.5], lift: [0.2]},
    )
    for readings in updates:
        given = {force: np.array([0.5])}
        due, found = plain.predict(due, given), quick.predict(found, given)
        assert is_compiled(found)
        assert_equal(found, due)
        due, found = plain.update(due, readings), quick.update(found, readings)
        assert is_compiled(found)
        assert_equal(found, due)


@pytest.fixture(scope="module")
def robots():
    """A filter with and one without, and their beliefs after a step."""
    filters = pair(MODELS["plain"])
    beliefs = [robot.predict(robot.initial(), {u: [1.0, 0.1]}) for robot in filters]
    sight = {z: pgm.sightings([[5.0, 1.0]], given={m: LANDMARKS[:1]})}
    return [(r, r.update(belief, sight)) for r, belief in zip(filters, beliefs, strict=True)]


ODD = {
    "whole numbers": lambda v: v.astype(int),
    "lists": lambda v: v.tolist(),
    "single precision": lambda v: v.astype(np.float32),
    "strided": lambda v: np.repeat(v, 3, axis=-1)[..., ::3],
    "other bytes": lambda v: v.astype(">f8"),
}


@pytest.mark.parametrize("odd", ODD.values(), ids=ODD)
@pytest.mark.parametrize("count", [1, 2])
def test_arrays_of_any_kind_are_taken(robots, odd, count):
    found = []
    for robot, belief in robots:
        belief = robot.predict(belief, {u: odd(np.array([1.0, 0.0]))})
        seen = pgm.sightings(
            odd(np.tile([5.0, 1.0], (count, 1))), given={m: odd(LANDMARKS[:count])}
        )
        found.append(robot.update(belief, {z: seen}))
    assert_equal(*reversed(found))


BAD = {
    "no input": ("predict", {}),
    "none": ("predict", None),
    "a stranger": ("predict", {u: [1.0, 0.1], x: [0.0, 0.0, 0.0]}),
    "too wide": ("predict", {u: np.ones(3)}),
    "two axes": ("predict", {u: np.ones((2, 3))}),
    "a number": ("predict", {u: 1.0}),
    "NaN": ("predict", {u: np.array([1.0, np.nan])}),
    "infinite": ("predict", {u: np.array([np.inf, 1.0])}),
    "no mapping": ("predict", [u]),
    "too long": ("update", {z: pgm.sightings(np.ones((1, 3)), given={m: LANDMARKS[:1]})}),
    "other counts": ("update", {z: pgm.sightings(np.ones((2, 2)), given={m: LANDMARKS[:1]})}),
    "one axis": ("update", {z: pgm.sightings(np.ones(2), given={m: LANDMARKS[:1]})}),
    "infinite bearings": ("update", {z: pgm.sightings([[1.0, np.inf]], given={m: LANDMARKS[:1]})}),
    "a lost landmark": ("update", {z: pgm.sightings(np.ones((1, 2)), given={m: [[np.nan, 1.0]]})}),
    "no landmark": ("update", {z: pgm.sightings(np.ones((1, 2)))}),
    "a step": ("update", {z: pgm.sightings(np.ones((1, 2)), step=[1], given={m: LANDMARKS[:1]})}),
    "a state": ("update", {x: np.ones(3)}),
    "no readings": ("update", None),
}


@pytest.mark.parametrize(("method", "given"), BAD.values(), ids=BAD)
def test_refusals_are_the_same(robots, method, given):
    said = []
    for robot, belief in robots:
        with pytest.raises(pgm.PgmError) as error:
            getattr(robot, method)(belief, given)
        said.append((type(error.value), str(error.value)))
    assert said[0] == said[1]


def test_a_landmark_where_the_robot_is_has_no_bearing(robots):
    said = []
    for robot, belief in robots:
        here = belief[x].mean[None, :2]
        with pytest.raises(pgm.PgmError) as error:
            robot.update(belief, {z: pgm.sightings([[1.0, 1.0]], given={m: here})})
        said.append(str(error.value))
    assert said[0] == said[1]


def test_beliefs_of_others_are_refused_or_taken(robots):
    (plain, due), (quick, found) = robots
    given = {u: np.array([1.0, 0.1])}
    for robot, belief in ((quick, due), (plain, found)):
        assert_equal(robot.predict(belief, given), plain.predict(due, given))
    with pytest.raises(pgm.ModelError, match="no belief of this filter's model"):
        pgm.OnlineFilter(MODELS["grouped"], compiled=True).predict(found, given)
    with pytest.raises(pgm.ModelError, match="begin with initial"):
        quick.predict(None, given)


def test_a_marginal_shows_numbers_that_no_one_changes(robots):
    controls = {u: np.array([1.0, 0.1])}
    due, found = (robot.predict(belief, controls) for robot, belief in robots)
    assert is_compiled(found)
    own = found[x]
    assert own.scope == (x,)
    assert own.steps is None
    for array in (own.mean, own.cov):
        assert array.flags.c_contiguous
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.flags.writeable = True
    assert pickle.loads(pickle.dumps(own)).mean.tolist() == own.mean.tolist()
    del found
    assert_belief(own, due[x].mean, due[x].cov, 1e-9)
    with pytest.raises(AttributeError, match="immutable"):
        own.mean = due.mean


def test_steps_without_evidence_are_made_in_machine_code():
    plain, quick = pair(examples.walk)
    due, found = plain.initial(), quick.initial()
    for k in range(8):
        given = () if k % 2 else ({},)
        due, found = (r.predict(b, *given) for r, b in ((plain, due), (quick, found)))
        due, found = (r.update(b, {}) for r, b in ((plain, due), (quick, found)))
        assert is_compiled(found)
    assert_equal(found, due)
    for robot, belief in ((plain, due), (quick, found)):
        with pytest.raises(pgm.EvidenceError, match="update takes a mapping"):
            robot.update(belief, None)
        with pytest.raises(pgm.EvidenceError, match="predict takes a mapping"):
            robot.predict(belief, [])


def test_filters_and_beliefs_are_pickled(robots):
    quick, found = robots[1]
    robot, belief = pickle.loads(pickle.dumps((quick, quick.predict(found, {u: [1.0, 0.1]}))))
    assert robot.compiled
    both = [(robot, belief), (quick, quick.predict(found, {u: [1.0, 0.1]}))]
    assert_equal(*(each.predict(known, {u: np.array([1.0, 0.1])}) for each, known in both))


def test_threads_share_a_filter(robots):
    quick, belief = robots[1]
    controls = [np.array([1.0, 0.01 * k]) for k in range(200)]

    def last(_):
        known = belief
        for control in controls:
            known = quick.predict(known, {u: control})
        return known[x].mean

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(last, range(8)))
    assert all((each == found[0]).all() for each in found)


def test_settings_are_refused(monkeypatch):
    model = MODELS["plain"]
    with pytest.raises(pgm.ModelError, match="compiled='fast'"):
        pgm.OnlineFilter(model, compiled="fast")
    with pytest.raises(pgm.ModelError, match="online, particles are moved by NumPy"):
        pgm.OnlineFilter(model, belief=pgm.Particles(10), compiled=True)
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    assert not pgm.OnlineFilter(model).compiled
    with pytest.raises(ImportError, match="pip install 'llvmlite'"):
        pgm.OnlineFilter(model, compiled=True)


def test_a_control_is_not_measured_at_step_0():
    a, b, c = pgm.Variable("a"), pgm.Variable("b"), pgm.Variable("c")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, [0.0], 1.0)],
        transition=[
            pgm.GaussianCPD(b, [1.0], 0.5),
            pgm.LinearGaussianCPD(a, {a.previous: 1.0, b: 1.0}, cov=0.1),
        ],
        observation=[pgm.LinearGaussianCPD(c, {b: 1.0}, cov=0.2)],
    )
    plain, quick = pair(model)
    readings = {c: np.array([1.0])}
    due, found = (r.update(r.predict(r.initial()), readings) for r in (plain, quick))
    assert is_compiled(found)
    assert_equal(found, due)
    with pytest.raises(pgm.EvidenceError, match="controls begin at step 1"):
        quick.update(quick.initial(), readings)


def test_sightings_of_unknown_landmarks_are_associated(robots):
    readings = {
        z: pgm.sightings([[5.0, 1.0]], given={m: pgm.unknown(LANDMARKS, association="likelihood")})
    }
    due, found = (robot.update(belief, readings) for robot, belief in robots)
    assert_equal(found, due)
    assert str(found.associations[z]) == str(due.associations[z])
    plain, quick = (robot for robot, _ in robots)
    assert "1 × sightings without identity are associated by NumPy" in quick.compilation
    controls = {u: np.array([1.0, 0.1])}
    again = quick.predict(found, controls)
    assert is_compiled(again)
    assert_equal(again, plain.predict(due, controls))
