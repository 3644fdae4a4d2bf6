"""Functions and linearisers of users that fail once inference is under way.

Each error names the CPD, the step and the run, and keeps the user's own as its cause.
"""

import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import pgm

u, v, x, z = pgm.variables("u v x z")
BAD, STEP, RUN, T, MANY = 99.0, 4, 33, 6, 40
RULES = {"taylor": pgm.Taylor(), "unscented": pgm.Unscented(), "monte carlo": pgm.MonteCarlo(30)}


class Boom(RuntimeError):
    """The user's own error."""


def failing(u):
    return bool((np.asarray(u) == BAD).any())


def raising(value):
    def function(x, u):
        if failing(u):
            raise Boom("no such place")
        return value(x, u)

    return function


def returning(odd):
    def function(x, u):
        return odd(x) if failing(u) else x + 0.0 * u

    return function


def losing(value):
    def function(x, u):
        return np.where(u == BAD, np.nan, value(x, u))

    return function


def move(x, u):
    return x + 0.0 * u


def slope(x, u):
    return np.ones((*x.shape, 1)) + 0.0 * u[..., None]


def model(function=move, jacobian=None, cov=0.1, lineariser=None):
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[
            pgm.NonlinearGaussianCPD(
                x,
                (x.previous, u),
                function,
                cov,
                jacobian={x.previous: jacobian} if jacobian else None,
                lineariser=lineariser,
            )
        ],
        observation=[pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.5)],
    )


def sensing(function=move, jacobian=None, cov=0.1, lineariser=None):
    """The same functions in a sensor, two sightings of which fall on each step."""
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: 1.0, v: 1.0}, cov=0.1)],
        observation=[
            pgm.NonlinearGaussianCPD(
                z,
                (x, u),
                function,
                cov,
                jacobian={x: jacobian} if jacobian else None,
                lineariser=lineariser,
            )
        ],
    )


def evidence(runs):
    inputs = np.zeros((runs, T, 1)) if runs else np.zeros((T, 1))
    inputs[(min(RUN, runs - 1), STEP - 1) if runs else STEP - 1] = BAD
    return {u: inputs, z: np.zeros((T, 1))}


def sighted(runs):
    given = evidence(runs)[u].repeat(2, axis=-2)
    seen = pgm.sightings(np.zeros((2 * T, 1)), np.arange(1, T + 1).repeat(2), given={u: given})
    return {v: np.zeros((T, 1)), z: seen}


def noise(u):
    if failing(u):
        raise Boom("no such place")
    return 0.1 * np.ones((*u.shape, 1))


def online(model, evidence):
    robot = pgm.OnlineFilter(model)
    belief = robot.initial()
    for row in range(T):
        belief = robot.predict(belief, {u: evidence[u][..., row, :]})


def balanced(model, evidence):
    graph = pgm.compile(model, steps=T, method=pgm.Balanced())
    pgm.infer(graph, evidence, schedule=pgm.Smoothing(iterations=3))


def in_parts(model, evidence):
    pgm.filter(model, evidence, keep=[x], executor=ThreadPoolExecutor(3))


def controlled(model, evidence):
    pgm.smooth(model, evidence, iterations=4, damping=pgm.LevenbergMarquardt())


def iterated(model, evidence):
    pgm.filter(model, evidence, iterations=3)


def unrolled(model, evidence):
    known = {u.at(t + 1): evidence[u][..., t, :] for t in range(T)}
    pgm.infer(pgm.compile(model.replace(observation=[]).unroll(T)), known)


def sampled(model, evidence):
    runs = evidence[u].shape[:-2]
    model.sample({u: evidence[u]}, runs=runs, rng=0)


def sampled_unrolled(model, evidence):
    known = {u.at(t + 1): evidence[u][..., t, :] for t in range(T)}
    model.unroll(T).sample(inputs=known, rng=0)


WAYS = [
    pgm.filter, pgm.smooth, iterated, controlled, balanced, in_parts, online, unrolled, sampled,
    sampled_unrolled,
]  # fmt: skip


