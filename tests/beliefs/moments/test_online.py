"""A robot's loop: beliefs are values, and evidence of any kind is taken or refused at each step."""

import copy
import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from plain import linear_network
from robots import DRIVE, LANDMARKS, SENSORS, drive_cpd, m, network, u, x
from textbooks import assert_belief, assert_log, assert_same, exact_linear
from zoo import MODELS

import pgm

SIGHT = SENSORS["range_bearing"]
SEEN = np.array([[5.0, 1.0]])


@pytest.fixture
def robot():
    """A filter, and a belief of its after a step."""
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    belief = robot.predict(robot.initial(), {u: [1.0, 0.1]})
    return robot, robot.update(belief, {SIGHT.z: pgm.sightings(SEEN, given={m: LANDMARKS[:1]})})


@pytest.mark.parametrize("runs", [(), (3,)])
def test_updates_one_after_another_are_the_joint_conditioned_in_rational_numbers(runs):
    """Of all shapes at once: a hidden control, a bias, two sensors; some steps read twice."""
    model, steps, inputs, readings = linear_network()
    due = exact_linear(model, steps, inputs, readings)
    robot = pgm.OnlineFilter(model)
    belief = robot.initial()
    for step in range(steps + 1):
        if step:
            given = {v: np.broadcast_to(rows[step - 1], (*runs, 1)) for v, rows in inputs.items()}
            belief = robot.predict(belief, given)
        for sensor, when, value, _ in readings:
            if when == step:
                belief = robot.update(belief, {sensor: np.broadcast_to(value, (*runs, 1))})
        for variable, (mean, cov) in due.filtered[step].items():
            size = len(mean)
            wide = np.broadcast_to(mean, (*belief.lead, size))
            wide_cov = np.broadcast_to(cov, (*belief.lead, size, size))
            assert_belief(belief[variable], wide, wide_cov)
    assert_log(belief.log_evidence, due.joint.log_evidence)
    assert belief.log_evidence.shape == runs


def test_updates_with_nothing_change_nothing(robot):
    filter_, belief = robot
    for nothing in (
        {},
        {SIGHT.z: pgm.sightings(np.zeros((0, 2)), given={m: np.zeros((0, 2))})},
        {SIGHT.z: pgm.sightings([[np.nan, np.nan]], given={m: LANDMARKS[:1]})},
    ):
        after = filter_.update(belief, nothing)
        assert_same(after[x], belief[x], 0.0)
        assert after.log_evidence == belief.log_evidence
        assert after.step == belief.step == 1


def test_a_second_update_linearises_at_the_first_ones_posterior():
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    belief = robot.predict(robot.initial(), {u: [1.0, 0.1]})
    one, two = (
        {SIGHT.z: pgm.sightings([value], given={m: [LANDMARKS[k]]})}
        for k, value in enumerate(([8.0, 1.0], [4.5, 2.5]))
    )
    first = robot.update(belief, one)
    again = network(SIGHT.cpd(), prior=pgm.GaussianCPD(x, first[x].mean, first[x].cov))
    second, fresh = robot.update(first, two), pgm.OnlineFilter(again)
    due = fresh.update(fresh.initial(), two)
    assert_same(second[x], due[x])
    assert_log(second.log_evidence, first.log_evidence + due.log_evidence)
    together = {SIGHT.z: pgm.sightings([[8.0, 1.0], [4.5, 2.5]], given={m: LANDMARKS[:2]})}
    assert np.abs(robot.update(belief, together)[x].mean - second[x].mean).max() > 1e-6


def test_beliefs_and_filters_are_values():
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    start = robot.initial()
    kept = start[x].mean.copy(), start[x].cov.copy()
    left = robot.predict(start, {u: [1.0, 0.5]})
    right = robot.predict(start, {u: [1.0, -0.5]})
    assert_belief(start[x], *kept, 0.0)
    assert left[x].mean[2] == pytest.approx(0.5)
    assert right[x].mean[2] == pytest.approx(-0.5)
    for value, name in ((robot, "model"), (start, "step")):
        with pytest.raises(AttributeError):
            setattr(value, name, None)
    with pytest.raises(ValueError, match="read-only"):
        start[x].mean[0] = 1.0


