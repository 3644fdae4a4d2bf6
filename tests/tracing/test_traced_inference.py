"""Inference with traced derivatives: as with those given, and as without where there is none."""

from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from models import motion, sensors
from pgm.kernels import differences
from pgm.linearisers import BoundFunction, FunctionTemplate

X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
U = pgm.Variable("u", components=("v", "omega", "dt"))
M = pgm.Variable("m", components=("east", "north"))
Z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
Y = pgm.Variable("y", ("a", "b"))
MACHINE = pytest.mark.skipif(
    find_spec("llvmlite") is None, reason="sweeps are compiled by llvmlite"
)
MARKS = np.array([[7.0, 1.0], [-6.0, 8.0], [4.0, 12.0]])


def robot(*, given=(), grouped=False, move=motion.velocity, sight=sensors.range_bearing):
    """A robot that sees landmarks, with the Jacobians of some functions."""
    by_state = {X.previous: motion.velocity_by_state} if "motion" in given else None
    by_sight = {X: sensors.range_bearing_by_state} if "sensor" in given else None
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, [0.0, 0.0, 0.3], [0.01, 0.01, 0.0025])],
        [pgm.NonlinearGaussianCPD(X, (X.previous, U), move, 0.01, jacobian=by_state)],
        [pgm.NonlinearGaussianCPD(Z, (X, M), sight, 0.02, jacobian=by_sight, grouped=grouped)],
    )


def recorded(runs=()):
    """Evidence of 12 steps, straight ahead at first, with two sightings at some of them."""
    controls = np.zeros((12, 3))
    controls[:, 0], controls[6:, 1], controls[:, 2] = 1.0, 0.4, 0.5
    step = np.sort(np.r_[1:13, 3:6])
    seen = pgm.sightings(step=step, given={M: MARKS[step % 3]})
    drawn = robot().sample({U: np.broadcast_to(controls, (*runs, 12, 3)), Z: seen}, rng=4)
    return drawn.evidence


@pytest.mark.parametrize("runs", [(), (40,)])
@pytest.mark.parametrize("grouped", [False, True])
@pytest.mark.parametrize(
    "schedule", [pgm.Filtering(), pgm.Smoothing(iterations=3, tolerance=0), pgm.FixedLag(2)]
)
def test_traced_derivatives_do_what_given_ones_do(runs, grouped, schedule):
    evidence = recorded(runs)
    due, found = (
        pgm.infer(pgm.compile(robot(given=given, grouped=grouped), 12), evidence, schedule=schedule)
        for given in (("motion", "sensor"), ())
    )
    assert_allclose(found[X].mean, due[X].mean, rtol=0, atol=1e-10)
    assert_allclose(found[X].cov, due[X].cov, rtol=0, atol=1e-11)
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-10)


def test_some_given_and_some_traced():
    """A Jacobian by one parent is the user's, by the other the trace's."""
    parts = pgm.Variable("p")
    given = lambda p, x: np.full((*p.shape[:-1], 2, 1), 7.0)  # noqa: E731
    cpd = pgm.NonlinearGaussianCPD(
        Y, (parts, X), lambda p, x: p * x[..., :2] ** 2, 1.0, jacobian={parts: given}
    )
    assert dict(cpd.derivatives) == {parts: "given", X: "traced"}
    template = cpd._template((parts, X))
    assert (template.missing, template.numerical) == ((1, 2, 3), ())
    x = np.array([[2.0, 1.0, -3.0, 0.5], [1.0, 0.0, 2.0, 0.5]])
    bound = BoundFunction(template, [None, None], lead=1)
    value, slope = bound.tangent(x)
    assert value.tolist() == [[2.0, 18.0], [0.0, 4.0]]
    assert slope[0].tolist() == [[7.0, 4.0, 0.0, 0.0], [7.0, 0.0, -12.0, 0.0]]
    assert_allclose(bound.jacobian(x), slope, rtol=0, atol=0)


