"""One robot online, whose plan is made once: the general way's results, and all its refusals."""

import copy
import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from robots import DRIVE, LANDMARKS, SENSORS, drive_cpd, m, network, u, x
from zoo import MODELS, RULES, command, compass, fix, seen

import pgm
def assert_close(a,b,w): np.testing.assert_allclose(a,b,rtol=1e-9,atol=1e-11)

SIGHT = SENSORS["range_bearing"]
T = 6


def steps(model, seed=3):
    """What a robot gives at each step: inputs, and several updates of all kinds."""
    rng = np.random.default_rng(seed)
    drive = command if command in model.inputs else u
    state = np.zeros(3)
    for step in range(T + 1):
        inputs = np.array([rng.uniform(0.5, 1.5), rng.uniform(0.0, 0.35)])
        if step:
            state = DRIVE(state, inputs)
        count = step % 4
        landmarks = LANDMARKS[rng.integers(0, 2, count)]
        values = SIGHT.draw(np.tile(state, (count, 1)), landmarks, rng)
        if count == 3:
            values[1] = np.nan
        updates = [{SIGHT.z: pgm.sightings(values, given={m: landmarks})}]
        if count:
            updates.append({SIGHT.z: values[0], m: landmarks[0]})
            # What holds for all sightings of a step may stand beside them.
            updates.append({m: landmarks[0], SIGHT.z: pgm.sightings(values)})
        if seen in model.sensors and step:
            both = {seen: SIGHT.draw(state, LANDMARKS[2], rng), compass: [state[2] + 6.3]}
            updates += [updates[0] | both, {fix: LANDMARKS[2]}, {}]
        yield {drive: inputs}, updates


def beliefs(model, rule, lean):
    robot = pgm.OnlineFilter(model, rule)
    found = []
    belief = robot.initial()
    for step, (inputs, updates) in enumerate(steps(model)):
        if step:
            belief = robot.predict(belief, inputs)
            found.append(belief)
        for readings in updates:
            belief = robot.update(belief, readings)
            found.append(belief)
    return found


# Sharp readings that contradict each other, as these do, magnify rounding.
FAIR = sorted(set(MODELS) - {"an exact range", "sharp readings"})


@pytest.mark.parametrize("rule", ["taylor", "unscented", "monte carlo", "fresh", "bare function"])
@pytest.mark.parametrize("name", FAIR)
def test_it_is_the_general_way(name, rule):
    mine = beliefs(MODELS[name], RULES[rule], lean=True)
    its = beliefs(MODELS[name], RULES[rule], lean=False)
    for found, due in zip(mine, its, strict=True):
        assert found.step == due.step
        assert_close(found.mean, due.mean, "mean")
        assert_close(found.cov, due.cov, "cov")
        assert_close(found.log_evidence, due.log_evidence, "log-evidence")
        assert found.log_evidence.shape == ()
        assert found.status.converged == due.status.converged
        assert found.status.iterations == 1
        for cov in (found.cov, due.cov):
            assert (cov == cov.T).all()


def test_the_general_way_is_not_taken(monkeypatch):
    """Otherwise the comparisons would compare it with itself."""

    def refuse(*arguments, **options):
        raise AssertionError("an ordinary step went the general way")

    from pgm.inference.chain import forward, online

    monkeypatch.setattr(forward, "predict", refuse)
    monkeypatch.setattr(online, "take", refuse)
    robot = pgm.OnlineFilter(MODELS["plain"])
    belief = robot.initial()
    for _ in range(3):
        belief = robot.predict(belief, {u: [1.0, 0.1]})
        belief = robot.update(belief, {SIGHT.z: pgm.sightings([[5, 1]], given={m: LANDMARKS[:1]})})
        belief = robot.update(belief, {})


def test_a_plan_is_made_once(monkeypatch):
    from pgm.inference.chain.plan import ChainPlan

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


@pytest.fixture
def robot():
    """A filter that has its plans."""
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    belief = robot.predict(robot.initial(), {u: [1.0, 0.1]})
    belief = robot.update(belief, {SIGHT.z: pgm.sightings([[5, 1]], given={m: LANDMARKS[:1]})})
    return robot, belief


SEEN = np.array([[5.0, 1.0]])


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
def test_what_was_refused_is_refused_with_plans_at_hand(robot, call, words):
    filter_, belief = robot
    with pytest.raises(pgm.EvidenceError, match=words):
        call(filter_, belief)


def test_equal_variables_need_not_be_the_same_object(robot):
    filter_, belief = robot
    twin = copy.deepcopy(u)
    assert twin is not u
    one, other = (filter_.predict(belief, {each: [1.0, 0.1]}) for each in (u, twin))
    np.testing.assert_array_equal(one[x].mean, other[x].mean)


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
    found = filter_.predict(belief, {u: control})
    assert_close(found[x].mean, due[x].mean, "mean")
    assert_close(found[x].cov, due[x].cov, "cov")


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


def test_a_function_that_reuses_its_result_does_not_change_beliefs():
    room = np.zeros(3)

    def drive(state, control):
        if state.ndim > 1:
            return DRIVE(state, control)
        room[:] = DRIVE(state, control)
        return room

    robot = pgm.OnlineFilter(network(transition=drive_cpd(function=drive)))
    belief = robot.predict(robot.initial(), {u: [1.0, 0.1]})
    mean = belief[x].mean.copy()
    robot.predict(belief, {u: [1.0, 0.1]})
    np.testing.assert_array_equal(belief[x].mean, mean)
    assert room.flags.writeable