# ---- forms that evidence may have


@pytest.mark.parametrize(
    "control",
    [
        [1, 0],
        (1.0, 0.0),
        np.array([1, 0]),
        np.float32([1, 0]),
        np.array([[1.0, 5.0], [0.0, 5.0]])[:, 0],
        pgm.constant([1.0, 0.0]),
    ],
)
def test_values_of_any_kind(robot, control):
    filter_, belief = robot
    due = filter_.predict(belief, {u: np.array([1.0, 0.0])})
    assert_same(filter_.predict(belief, {u: control})[x], due[x], 1e-12)


def test_an_input_of_sensors_may_stand_beside_their_sightings(robot):
    filter_, belief = robot
    due = filter_.update(belief, {SIGHT.z: pgm.sightings(SEEN, given={m: LANDMARKS[:1]})})
    for readings in (
        {SIGHT.z: SEEN[0], m: LANDMARKS[0]},
        {m: LANDMARKS[0], SIGHT.z: pgm.sightings(SEEN)},
    ):
        found = filter_.update(belief, readings)
        assert_same(found[x], due[x], 1e-12)
        assert_log(found.log_evidence, due.log_evidence)


def test_equal_variables_need_not_be_the_same_object(robot):
    filter_, belief = robot
    twin = copy.deepcopy(u)
    assert twin is not u
    one, other = (filter_.predict(belief, {each: [1.0, 0.1]}) for each in (u, twin))
    np.testing.assert_array_equal(one[x].mean, other[x].mean)


def test_what_the_user_gave_stays_his():
    """Functions cannot write into it, the filter leaves it writable and keeps no hold of it."""
    kept = []

    def keeping(state, control):
        kept.append(control)
        return DRIVE(state, control)

    robot = pgm.OnlineFilter(network(transition=drive_cpd(function=keeping)))
    belief = robot.predict(robot.initial(), {u: [1.0, 0.1]})
    control = np.array([1.0, 0.1])
    after = robot.predict(belief, {u: control})
    mean = after[x].mean.copy()
    assert control.flags.writeable
    assert not kept[-1].flags.writeable
    control[:] = 9.0
    np.testing.assert_array_equal(after[x].mean, mean)


# ---- refusals


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda r, b: r.predict(b, {u: [np.nan, 0.1]}), "NaN"),
        (lambda r, b: r.predict(b, {u: [np.inf, 0.1]}), "infinite"),
        (lambda r, b: r.predict(b, {u: [1.0, 0.1, 0.2]}), "u"),
        (lambda r, b: r.predict(b, {u: "fast"}), "numbers"),
        (lambda r, b: r.predict(b, {u: [1j, 0.0]}), "numbers"),
        (lambda r, b: r.predict(b, {}), "u"),
        (lambda r, b: r.predict(b, {u: [1.0, 0.1], SIGHT.z: [5.0, 1.0]}), "update"),
        (
            lambda r, b: r.update(b, {SIGHT.z: pgm.sightings(SEEN, [1], {m: LANDMARKS[:1]})}),
            "step=",
        ),
        (
            lambda r, b: r.update(b, {SIGHT.z: pgm.sightings(SEEN, given={m: LANDMARKS[:2]})}),
            "2 rows",
        ),
        (
            lambda r, b: r.update(b, {SIGHT.z: pgm.sightings(SEEN, given={m: [[np.nan, 0.0]]})}),
            "NaN",
        ),
        (
            lambda r, b: r.update(b, {SIGHT.z: pgm.sightings(SEEN[:, :1], given={m: LANDMARKS})}),
            "shape",
        ),
        (
            lambda r, b: r.update(
                b, {SIGHT.z: pgm.sightings([[np.inf, 1.0]], given={m: LANDMARKS[:1]})}
            ),
            "infinite",
        ),
        (lambda r, b: r.update(b, {SIGHT.z: pgm.sightings(SEEN)}), "no evidence for m"),
        (
            lambda r, b: r.update(
                b, {SIGHT.z: pgm.sightings(SEEN, given={m: LANDMARKS[:1]}), m: LANDMARKS[0]}
            ),
            "give it once",
        ),
        (lambda r, b: r.update(b, {x: [0.0, 0.0, 0.0]}), "hidden"),
        (lambda r, b: r.predict(b, [1.0, 0.1]), "predict takes a mapping of inputs"),
        (lambda r, b: r.update(b, [5.0, 1.0]), "update takes a mapping of sensors"),
        (lambda r, b: r.update(b, {SIGHT.z: "near", m: LANDMARKS[0]}), "numbers"),
        (lambda r, b: r.update(b, {SIGHT.z: 5.0, m: LANDMARKS[0]}), "shape"),
    ],
)
@pytest.mark.parametrize("fresh", [True, False])
def test_what_is_refused_at_first_is_refused_later(robot, call, words, fresh):
    """With nothing prepared, and with the same kinds of evidence prepared."""
    filter_, belief = robot
    with pytest.raises(pgm.EvidenceError, match=words):
        call(copy.copy(filter_) if fresh else filter_, belief)