def test_where_there_is_no_derivative_it_is_taken_by_differences():
    """At the landmark itself, as before; elsewhere in the same call the trace's."""
    cpd = pgm.NonlinearGaussianCPD(Z, (X, M), sensors.range_bearing, 1.0)
    template, x = cpd._template((X,)), np.array([[3.0, 4.0, 0.1], [1.0, 2.0, 0.1]])
    assert dict(cpd.derivatives) == {X: "traced", M: "traced"}
    bound = BoundFunction(template, [None, np.full((2, 2), [1.0, 2.0])], lead=1)
    zeros = np.zeros_like(x)
    numerical = differences.jacobian(bound.__call__, x, zeros, Z.angle_mask)
    slope = bound.tangent(x)[1]
    assert_allclose(slope[1, :, :2], numerical[1, :, :2], rtol=0, atol=0)
    exact = sensors.range_bearing_by_state(x[:1], np.array([[1.0, 2.0]]))
    assert_allclose(slope[:1], exact, rtol=1e-14, atol=1e-14)
    # One run alone goes another way.
    one = BoundFunction(template, [None, np.array([1.0, 2.0])], lead=0)
    assert_allclose(one.tangent(x[1])[1], slope[1], rtol=0, atol=0)


@pytest.mark.parametrize("lead", [0, 1])
def test_the_branch_not_taken_does_no_harm(lead):
    """Division by a turn rate of zero, logarithm and root of what is not positive."""

    def arcs(x):
        omega, straight = x[..., 2], np.abs(x[..., 2]) < 1e-9
        with np.errstate(all="ignore"):
            curved = np.sin(omega) / omega
            root = np.where(x[..., 0] > 0.0, np.sqrt(x[..., 0]) * np.log(x[..., 0]), x[..., 0])
        return np.stack([np.where(straight, 1.0, curved) * x[..., 1], root], axis=-1)

    cpd = pgm.NonlinearGaussianCPD(Y, X, arcs, 1.0)
    assert dict(cpd.derivatives) == {X: "traced"}
    x = np.array([-1.0, 2.0, 0.0])
    bound = BoundFunction(cpd._template((X,)), [None], lead=lead)
    _, slope = bound.tangent(np.stack([x, x]) if lead else x)
    due = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    assert slope.tolist() == ([due, due] if lead else due)


@pytest.mark.parametrize(
    ("function", "at", "due"),
    [
        (np.abs, 0.0, 0.0),
        (lambda x: np.maximum(x, 0.0), 0.0, 0.5),
        (lambda x: np.minimum(x, 2.0 * x), 0.0, 1.5),
        (lambda x: np.clip(x, -1.0, 1.0), 2.0, 0.0),
        (np.sign, 0.3, 0.0),
        (lambda x: np.floor(x) + x % 2.0, 0.3, 1.0),
        (lambda x: np.copysign(x, -1.0), 2.0, -1.0),
        (lambda x: np.mod(5.0, x), 2.0, -2.0),
        (lambda x: 0.0 ** (x * x), 2.0, 0.0),
        (lambda x: np.heaviside(x, 0.5), 1.0, 0.0),
    ],
)
def test_kinks_and_steps(function, at, due):
    """A kink's derivative is the mean of both sides, as central differences have it."""
    s, t = pgm.variables("s t")
    cpd = pgm.NonlinearGaussianCPD(t, s, function, 1.0)
    assert dict(cpd.derivatives) == {s: "traced"}
    bound = BoundFunction(cpd._template((s,)), [None], lead=0)
    assert bound.tangent(np.array([at]))[1].tolist() == [[due]]
    numerical = differences.jacobian(bound.__call__, np.array([at]), np.zeros(1), t.angle_mask)
    assert_allclose(numerical, [[due]], atol=1e-7)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
def test_online_a_filter_that_is_renewed_reads_its_functions_anew(compiled):
    dt = 0.5

    def move(x, u):
        return motion.Velocity(dt)(x, u[..., :2])

    found, due = pgm.OnlineFilter(robot(move=move), compiled=compiled), pgm.OnlineFilter(robot())
    belief, known = found.initial(), due.initial()
    for dt in (0.5,) * 8 + (2.0, 0.1, 0.5):
        found = found.renewed()
        belief = found.predict(belief, {U: np.array([1.0, 0.3, 0.0])})
        known = due.predict(known, {U: [1.0, 0.3, dt]})
        assert_allclose(belief[X].mean, known[X].mean, rtol=1e-12)
        assert_allclose(belief[X].cov, known[X].cov, rtol=1e-7, atol=1e-12)