@pytest.mark.parametrize("jacobian", ["kept", "new"])
def test_sensors_may_share_a_function_that_reuses_its_result(jacobian):
    room = np.zeros((2, 3))

    def by_state(state, landmark):
        slope = SIGHT.by_state(state, landmark)
        if jacobian == "new" or slope.ndim > 2:
            return slope
        room[:] = slope
        return room

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0.0, 0.0, 0.0], 0.1 * np.eye(3))],
        transition=[drive_cpd()],
        observation=[
            pgm.NonlinearGaussianCPD(z, (x, m), SIGHT.function, SIGHT.cov, jacobian={x: by_state})
            for z in (SIGHT.z, seen)
        ],
    )
    due = np.array([[4.0, -0.3], [6.0, 0.4]])
    readings = {
        z: pgm.sightings(value[None], given={m: LANDMARKS[k : k + 1]})
        for k, (z, value) in enumerate(zip((SIGHT.z, seen), due, strict=True))
    }
    robot, plain = pgm.OnlineFilter(model), pgm.OnlineFilter(model)
    online, expected = (r.update(r.initial(), readings)[x] for r in (robot, plain))
    evidence = {z: pgm.sightings(each.values, [0], each.given) for z, each in readings.items()}
    swept = pgm.filter(model, evidence | {u: np.zeros((0, 2))})[x.at(0)]
    for found in (online, swept):
        assert_close(found.mean, expected.mean, "mean")
        assert_close(found.cov, expected.cov, "cov")


def test_a_function_that_needs_an_axis_goes_the_general_way():
    def drive(state, control):
        moved = DRIVE(state, control)
        moved[moved[..., 0] < -99.0] = 0.0
        length = moved[..., 0]
        length[length > 99.0] = 99.0  # a number without axes has no entries to set
        return moved

    robot = pgm.OnlineFilter(network(transition=drive_cpd(function=drive)))
    plain = pgm.OnlineFilter(network())
    found, due = (r.predict(r.initial(), {u: [1.0, 0.1]}) for r in (robot, plain))
    assert_close(found[x].mean, due[x].mean, "mean")


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


def test_a_reading_too_large_to_be_squared_is_refused_without_a_warning(robot):
    filter_, belief = robot
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(pgm.NumericalError, match=f"at step {belief.step} is indefinite"):
            filter_.update(belief, {SIGHT.z: [1e300, 0.0], m: LANDMARKS[0]})


@pytest.mark.parametrize("runs", [(), (2,)])
def test_a_contradiction_names_the_step(runs):
    state, seen = pgm.Variable("state"), pgm.Variable("seen")
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


@pytest.mark.parametrize("lean", [True, False])
def test_a_sensor_that_is_exact_at_times_only(lean):
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
    values, spreads = [0.3, 0.7, 0.7, 0.7], [1.0, 0.0, 0.0, 1.0]
    due = pgm.filter(
        model,
        {reading: pgm.sightings(np.c_[values], [1] * 4, {spread: np.c_[spreads]})},
        steps=1,
    )
    robot = pgm.OnlineFilter(model)
    belief = robot.predict(robot.initial())
    for value, each in zip(values, spreads, strict=True):
        belief = robot.update(belief, {reading: pgm.sightings([[value]], given={spread: [[each]]})})
    np.testing.assert_allclose(belief[place].mean, due[place].mean[1], atol=1e-12)
    np.testing.assert_allclose(belief[place].cov, due[place].cov[1], atol=1e-12)
    np.testing.assert_allclose(belief.log_evidence, due.log_evidence, rtol=1e-12)
    with pytest.raises(pgm.NumericalError, match="reading at step 1, run 0, contradicts an exact"):
        robot.update(belief, {reading: pgm.sightings([[0.9]], given={spread: [[0.0]]})})


@pytest.mark.filterwarnings("ignore:overflow")
def test_a_prediction_too_large_for_numbers_is_refused(robot):
    filter_, belief = robot
    with pytest.raises(pgm.NumericalError, match="predicted covariance at step 2 is not finite"):
        filter_.predict(belief, {u: [1e160, 0.1]})
    controls = [[1.0, 0.1], [1e160, 0.1]]
    for runs in (1, 40):
        with pytest.raises(pgm.NumericalError, match="covariance at step 2 is not finite"):
            pgm.filter(filter_.model, {u: np.broadcast_to(controls, (runs, 2, 2))})


@pytest.mark.parametrize("rule", ["taylor", "unscented"])
def test_a_function_that_changes_its_argument_is_refused(rule):
    def drive(state, control):
        state[..., 0] += 1.0
        return state + control[..., :1]

    robot = pgm.OnlineFilter(
        network(transition=pgm.NonlinearGaussianCPD(x, (x.previous, u), drive, cov=np.eye(3))),
        RULES[rule],
    )
    with pytest.raises(pgm.ModelError, match=r"trial call .* read-only"):
        robot.predict(robot.initial(), {u: [1.0, 0.1]})


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


def test_what_is_laid_out_for_later_steps_does_not_serve_the_first():
    """Where there are no controls, a reading of one is refused."""
    told, command_, state = pgm.Variable("told"), pgm.Variable("command"), pgm.Variable("state")
    control = pgm.Variable("control")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(state, 0.0, 1.0)],
        [
            pgm.LinearGaussianCPD(control, {command_: 1.0}, cov=0.1),
            pgm.LinearGaussianCPD(state, {state.previous: 1.0, control: 1.0}, cov=0.1),
        ],
        [pgm.LinearGaussianCPD(told, {control: 1.0}, cov=0.1)],
    )
    robot = pgm.OnlineFilter(model)
    start = robot.initial()
    robot.update(robot.predict(start, {command_: [1.0]}), {told: [1.1]})
    with pytest.raises(pgm.EvidenceError, match="controls begin at step 1"):
        robot.update(start, {told: [1.1]})