def test_a_reading_too_large_to_be_squared_is_refused_without_a_warning(robot):
    filter_, belief = robot
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(pgm.NumericalError, match=f"at step {belief.step} is indefinite"):
            filter_.update(belief, {SIGHT.z: [1e300, 0.0], m: LANDMARKS[0]})


def test_a_prediction_too_large_for_numbers_is_refused(robot):
    filter_, belief = robot
    with pytest.raises(pgm.NumericalError, match="predicted covariance at step 2 is not finite"):
        filter_.predict(belief, {u: [1e160, 0.1]})
    controls = [[1.0, 0.1], [1e160, 0.1]]
    for runs in (1, 40):
        with pytest.raises(pgm.NumericalError, match="covariance at step 2 is not finite"):
            pgm.filter(filter_.model, {u: np.broadcast_to(controls, (runs, 2, 2))})


@pytest.mark.parametrize("runs", [(), (2,)])
def test_a_contradiction_names_the_step(runs):
    state, seen = pgm.variables("state seen")
    certain = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(state, [1.0], 0.0)],
        transition=[pgm.LinearGaussianCPD(state, {state.previous: 1.0}, cov=0.0)],
        observation=[pgm.LinearGaussianCPD(seen, {state: 1.0}, cov=0.0)],
    )
    filter_ = pgm.OnlineFilter(certain)
    belief = filter_.initial()
    for _ in range(3):
        belief = filter_.update(filter_.predict(belief), {seen: np.ones((*runs, 1))})
    with pytest.raises(pgm.NumericalError, match="at step 3, run 0, contradicts") as caught:
        filter_.update(belief, {seen: np.full((*runs, 1), 2.0)})
    assert caught.value.step == 3


def test_a_first_step_without_controls_is_told_from_later_ones():
    """Where there are no controls, a reading of one is refused: at later steps there were some."""
    told, command, state, control = pgm.variables("told command state control")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(state, 0.0, 1.0)],
        [
            pgm.LinearGaussianCPD(control, {command: 1.0}, cov=0.1),
            pgm.LinearGaussianCPD(state, {state.previous: 1.0, control: 1.0}, cov=0.1),
        ],
        [pgm.LinearGaussianCPD(told, {control: 1.0}, cov=0.1)],
    )
    robot = pgm.OnlineFilter(model)
    start = robot.initial()
    robot.update(robot.predict(start, {command: [1.0]}), {told: [1.1]})
    with pytest.raises(pgm.EvidenceError, match="controls begin at step 1"):
        robot.update(start, {told: [1.1]})


# ---- numbers that are special


