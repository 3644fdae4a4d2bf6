"""How often the functions of a model are called, and what a lineariser is called with."""

import numpy as np
import pytest
from crossed import crossed
from robots import DRIVE, LANDMARKS, P0, SENSORS, Q, controls, m, u, x

import pgm

SIGHT = SENSORS["range_bearing"]
RULES = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "cubature": pgm.Cubature(),
    "monte carlo": pgm.MonteCarlo(12),
}


class Counter:
    """A function that counts its calls and the rows it is called with."""

    def __init__(self, function):
        self.function, self.calls, self.rows = function, 0, 0

    def __call__(self, *arguments):
        self.calls += 1
        self.rows += arguments[0][..., 0].size
        return self.function(*arguments)


def counted(jacobians):
    """A model of a hidden control, with all its functions counting."""
    functions = {
        "drive": Counter(DRIVE),
        "drive by state": Counter(DRIVE.by_state),
        "drive by control": Counter(DRIVE.by_control),
        "sight": Counter(SIGHT.function),
        "sight by state": Counter(SIGHT.by_state),
        "noise": Counter(lambda c: 0.01 * np.ones((*c.shape[:-1], 1, 1)) * np.eye(2)),
    }
    command = pgm.Variable("command", components=u.components)
    by = {x.previous: functions["drive by state"], u: functions["drive by control"]}
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0, 0, 0], P0)],
        transition=[
            pgm.LinearGaussianCPD(
                u, {command: 1.0}, cov=pgm.noise(functions["noise"], given=command)
            ),
            pgm.NonlinearGaussianCPD(
                x, (x.previous, u), functions["drive"], Q, jacobian=by if jacobians else None
            ),
        ],
        observation=[
            pgm.NonlinearGaussianCPD(
                SIGHT.z,
                (x, m),
                functions["sight"],
                SIGHT.cov,
                jacobian={x: functions["sight by state"]} if jacobians else None,
            )
        ],
    )
    return model, command, functions


@pytest.fixture(autouse=True)
def no_look(monkeypatch):
    """A model's first call looks for functions that no line fits, which calls them, too."""
    monkeypatch.setattr("pgm.beliefs.moments.outcomes.doubts._MOST", 0)


def counts(kind, rule, jacobians, steps, runs, each=2):
    """Calls of every function in one inference with `each` sightings a step."""
    model, command, functions = counted(jacobians)
    rng = np.random.default_rng(1)
    step = np.repeat(np.arange(1, steps + 1), each)
    values = np.array([9.0, 1.0]) + 0.1 * rng.normal(size=(runs, step.size, 2))
    evidence = {
        command: controls(rng, steps),
        SIGHT.z: pgm.sightings(values, step=step, given={m: np.tile(LANDMARKS[0], (step.size, 1))}),
    }
    if kind == "filter":
        pgm.filter(model, evidence, lineariser=RULES[rule])
    else:
        iterations = int(kind)
        posterior = pgm.smooth(
            model, evidence, lineariser=RULES[rule], iterations=iterations, tolerance=0.0
        )
        assert posterior.status.iterations == iterations
    return {name: function.calls for name, function in functions.items()}


@pytest.mark.parametrize("jacobians", [True, False])
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("kind", ["filter", "1", "3"])
def test_one_run_and_a_hundred_take_equally_many_calls(kind, rule, jacobians):
    """Traces, too, since up to 4,096 points are judged in one call."""
    one = counts(kind, rule, jacobians, steps=4, runs=1)
    assert one == counts(kind, rule, jacobians, steps=4, runs=100)
    assert one["drive"] > 0
    assert one["noise"] == 1


@crossed(("rule", "jacobians"), list(RULES), [True, False])
def test_a_relinearisation_takes_equally_many_calls_for_any_number_of_steps(rule, jacobians):
    def added(steps):
        first, second = (counts(k, rule, jacobians, steps, runs=1) for k in ("2", "4"))
        return {name: second[name] - first[name] for name in first}

    few = added(3)
    assert few == added(20)
    traced = rule == "taylor" and not jacobians  # and called in the first pass alone
    assert 2 * (not traced) <= few["drive"] + few["drive by state"] <= 4
    assert few["drive"] <= 4
    assert few["sight"] <= 4


@pytest.mark.parametrize("rule", RULES)
def test_sightings_of_a_step_are_one_call(rule):
    assert counts("filter", rule, True, 4, 1, each=1) == counts("filter", rule, True, 4, 1, each=7)


def test_a_filter_calls_each_function_once_a_step_and_once_to_probe():
    found = counts("filter", "unscented", True, steps=50, runs=10)
    assert found["drive"] == found["sight"] == 51
    found = counts("filter", "taylor", True, steps=50, runs=10)
    assert found["drive"] == found["sight"] == found["sight by state"] == 51