def test_online_without_machine_code_values_are_always_the_functions_own():
    dt = 0.5
    model = robot(move=lambda x, u: motion.Velocity(dt)(x, u[..., :2]))
    found = pgm.OnlineFilter(model)
    belief = found.initial()
    for dt in (0.5, 2.0, 0.1):
        due = motion.Velocity(dt)(belief[X].mean, np.array([1.0, 0.3]))
        belief = found.predict(belief, {U: [1.0, 0.3, 0.0]})
        assert_allclose(belief[X].mean, due, rtol=1e-12)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
def test_online_a_renewed_filter_sees_a_slope_that_changed_where_the_value_did_not(compiled):
    (s,) = pgm.variables("s")
    gain = 1.0
    move = pgm.NonlinearGaussianCPD(s, s.previous, lambda s: gain * np.sin(s), 0.1)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(s, 0.0, 1.0)], [move], [])
    robot = pgm.OnlineFilter(model, compiled=compiled)
    for gain in (1.0, 3.0, 3.0, 1.0):
        robot = robot.renewed()
        belief = robot.predict(robot.initial())
        assert_allclose(belief[s].cov, [[gain**2 + 0.1]], rtol=1e-7)


@MACHINE
def test_compiled_steps_are_looked_at_until_they_are_trusted():
    """A change within the first steps ends machine code, which is beside the general steps then."""
    shift = np.zeros(2)
    model = robot(sight=lambda x, m: sensors.range_bearing(x, m) + shift)
    found, due = pgm.OnlineFilter(model, compiled=True), pgm.OnlineFilter(model)
    belief, known = found.initial(), due.initial()
    seen = {Z: pgm.sightings(np.array([[6.0, 0.1]]), given={M: MARKS[:1]})}
    for by in (0.0, 0.0, 0.3, 0.3, 0.0, 0.1, 0.2, 0.3, 0.4):
        shift[0] = by
        inputs = {U: np.array([1.0, 0.3, 0.5])}
        belief = found.update(found.predict(belief, inputs), seen)
        known = due.update(due.predict(known, inputs), seen)
        assert_allclose(belief[X].mean, known[X].mean, rtol=1e-9)


def test_a_compiled_graph_follows_a_closure():
    dt = None
    graph = pgm.compile(robot(move=lambda x, u: motion.Velocity(dt)(x, u[..., :2])), 12)
    evidence = recorded()
    means = []
    for dt in (0.5, 0.1, 0.5):  # noqa: B007
        means.append(pgm.infer(graph, evidence, schedule=pgm.Filtering())[X].mean)
    assert_allclose(means[0], pgm.filter(robot(), evidence)[X].mean, atol=1e-12)
    assert_allclose(means[0], means[2], atol=0)
    assert np.abs(means[0] - means[1]).max() > 0.1


def test_without_a_trace_it_goes_as_before():
    def branching(x, m):
        return sensors.range_bearing(x, m) if x.ndim >= 0 and (x > -1e9).all() else None

    model, evidence = robot(sight=branching), recorded((3,))
    assert model.observation[0].derivatives[X] == "numerical"
    found, due = pgm.filter(model, evidence), pgm.filter(robot(), evidence)
    assert_allclose(found[X].mean, due[X].mean, atol=1e-7)


def test_warnings_are_those_of_the_function():
    """Of what is not finite the function itself is asked, whose warnings and errors are due."""
    s, t = pgm.variables("s t")
    template = FunctionTemplate(t, (s,), (s,), np.log, (None,), (1.0,))
    traced = pgm.NonlinearGaussianCPD(t, s, np.log, 1.0)
    assert dict(traced.derivatives) == {s: "traced"}
    for each in (template, traced._template((s,))):
        bound = BoundFunction(each, [None], lead=0)
        with pytest.raises(
            pgm.ModelError, match=r"function .* failed: RuntimeWarning: divide by zero"
        ):
            bound.tangent(np.array([0.0]))


def test_derivatives_show_why():
    def looks_up(x, m):
        return sensors.range_bearing(x, m) * np.interp(x[..., :1], [0.0, 1.0], [1.0, 1.0])

    cpd = robot(sight=looks_up, given=("sensor",)).observation[0]
    found = cpd.derivatives
    assert dict(found) == {X: "given", M: "numerical"}
    assert "Cannot cast" in found.reason
    shown = str(found)
    assert "x  given" in shown
    assert "no trace: it fails on traced numbers" in shown
    with pytest.raises(pgm.ModelError, match="its function has no trace: it fails") as caught:
        cpd.source()
    assert caught.value.cpd is cpd
    given = robot(given=("motion", "sensor")).transition[0].derivatives
    assert given.reason is None
    assert len(given) == 2