@pytest.mark.parametrize("runs", [(), (2,)])
def test_a_sensor_that_is_exact_at_times_only(runs):
    """What a step was laid out with does not say what noise a later one has."""
    place, reading, spread = (
        pgm.Variable("place", ("here", "rate")),
        pgm.Variable("reading"),
        pgm.Variable("s"),
    )
    noise, small = pgm.noise(lambda s: s[..., None] ** 2, given=spread), 0.01 * np.eye(2)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, np.zeros(2), np.eye(2))],
        [pgm.LinearGaussianCPD(place, {place.previous: [[1.0, 0.1], [0.0, 1.0]]}, cov=small)],
        [pgm.LinearGaussianCPD(reading, {place: [[1.0, 0.0]]}, cov=noise)],
    )
    rows = [(reading, 1, [v], {spread: [s]}) for v, s in ((0.3, 1.0), (0.7, 0), (0.7, 0), (0.7, 1))]
    due = exact_linear(model, 1, {}, rows)
    robot = pgm.OnlineFilter(model)
    belief = robot.predict(robot.initial())

    def seen(value, given):
        wide = np.broadcast_to(value, (*runs, 1, 1))
        return {reading: pgm.sightings(wide, given={spread: [given[spread]]})}

    for _, _, value, given in rows:
        belief = robot.update(belief, seen(value, given))
    mean, cov = due.filtered[1][place]
    np.testing.assert_allclose(belief[place].mean, np.broadcast_to(mean, (*runs, 2)), atol=1e-12)
    np.testing.assert_allclose(belief[place].cov, np.broadcast_to(cov, (*runs, 2, 2)), atol=1e-12)
    np.testing.assert_allclose(belief.log_evidence, due.joint.log_evidence, rtol=1e-12)
    with pytest.raises(pgm.NumericalError, match="reading at step 1, run 0, contradicts an exact"):
        robot.update(belief, seen([0.9], {spread: [0.0]}))


@pytest.mark.parametrize("apart", [False, True])
def test_what_a_motion_makes_certain_is_certain(apart):
    """A difference whose variance is zero, not what rounding leaves of it."""
    a, b, both = pgm.Variable("a"), pgm.Variable("b"), pgm.Variable("both", ("a", "b"))
    pair = pgm.GaussianCPD(both, [0.0, 0.0], np.outer([0.3, 0.1], [0.3, 0.1]))
    if apart:
        model = pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(b, 0.0, 0.013), pgm.LinearGaussianCPD(a, {b: 3.1}, cov=0.0)],
            [
                pgm.LinearGaussianCPD(a, {a.previous: 2.3, b.previous: -7.13}, cov=0.0),
                pgm.LinearGaussianCPD(b, {b.previous: 0.7}, cov=0.0),
            ],
            [],
        )
    else:
        matrix = [[1.0, -3.0], [0.0, 0.7]]
        motion = pgm.LinearGaussianCPD(both, {both.previous: matrix}, cov=np.zeros((2, 2)))
        model = pgm.DynamicBayesianNetwork([pair], [motion], [])
    robot = pgm.OnlineFilter(model)
    belief = robot.predict(robot.initial())
    assert belief.cov[0, 0] == belief.cov[0, 1] == 0.0
    swept = pgm.filter(model, {}, steps=1)
    known = swept[both] if not apart else swept[a]
    assert known.cov[1, 0, 0] == 0.0
    np.testing.assert_allclose(belief.cov[1, 1], 0.49 * (0.013 if apart else 0.01), rtol=1e-12)


def test_sharp_readings_of_what_is_hardly_known_cost_no_digits():
    place, readings = pgm.Variable("place"), [pgm.Variable("one"), pgm.Variable("other")]
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.0, 1e12)],
        [pgm.LinearGaussianCPD(place, {place.previous: 1.0}, cov=1.0)],
        [pgm.LinearGaussianCPD(z, {place: 1.0}, cov=1.0) for z in readings],
    )
    robot = pgm.OnlineFilter(model)
    belief = robot.update(robot.initial(), {readings[0]: [3.0], readings[1]: [5.0]})
    np.testing.assert_allclose(belief[place].mean, 4.0, rtol=1e-9)
    np.testing.assert_allclose(belief[place].cov, 0.5, rtol=1e-9)