def test_online_calls_do_not_grow_with_runs():
    found = []
    for runs in ((), (1000,)):
        model, command, functions = counted(True)
        robot = pgm.OnlineFilter(model)
        belief = robot.initial()
        for step in range(4):
            if step == 1:  # the first lays out what is to be done
                for function in functions.values():
                    function.calls = 0
            belief = robot.predict(belief, {command: np.broadcast_to([1.0, 0.1], (*runs, 2))})
            values = np.broadcast_to([9.0, 1.0], (*runs, 1, 2))
            belief = robot.update(
                belief, {SIGHT.z: pgm.sightings(values, given={m: LANDMARKS[:1]})}
            )
        found.append({name: function.calls for name, function in functions.items()})
    assert found[0] == found[1]
    assert set(found[0].values()) == {3}


def test_a_jacobian_by_a_parent_with_evidence_is_not_called():
    def refuse(*arguments):
        raise AssertionError("the derivative by an observed parent is of no use")

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0, 0, 0], P0)],
        transition=[
            pgm.NonlinearGaussianCPD(
                x, (x.previous, u), DRIVE, Q, jacobian={x.previous: DRIVE.by_state, u: refuse}
            )
        ],
        observation=[
            pgm.NonlinearGaussianCPD(
                SIGHT.z,
                (x, m),
                SIGHT.function,
                SIGHT.cov,
                jacobian={x: SIGHT.by_state, m: refuse},
            )
        ],
    )
    evidence = {
        u: pgm.constant([1.0, 0.1]),
        m: pgm.constant(LANDMARKS[0]),
        SIGHT.z: np.tile([9.0, 1.0], (3, 1)),
    }
    assert pgm.smooth(model, evidence, iterations=2, tolerance=0)[x].mean.shape == (4, 3)


class Watching:
    """Taylor, noting what it is given."""

    def __init__(self):
        self.seen = []

    def __call__(self, function, at):
        affine = pgm.Taylor()(function, at)
        self.seen.append((function.name, function.step, at.scope, at.mean.shape))
        # Any number of axes may follow the leading ones, as those of sigma points do.
        lead, n = at.mean.shape[:-1], at.mean.shape[-1]
        points = np.broadcast_to(at.mean[..., None, None, :], (*lead, 2, 5, n))
        value = function(points)
        assert value.shape == (*lead, 2, 5, len(function.angles))
        np.testing.assert_allclose(value[..., 1, 3, :], function(at.mean), atol=1e-12)
        assert function.jacobian(at.mean).shape == (*lead, len(function.angles), n)
        assert len(function.input_angles) == n
        assert (np.abs(function.residual(value, value + 6 * np.pi)[..., function.angles]) < 4).all()
        return affine


def test_what_a_lineariser_is_given():
    """A call for each step in the filter, one for all steps afterwards; hidden parents stacked."""
    model, command, _ = counted(True)
    steps = 3
    evidence = {
        command: np.tile([1.0, 0.1], (steps, 1)),
        SIGHT.z: pgm.sightings(
            np.tile([9.0, 1.0], (4, 1)), step=[2, 0, 2, 3], given={m: np.tile(LANDMARKS[0], (4, 1))}
        ),
    }
    watching = Watching()
    posterior = pgm.smooth(model, evidence, lineariser=watching, iterations=2, tolerance=0.0)
    plain = pgm.smooth(model, evidence, iterations=2, tolerance=0.0)
    np.testing.assert_allclose(posterior[x].mean, plain[x].mean, rtol=0, atol=1e-12)
    motion = [row for row in watching.seen if row[0] == "x"]
    sensor = [row for row in watching.seen if row[0] == "z"]
    assert [row[1] for row in motion[:3]] == [1, 2, 3]
    assert [row[1] for row in sensor[:3]] == [0, 2, 3]
    assert all(row[2] == (x.previous, u) for row in motion)
    assert all(row[2] == (x,) for row in sensor)
    assert len(motion) == len(sensor) == 4
    assert motion[3][1].ravel().tolist() == [1, 2, 3]
    assert sensor[3][1].ravel().tolist() == [0, 2, 2, 3]
    assert motion[3][1].shape == motion[3][3][:-1]


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()])
def test_a_function_cannot_write_into_the_evidence(rule):
    def greedy(x, u):
        u[..., 0] = 7.0
        return x

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0, 0, 0], P0)],
        transition=[pgm.NonlinearGaussianCPD(x, (x.previous, u), greedy, Q)],
    )
    given = np.ones((3, u.dimension))
    with pytest.raises((pgm.ModelError, ValueError), match="read-only"):
        pgm.smooth(model, {u: given}, lineariser=rule)
    np.testing.assert_array_equal(given, 1.0)