def test_source_is_what_is_run():
    source = robot().observation[0].source()
    assert source.startswith("def batch(a0, a1, value, slope):")
    assert source.count("arctan2") == 1
    assert source.count("slope[1, 2, ...]") == 1


@pytest.mark.parametrize("steps", [3, None])
def test_right_jacobians_pass(steps):
    model = robot(given=("motion", "sensor"))
    if steps:
        pgm.compile(model, steps).check(jacobians=True)
    else:
        cpds = [cpd.at(1) for cpd in model.transition]
        prior = [pgm.GaussianCPD(v, np.zeros(3), 1.0) for v in (X.at(0), U.at(1))]
        pgm.compile(pgm.BayesianNetwork([*prior, *cpds])).check(jacobians=True)


@pytest.mark.parametrize("traced", [True, False])
@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize("column", [0, 1, 2])
def test_a_wrong_entry_is_named(row, column, traced):
    def wrong(x, m):
        found = sensors.range_bearing_by_state(x, m)
        found[..., row, column] = 0.9 * found[..., row, column] + 1e-3
        return found

    def sight(x, m):
        if not traced and (x > 1e9).any():
            raise AssertionError
        return sensors.range_bearing(x, m)

    cpd = pgm.NonlinearGaussianCPD(
        Z, (M, X), lambda m, x: sight(x, m), 1.0, jacobian={X: lambda m, x: wrong(x, m)}
    )
    graph = pgm.compile(robot().replace(observation=[cpd]), 3)
    graph.check()
    of = "the function's trace" if traced else "differences of the function"
    names = ["range", "bearing"][row], ["east", "north", "heading"][column]
    message = (
        rf"\(z \| m, x\): the Jacobian by x is wrong in row {row} \({names[0]}.*\), column "
        rf"{column} \({names[1]}.*\): it gives [-+.\de]+, {of} [-+.\de]+, at "
        r"m = \[.*\], x = \[.*\]; mend"
    )
    with pytest.raises(pgm.ModelError, match=message) as caught:
        graph.check(jacobians=True)
    assert caught.value.cpd is cpd
    assert caught.value.variable == X


def test_a_jacobian_of_a_wrong_shape_or_that_fails_is_refused_as_elsewhere():
    for bad, message in (
        (lambda x, m: x, "returned shape"),
        (lambda x, m: 1 / 0, "failed on a trial"),
    ):
        cpd = pgm.NonlinearGaussianCPD(Z, (X, M), sensors.range_bearing, 1.0, jacobian={X: bad})
        graph = pgm.compile(robot().replace(observation=[cpd]), 3)
        with pytest.raises(pgm.ModelError, match=f"jacobian by x of the CPD of z {message}"):
            graph.check(jacobians=True)


LIMIT, HELD = 5.0, {"limit": 5.0}


def up_to_a_global(x):
    return np.where(x < LIMIT, x, 0.5 * x) + 1.0


def up_to_a_value(x):
    return np.where(x < HELD["limit"], x, 0.5 * x) + 1.0


@pytest.mark.parametrize("move", [up_to_a_global, up_to_a_value])
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
def test_a_change_that_no_drawn_point_shows_counts(move, compiled, monkeypatch):
    x, z = pgm.variables("x z")

    def means(compiled, jacobian=None):
        motion = pgm.NonlinearGaussianCPD(x, x.previous, move, 0.1, jacobian=jacobian)
        sensor = pgm.LinearGaussianCPD(z, given={x: 1.0}, cov=0.5)
        model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(x, 0.0, 1.0)], [motion], [sensor])
        graph = pgm.compile(model, 30, compiled=compiled)
        return lambda: pgm.infer(graph, {z: 0.7 * np.arange(1.0, 31.0)[:, None]})[x].mean

    found = means(compiled)
    before = found()
    monkeypatch.setitem(globals(), "LIMIT", 7.0)
    monkeypatch.setitem(HELD, "limit", 7.0)
    by_state = {x.previous: lambda x: np.where(x < 7.0, 1.0, 0.5)[..., None]}
    due = means(False, by_state)()
    assert_allclose(found(), due, atol=1e-9)
    assert np.abs(before - due).max() > 1.0