@pytest.mark.parametrize("lead", [(), (3,)])
def test_a_mean_that_goes_far_keeps_its_digits(lead):
    """At 10¹² float64 has none of a deviation of 10⁻⁶; the belief there says so, and warns."""
    place, push = pgm.variables("place push")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.1, 1e-12)],
        [pgm.LinearGaussianCPD(place, {place.previous: 1.0, push: 1.0}, cov=0.0)],
        [],
    )
    robot = pgm.OnlineFilter(model)
    with pytest.warns(pgm.PrecisionWarning, match="too small beside its mean"):
        belief = robot.predict(robot.initial(), {push: np.full((*lead, 1), 1e12)})
    assert (belief.status.digits < 0.0).all()
    belief = robot.predict(belief, {push: np.full((*lead, 1), -1e12)})
    np.testing.assert_allclose(belief[place].mean, np.full((*lead, 1), 0.1), rtol=0, atol=1e-13)
    assert (belief.status.digits > 6).all()


@pytest.mark.parametrize("lag", [None, 3])
@pytest.mark.parametrize("wide", [1.0, 1e4])
@pytest.mark.parametrize("deviation", [1e-2, 1e-3])
def test_a_robot_far_from_the_origin_is_carried_in_float64(deviation, wide, lag):
    """At 5000 km float64 tells a millimetre; twice the digits would take fifty times as long."""
    place, fix = (pgm.Variable(name, components=("east", "north")) for name in ("place", "fix"))
    noise = deviation**2 * np.eye(2)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, [5e6, 5e6], wide**2 * noise)],
        [pgm.LinearGaussianCPD(place, {place.previous: np.eye(2)}, cov=0.25 * noise)],
        [pgm.LinearGaussianCPD(fix, {place: np.eye(2)}, cov=noise)],
    )
    robot = pgm.OnlineFilter(model, lag=lag)
    belief = robot.initial()
    for _ in range(4):
        belief = robot.update(robot.predict(belief), {fix: [5e6, 5e6]})
    assert belief.status.digits is None


# ---- preparation


def test_a_plan_is_made_once_for_each_kind_of_evidence(monkeypatch):
    from pgm.beliefs.moments.steps.plan import ChainPlan

    made, make = [], ChainPlan.make
    monkeypatch.setattr(ChainPlan, "make", lambda *a, **k: made.append(1) or make(*a, **k))
    robot = pgm.OnlineFilter(MODELS["plain"], pgm.Unscented())
    belief = robot.initial()
    for count in (1, 2, 1, 2, 1):
        belief = robot.predict(belief, {u: [1.0, 0.1]})
        readings = pgm.sightings(
            np.tile([5.0, 1.0], (count, 1)), given={m: np.tile(LANDMARKS[0], (count, 1))}
        )
        belief = robot.update(belief, {SIGHT.z: readings})
    assert len(made) == 4  # the prior, the motion, one sighting, two sightings


def test_threads_share_a_filter():
    robot = pgm.OnlineFilter(MODELS["plain"], pgm.Unscented())

    def drive(speed):
        belief = robot.initial()
        for _ in range(20):
            belief = robot.predict(belief, {u: [speed, 0.1]})
            readings = pgm.sightings([[5.0, speed]], given={m: LANDMARKS[:1]})
            belief = robot.update(belief, {SIGHT.z: readings})
        return belief[x].mean

    speeds = np.linspace(0.5, 1.5, 12)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(drive, speeds))
    np.testing.assert_array_equal(together, [drive(speed) for speed in speeds])


def test_a_filter_with_plans_is_pickled(robot):
    filter_, belief = robot
    twin, same = pickle.loads(pickle.dumps((filter_, belief)))
    due = filter_.predict(belief, {u: [1.0, 0.1]})
    found = twin.predict(same, {u: [1.0, 0.1]})
    np.testing.assert_array_equal(found[x].mean, due[x].mean)
