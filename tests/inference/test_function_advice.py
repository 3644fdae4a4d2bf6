"""A user's function that does not take arrays with leading axes is told what to write."""

import math

import numpy as np
import pytest

import pgm

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("v", "turn"))
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
m = pgm.Variable("m", components=("east", "north"))


def drive(x, u):
    heading = x[..., 2] + u[..., 1]
    step = [u[..., 0] * np.cos(heading), u[..., 0] * np.sin(heading), u[..., 1]]
    return x + np.stack(step, axis=-1)


def sight(x, m):
    away = m - x[..., :2]
    bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
    return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)


def robot(drive=drive, sight=sight):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.0, 0.0], 0.1)],
        [pgm.NonlinearGaussianCPD(x, (x.previous, u), drive, 0.01)],
        [pgm.NonlinearGaussianCPD(z, (x, m), sight, 0.01)],
    )


EVIDENCE = {u: np.full((3, 2), 0.1), z: np.full((3, 2), 0.5), m: pgm.constant([3.0, 4.0])}


def by_math(x, u):
    return drive(x, u) * math.cos(u[..., 0])


def of_rows(x, u):
    return np.array([x[0] + u[0] * np.cos(x[2]), x[1] + u[0] * np.sin(x[2]), x[2] + u[1]])


def unpacked(x, u):
    east, north, heading = x
    return np.array([east + u[0], north, heading + u[1]])


def branching(x, u):
    return drive(x, u) if u[..., 0] > 0.0 else x


def multiplied(x, u):
    return np.eye(3) @ x


def listed(x, u):
    return np.array([x[..., 0], x[..., 1], x[..., 2]])


def of_one(x):
    return x


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (by_math, "np.cos, np.hypot, ... in place of math.cos"),
        (of_rows, "a[..., i]"),
        (unpacked, "np.moveaxis(a, -1, 0)"),
        (branching, "np.where(condition, a, b) in place of if"),
        (multiplied, "a @ F.T"),
        (listed, "stack results along the last axis"),
        (of_one, "it is called as function(x[t-1], u), in the order of given, of 3 and 2"),
    ],
)
def test_mistakes(function, words):
    with pytest.raises(pgm.ModelError) as caught:
        pgm.filter(robot(function), EVIDENCE)
    assert words in str(caught.value)
    assert caught.value.variable == x


def of_numbers(x, u):
    heading = x[2] + u[1]
    east, north = x[0] + u[0] * math.cos(heading), x[1] + u[0] * math.sin(heading)
    return np.array([east, north, heading])


def cosine_first(x, u):
    east, north = x[0] + math.cos(x[2]) * u[0], x[1] + math.sin(x[2]) * u[0]
    return np.array([east, north, x[2] + u[1]])


@pytest.mark.parametrize("function", [of_numbers, cosine_first])
def test_code_for_single_numbers_is_told_all_of_its_mistakes_at_once(function):
    """Whichever fails first; and `drive`, the function written as the message says, is taken."""
    with pytest.raises(pgm.ModelError) as caught:
        pgm.filter(robot(function), EVIDENCE)
    for words in ("in place of math.cos", "a[..., i]", "np.stack([...], axis=-1)"):
        assert words in str(caught.value)
    assert np.isfinite(pgm.filter(robot(drive), EVIDENCE)[x].mean).all()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"lineariser": pgm.Unscented()},
        {"belief": pgm.Particles(20)},
    ],
    ids=["taylor", "unscented", "particles"],
)
def test_arguments_in_another_order(options):
    order = "but arguments come in the order of given, (x[t-1], u)"
    with pytest.raises(pgm.ModelError) as caught:
        pgm.filter(robot(lambda u, x: drive(x, u)), EVIDENCE, **options)
    assert "function(u, x[t-1]) does return the shape that is due" in str(caught.value)
    assert order in str(caught.value)
    if not options:
        with pytest.raises(pgm.ModelError, match=r"function\(m, x\) does return the shape"):
            pgm.smooth(robot(sight=lambda m, x: sight(x, m)), EVIDENCE)


def test_arguments_in_another_order_elsewhere():
    a, b = pgm.Variable("a", components=("one", "two")), pgm.Variable("b", tuple("pqr"))
    c, mean = pgm.Variable("c"), {"a": [0.0, 0.0], "b": [0.0, 0.0, 0.0]}
    cpd = pgm.NonlinearGaussianCPD(c, (a, b), lambda b, a: b[..., 2:] * a[..., :1], 1.0)
    network = pgm.BayesianNetwork(
        [pgm.GaussianCPD(a, mean["a"], 1.0), pgm.GaussianCPD(b, mean["b"], 1.0), cpd]
    )
    for call in (
        lambda: pgm.infer(pgm.compile(network), {c: 1.0}),
        lambda: cpd.sample({a: mean["a"], b: mean["b"]}, rng=0),
    ):
        with pytest.raises(pgm.ModelError, match=r"function\(b, a\) does return the shape"):
            call()
    filter_ = pgm.OnlineFilter(robot(lambda u, x: drive(x, u)))
    with pytest.raises(pgm.ModelError, match=r"function\(u, x\[t-1\]\) does return"):
        filter_.predict(filter_.initial(), {u: [0.1, 0.1]})


def test_what_does_not_come_from_the_order_is_not_called_that():
    def broken(x, u):
        raise KeyError("no such landmark")

    with pytest.raises(pgm.ModelError, match="no such landmark") as caught:
        pgm.filter(robot(broken), EVIDENCE)
    assert "order" not in str(caught.value)


@pytest.mark.parametrize("runs", [(), (2,), (3,)])
@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented(), pgm.Cubature()])
def test_a_vector_as_long_as_an_axis_of_a_trial_call(runs, rule):
    """x[0] of two runs is the first run, whose value has the shape that is due for two."""
    y, r = pgm.Variable("y", components=("p", "v")), pgm.Variable("r")

    def model(function):
        return pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(y, [0.0, 1.0], 1.0)],
            [pgm.NonlinearGaussianCPD(y, y.previous, function, 0.01)],
            [pgm.LinearGaussianCPD(r, {y: [[1.0, 0.0]]}, 0.25)],
        )

    evidence = {r: np.zeros((*runs, 4, 1))}
    with pytest.raises(pgm.ModelError, match=r"a\[\.\.\., i\]"):
        pgm.filter(model(lambda y: np.array([y[0] + y[1], y[1]])), evidence, lineariser=rule)


def test_a_table_of_rows_as_wide_as_an_axis_of_a_trial_call():
    """x[:, 0] of a trial call's arrays is no component, and does not pass for one."""

    def of_columns(x, u):
        return np.stack([x[:, 0] + u[:, 0], x[:, 1], x[:, 2] + u[:, 1]], axis=-1)

    with pytest.raises(pgm.ModelError, match=r"returned shape|failed"):
        pgm.filter(robot(of_columns), EVIDENCE)