def refused(way, network, given, cause=Boom, kind=pgm.ModelError):
    """The words of the error, the run of which is that of the words."""
    with pytest.raises(kind) as caught:
        way(network, given)
    error = caught.value
    if cause is not None:
        assert isinstance(error.__cause__, cause)
    assert error.step == STEP
    assert error.cpd.child.name == error.variable.name
    assert f"step {STEP}" in str(error)
    told = re.search(r", run (\d+)", str(error))
    assert error.run == (int(told[1]) if told else None)
    return str(error)


@pytest.mark.parametrize("runs", [0, 1, MANY])
@pytest.mark.parametrize("way", WAYS)
def test_a_function_that_raises(way, runs):
    said = refused(way, model(raising(move)), evidence(runs))
    run = min(RUN, max(runs - 1, 0))
    assert f"the function of the CPD of x at step 4, run {run}, failed: Boom: no such pl" in said


@pytest.mark.parametrize("runs", [0, MANY])
@pytest.mark.parametrize("way", [pgm.filter, controlled])
@pytest.mark.parametrize("rule", RULES)
def test_a_sensor_that_raises(way, runs, rule):
    network = sensing(raising(move), lineariser=RULES[rule])
    said = refused(way, network, sighted(runs))
    run = RUN if runs else 0
    assert f"the function of the CPD of z at step 4, run {run}, failed: Boom: no such pl" in said


@pytest.mark.parametrize("runs", [0, MANY])
@pytest.mark.parametrize("way", WAYS[:7])
def test_a_jacobian_that_raises(way, runs):
    said = refused(way, model(move, raising(slope)), evidence(runs))
    by = "x[t-1]"
    assert f"the jacobian by {by} of the CPD of x at step 4, run {RUN if runs else 0}, fail" in said


@pytest.mark.parametrize("runs", [0, MANY])
@pytest.mark.parametrize("way", WAYS)
def test_a_noise_that_raises(way, runs):
    said = refused(way, model(cov=pgm.noise(noise, given=u)), evidence(runs))
    assert f"the noise of the CPD of x at step 4, run {RUN if runs else 0}, failed: Boom" in said


ODD = {
    "a shape": (lambda x: np.zeros((*x.shape, 2)), r"returned shape \(.*2\) where"),
    "complex": (lambda x: x + 1j, r"must return numbers, not complex ones; take \.real"),
    "words": (lambda x: "east", r"must return numbers, not texts \(str\)"),
    "rags": (lambda x: [[1.0], [1.0, 2.0]], "must return numbers, not rows of unequal length"),
    "nothing": (lambda x: None, "must return numbers, not NoneType"),
}


@pytest.mark.parametrize("runs", [0, MANY])
@pytest.mark.parametrize("way", [pgm.filter, iterated, in_parts, online, unrolled, sampled])
@pytest.mark.parametrize("odd", ODD)
def test_a_function_that_returns_something_odd(way, runs, odd):
    function, told = ODD[odd]
    run = None if odd == "a shape" else RUN if runs else 0  # a shape is that of all rows at once
    which = "" if run is None else f", run {run},"
    words = f"^the function of the CPD of x at step 4{which} {told}"
    with pytest.raises(pgm.ModelError, match=words) as e:
        way(model(returning(function)), evidence(runs))
    assert (e.value.step, e.value.run) == (STEP, run)
    assert e.value.cpd.child.name == "x"


@pytest.mark.parametrize("runs", [0, MANY])
@pytest.mark.parametrize("way", WAYS)
def test_a_function_that_is_not_finite(way, runs):
    said = refused(way, model(losing(move)), evidence(runs), None, pgm.LinearisationError)
    assert f"run {RUN if runs else 0}, has" in said


class Bare:
    """A lineariser of the user's that fails at a step."""

    def __init__(self, what):
        self.what = what

    def __call__(self, function, at):
        if np.any(np.asarray(function.step) == STEP):
            return self.what(function, at)
        return pgm.Taylor()(function, at)

    def __repr__(self):
        return "Bare()"


def boom(function, at):
    raise Boom("no line")


@pytest.mark.parametrize("runs", [0, MANY])
@pytest.mark.parametrize("way", [pgm.filter, pgm.smooth, in_parts, online, unrolled])
def test_a_lineariser_that_raises(way, runs):
    quiet = {u: np.zeros((*evidence(runs)[u].shape[:-2], T, 1))}
    said = refused(way, model(lineariser=Bare(boom)), quiet)
    assert "the lineariser Bare() failed for NonlinearGaussianCPD(x" in said
    assert said.endswith("Boom: no line")
    assert (f"in a call for runs 0 to {MANY - 1}" if runs else "run") in said


@pytest.mark.parametrize(
    ("what", "told"),
    [
        (lambda function, at: None, "returned NoneType for .* at step 4, run 0; it must return a"),
        (
            lambda function, at: pgm.AffineGaussian(np.eye(2), [0, 0], np.eye(2)),
            "an F of shape .* at step 4, run 0; it must end in",
        ),
    ],
)
def test_a_lineariser_that_returns_something_odd(what, told):
    with pytest.raises(pgm.LinearisationError, match=told) as caught:
        pgm.filter(model(lineariser=Bare(what)), {u: np.zeros((T, 1))})
    assert caught.value.step == STEP
    assert caught.value.cpd.child == x


def test_an_error_of_this_library_within_a_lineariser_is_the_user_s_too():
    def indefinite(function, at):
        return pgm.Gaussian(at.scope, at.mean, -at.cov)

    with pytest.raises(pgm.ModelError, match=r"failed for .* at step 4, run 0: ModelError") as e:
        pgm.filter(model(lineariser=Bare(indefinite)), {u: np.zeros((T, 1))})
    assert "negative" in str(e.value.__cause__)
    assert (e.value.step, e.value.run, e.value.variable) == (STEP, 0, x)


@pytest.mark.parametrize("runs", [0, 3])
@pytest.mark.parametrize("make", [model, sensing])
def test_a_function_that_fails_at_the_draws_of_an_audit(runs, make):
    armed = []

    def function(x, u):
        if armed and (x > 1.5).any():
            raise Boom("too far")
        return move(x, u)

    means = np.zeros((runs, T, 1)) if runs else np.zeros((T, 1))
    given = {u: means, z: np.ones((T, 1))}
    posterior = pgm.filter(make(function), given | ({v: means} if make is sensing else {}))
    armed.append(True)
    with pytest.raises(
        pgm.ModelError, match=r"at step \d, run \d, failed: Boom: too far"
    ) as caught:
        pgm.audit(posterior, samples=20_000, rng=0)
    assert isinstance(caught.value.__cause__, Boom)
    assert caught.value.cpd is not None


def test_a_trial_call_is_of_no_step_or_run():
    def function(x, u):
        raise Boom("never")

    with pytest.raises(pgm.ModelError, match=r"failed on a trial call .*\(2, 3\): Boom") as caught:
        pgm.filter(model(function), evidence(0))
    assert isinstance(caught.value.__cause__, Boom)
    assert caught.value.step is None
    assert caught.value.cpd.child == x


def test_a_failure_that_no_row_shows_alone():
    """Nothing is said of a run where none is to blame."""

    def function(x, u):
        if x.shape[0] == MANY:
            raise Boom("too many")
        return move(x, u)

    with pytest.raises(pgm.ModelError, match=r"x at step 1 failed: Boom: too many") as caught:
        pgm.filter(model(function), {u: np.zeros((MANY, T, 1))}, lineariser=pgm.Unscented())
    assert caught.value.step == 1


def test_only_errors_are_caught():
    def function(x, u):
        if failing(u):
            raise KeyboardInterrupt
        return move(x, u)

    for runs in (0, MANY):
        with pytest.raises(KeyboardInterrupt):
            pgm.filter(model(function), evidence(runs))
