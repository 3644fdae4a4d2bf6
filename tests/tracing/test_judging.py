"""Traces that decide by numbers that tracing cannot follow, and slopes whose formula cancels."""

from functools import partial
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.tracing import Answers, Tracer

MACHINE = pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed")
S, U, Y = pgm.variables("s u y")


def by_asarray(s, u):
    gear = np.asarray(u, dtype=float)
    return np.where(gear == 2, 2.0 * s, 0.5 * s)


def by_array(s, u):
    return np.where(np.array(u, float) > 1.5, 2.0 * s, 0.5 * s)


def by_buffer(s, u):
    held = np.zeros(u.shape)
    held[...] = u
    return np.where(held == 2, 2.0 * s, 0.5 * s)


def by_empty(s, u):
    held = np.empty((*u.shape[:-1], 2))
    held[..., 0], held[..., 1] = u[..., 0], 0.5
    return np.where(held[..., :1] == 2, 2.0 * s, held[..., 1:] * s)


def by_astype(s, u):
    return np.where(u.astype(float) == 2, 2.0 * s, 0.5 * s)


def by_table(s, u):
    return np.array([0.5, 0.5, 2.0])[np.asarray(u, dtype=float).clip(0, 2).astype(int)] * s


FROZEN = [by_asarray, by_array, by_buffer, by_empty, by_astype, by_table]
GEARS = np.array([[0.0], [0], [2], [2], [2]])


@pytest.mark.parametrize("function", FROZEN)
@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()])
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
@pytest.mark.parametrize("runs", [(), (3,), (12,)])
def test_a_comparison_on_a_float_copy_is_not_frozen(function, rule, compiled, runs):
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(S, 1.0, 1.0)],
        [pgm.NonlinearGaussianCPD(S, (S.previous, U), function, cov=1e-3)],
        [],
    )
    gears = np.broadcast_to(GEARS, (*runs, 5, 1))
    found = pgm.filter(model, {U: gears}, lineariser=rule, compiled=compiled)[S]
    variance = 1.0
    for gain in (0.5, 0.5, 2.0, 2.0, 2.0):
        variance = gain**2 * variance + 1e-3
    assert_allclose(found.mean[..., -1, 0], np.full(runs, 2.0), rtol=1e-9)
    assert_allclose(found.cov[..., -1, 0, 0], np.full(runs, variance), rtol=1e-7)


def test_online_a_comparison_on_a_float_copy_is_not_frozen():
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(S, 1.0, 1.0)],
        [pgm.NonlinearGaussianCPD(S, (S.previous, U), by_asarray, cov=1e-3)],
        [],
    )
    for compiled in (False, True) if find_spec("llvmlite") else (False,):
        robot = pgm.OnlineFilter(model, compiled=compiled)
        belief, due = robot.initial(), 1.0
        for gear in [0.0] * 12 + [2.0] * 9:
            belief, due = robot.predict(belief, {U: np.array([gear])}), due * (2 if gear else 0.5)
            assert_allclose(belief[S].mean, [due], rtol=1e-9)


def turn(x, v=10.0, dt=1.0, straight=1e-9):
    """A move along an arc, straight where the turn rate is nearly zero."""
    e, n, h, w = (x[..., k] for k in range(4))
    small = np.abs(w) < straight
    s = np.where(small, 1.0, w)
    de = np.where(small, v * dt * np.cos(h), v / s * (np.sin(h + w * dt) - np.sin(h)))
    dn = np.where(small, v * dt * np.sin(h), v / s * (np.cos(h) - np.cos(h + w * dt)))
    return np.stack([e + de, n + dn, h + w * dt, w], -1)


def turn_slope(h, w, v=10.0):
    """The exact slopes of the place by the turn rate, by a series near zero."""
    order = np.arange(1, 12)
    powers = w ** (order - 1) / np.cumprod(np.r_[order + 1]) * order
    # d/dw (sin(h + w) − sin h)/w, term by term of the Taylor series about h.
    east = np.array([np.sin(h + (k + 1) * np.pi / 2) for k in order])
    north = np.array([-np.cos(h + (k + 1) * np.pi / 2) for k in order])
    return v * (powers @ east), v * (powers @ north)


W = pgm.Variable("x", components=("e", "n", "h", "w"), angles=("h",))


def turning(rate, straight, runs=()):
    """A model of one step along an arc, and its motion; rates (*runs) at first."""
    mean = np.zeros((*runs, 4))
    mean[..., 2], mean[..., 3] = 0.3, rate
    move = pgm.NonlinearGaussianCPD(W, W.previous, partial(turn, straight=straight), cov=1e-4)
    prior = pgm.GaussianCPD(W, mean, [0.01, 0.01, 1e-4, 0.04])
    return pgm.DynamicBayesianNetwork([prior], [move], []), move


def assert_turned(cov, rate):
    """The covariances of place and turn rate after a step, by the exact slopes."""
    due = 0.04 * np.array(turn_slope(0.3, rate))
    assert_allclose(cov[..., :2, 3], np.broadcast_to(due, (*cov.shape[:-2], 2)), rtol=5e-3)


@pytest.mark.parametrize(
    ("rate", "straight"),
    [
        *[(rate, 1e-9) for rate in (0.0, 1e-12, 2e-9, -1e-8, 1e-7, 1e-3)],
        *[(rate, straight) for rate in (0.0, 2e-9) for straight in (1e-6, 1e-4, 1e-3)],
        (9e-5, 1e-4),
        (-1.1e-4, 1e-4),
    ],
)
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
@pytest.mark.parametrize("runs", [(), (12,)])
def test_slopes_through_a_removable_singularity(rate, straight, compiled, runs):
    """Whether the formula cancels, or is of a straight branch narrower than the belief."""
    model, move = turning(rate, straight, runs)
    assert_turned(pgm.filter(model, {}, steps=1, compiled=compiled)[W].cov[..., 1, :, :], rate)
    if abs(rate) < max(straight, 5e-8):
        assert "formula cancels there, or is of a branch" in move.derivatives.reason


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
@pytest.mark.parametrize("options", [{}, {"lag": 2}, {"gate": 0.99}])
@pytest.mark.parametrize(("rate", "straight"), [(0.0, 1e-9), (2e-9, 1e-9), (0.0, 1e-4)])
def test_online_slopes_through_a_removable_singularity(rate, straight, options, compiled):
    robot = pgm.OnlineFilter(turning(rate, straight)[0], compiled=compiled, **options)
    assert_turned(robot.predict(robot.initial())[W].cov, rate)
    many = pgm.OnlineFilter(turning(rate, straight, (3,))[0], **options)
    assert_turned(many.predict(many.initial())[W].cov, rate)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
def test_one_run_of_very_many_goes_through_a_singularity(compiled):
    rates = np.full(6000, 0.2)
    rates[1234] = 0.0
    model, _ = turning(rates, 1e-9, (6000,))
    found = pgm.filter(model, {}, steps=1, compiled=compiled)[W].cov[:, 1]
    assert_turned(found[1234], 0.0)
    assert_turned(found[:3], 0.2)


def chord(d, straight=1e-9):
    """(1 − cos d)/d, whose slope at 0 is 1/2; zero where d is nearly so."""
    small = np.abs(d) < straight
    divisor = np.where(small, 1.0, d)
    return np.where(small, 0.0, (1.0 - np.cos(divisor)) / divisor)


D = pgm.Variable("d", components=("a", "b"))


def together(apart):
    """The covariance of two components, known to 10³, whose difference is known to `apart`."""
    return np.array([[1e6, 1e6], [1e6, 1e6 + apart**2]])


def pair(a, b):
    return np.stack([a, b], axis=-1)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
@pytest.mark.parametrize(
    ("function", "mean", "cov", "slope"),
    [
        # Deviations are 10⁴ and 10⁶ times that of the difference, and its function bends over 1.
        *[
            (lambda x: x[..., 0] + chord(x[..., 1] - x[..., 0]), [0.3, 0.3 + off], cov, [0.5, 0.5])
            for off in (0.0, 2e-9)
            for cov in (together(0.1), together(1e-3))
        ],
        # A component that is as good as unknown, beside the turn rate in one entry.
        *[
            (
                lambda x, s=s: 0.1 * x[..., 0] + np.cos(x[..., 0]) * chord(x[..., 1], s),
                [0.7, 1e-12],
                [wide**2, 1.0],
                [0.1, 0.5 * np.cos(0.7)],
            )
            for wide in (30.0, 1000.0)
            for s in (1e-9, 1e-4)
        ],
    ],
)
def test_slopes_beside_what_is_known_far_less(function, mean, cov, slope, compiled):
    """Of a function of a difference, or of a product, by exact slopes; also online."""
    move = pgm.NonlinearGaussianCPD(
        D, D.previous, lambda x: pair(function(x), x[..., 1]), cov=[1e-4, 1e-4]
    )
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(D, mean, cov)], [move], [])
    found = [pgm.filter(model, {}, steps=1, compiled=compiled)[D].cov[1]]
    robot = pgm.OnlineFilter(model, compiled=compiled)
    found.append(robot.predict(robot.initial())[D].cov)
    cov = np.diag(cov) if np.ndim(cov) == 1 else np.asarray(cov)
    due = np.array([slope, [0.0, 1.0]]) @ cov @ np.array([slope, [0.0, 1.0]]).T
    for each in found:
        difference = np.array([1.0, -1.0])
        assert_allclose(each - np.diag([1e-4, 1e-4]), due, rtol=1e-6)
        if np.ndim(cov) == 2 and cov[0, 1]:
            apart = difference @ (each - 1e-4 * np.eye(2)) @ difference
            assert_allclose(apart, difference @ due @ difference, rtol=1e-2, atol=1e-8)


def test_a_branch_that_holds_while_either_of_two_is_small_is_told():
    """Along each component its slope is right, and not along both at once."""

    def cross(x):
        a, w = x[..., 0], x[..., 1]
        small = (np.abs(a) < 1e-4) | (np.abs(w) < 1e-4)
        return pair(np.where(small, 0.0, a + chord(w)), w)

    move = pgm.NonlinearGaussianCPD(D, D.previous, cross, cov=[1e-4, 1e-4])
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(D, [0.0, 0.0], [1.0, 1.0])], [move], [])
    pgm.filter(model, {}, steps=1)
    assert "along [1, 0.658359], is 1.32" in move.derivatives.reason


NARROW = {
    "tanh": (lambda a: np.tanh(a), lambda a: 1.0 / np.cosh(a) ** 2),
    "saturated": (lambda a: a / np.sqrt(1.0 + a * a), lambda a: (1.0 + a * a) ** -1.5),
    "arctan": (lambda a: np.arctan(a), lambda a: 1.0 / (1.0 + a * a)),
}


@pytest.mark.filterwarnings("ignore::pgm.PrecisionWarning")  # far coordinates, narrow beliefs
@pytest.mark.parametrize("kind", NARROW)
@pytest.mark.parametrize(
    ("place", "scale"), [(0.0, 1e-9), (0.0, 1.0), (3.7e5, 1e-5), (5e6, 3e-4), (1.7e9, 0.1)]
)
@pytest.mark.parametrize("wide", [0.3, 30.0, 3000.0])
def test_a_narrow_bend_keeps_the_slope_that_its_jacobian_has(kind, place, scale, wide):
    """A sensor that saturates far from zero, for beliefs narrower and wider than its range."""
    bend, slope = NARROW[kind]
    found = []
    for jacobian in (None, {S: lambda s: slope((s - place) / scale)[..., None]}):
        see = pgm.NonlinearGaussianCPD(
            Y,
            S,
            lambda s: scale * bend((s - place) / scale),
            cov=(0.1 * scale) ** 2,
            jacobian=jacobian,
        )
        stay = pgm.LinearGaussianCPD(S, {S.previous: 1.0}, cov=0.0)
        model = pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(S, place, (wide * scale) ** 2)], [stay], [see]
        )
        found.append(pgm.filter(model, {Y: [[0.3 * scale]]})[S])
    close = 1e-6 * found[1].std.min() + 2.0 * np.spacing(place)
    assert_allclose(found[0].mean, found[1].mean, rtol=0.0, atol=close)
    assert_allclose(found[0].cov, found[1].cov, rtol=1e-6)


@pytest.mark.parametrize(
    "function",
    [
        np.abs,
        lambda x: np.maximum(x, 0.0),
        np.round,
        lambda x: np.floor(10.0 * x) / 10.0,
        lambda x: np.where(x > 0.3, 2.0 * x, x),
        lambda x: np.sin(50.0 * x),
        lambda x: x + 5e6,
        lambda x: 1e-12 * np.cos(x),
        lambda x: np.sinc(x),
        lambda x: x * 0.0,
        np.exp,
        lambda x: 1e8 * np.tanh(1e-3 * x),
        lambda x: np.sqrt(np.abs(x) + 1e-9),
    ],
)
@pytest.mark.parametrize("std", [1e-6, 0.3, 1e4])
def test_right_traces_stay(function, std):
    """At kinks and steps, for wide beliefs and narrow ones, far and small values."""
    move = pgm.NonlinearGaussianCPD(Y, S, function, cov=0.01)
    found = (
        Answers(move._tracer, ((0, 0),), (0,), (0.01,))
        if move._tracer.confirm([np.zeros(1)])
        else pytest.fail(move._tracer.reason)
    )
    rng = np.random.default_rng(3)
    for x in np.r_[0.0, 0.3, 1e3, std * rng.normal(size=30)]:
        found.single([np.array([x])], np.array([[std**2]]))
    found.batch([std * rng.normal(size=(40, 1))], (40,), np.full((40, 1), std))
    found.close()
    assert found.fault is None


def test_wrong_slopes_are_told_with_their_point():
    tracer = Tracer(
        lambda x: np.where(x == 0.0, 0.0, (np.cos(x) - 1.0) / x), (1,), np.array([False])
    )
    assert tracer.confirm([np.ones(1)])
    found = Answers(tracer, ((0, 0),), (0,), (0.0,))
    _, slope, finite = found.single([np.array([1e-9])], np.array([[0.01]]))
    assert finite
    assert abs(slope[0, 0] + 0.5) > 0.1  # which is what is to be found
    found.close()
    assert "[1e-09]" in found.fault
    assert "is -0.5 by differences" in found.fault


@pytest.mark.parametrize("sampled", [True, False])
def test_a_large_batch_is_judged_at_a_sample_only_where_the_trace_shows_all(sampled):
    rows = []

    def function(x):
        rows.append(x[..., 0].size)
        return np.sin(x) if sampled else np.asarray(x, dtype=float)

    tracer = Tracer(function, (1,), np.array([False]))
    found = pgm.tracing.Judge().asked(tracer, [np.zeros(1)], ((0, 0),), (0,), (0.01,), 10**6)
    assert (found.sample(10**6).size < 10**4) == sampled
    rows.clear()
    for _ in range(50):
        found.batch([np.ones((20_000, 1))], (20_000,), np.ones((20_000, 1)))
    found.close()
    assert found.fault is None
    assert (sum(rows) < 10**4) == sampled
    assert (sum(rows) > 10**6) != sampled


def by_gain(gains):
    """A function that is traced as it is, and of which a gain may change."""
    return lambda s, u: np.where(u == 2, gains[1] * s, gains[0] * s)


@pytest.mark.parametrize("kind", ["frozen", "changed"])
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
@pytest.mark.parametrize("runs", [(), (3,)])
@pytest.mark.parametrize("steps", [6, 200])
def test_a_wrong_slope_counts_where_all_values_are_alike(kind, compiled, runs, steps):
    """As at a mean of exactly zero, of 2 s and s / 2."""
    gains, inputs, middle = [0.5, 0.5], np.zeros((*runs, steps, 1)), steps // 2
    inputs[..., middle, 0] = 2.0
    function = by_asarray if kind == "frozen" else by_gain(gains)
    move = pgm.NonlinearGaussianCPD(S, (S.previous, U), function, cov=1e-3)
    prior = pgm.GaussianCPD(S, np.zeros((*runs, 1)), 1.0)
    model = pgm.DynamicBayesianNetwork([prior], [move], [])
    pgm.filter(model, {U: inputs}, compiled=compiled)
    gains[1] = 2.0
    found = pgm.filter(model, {U: inputs}, compiled=compiled)[S].cov[..., 0, 0]
    due = [1.0]
    for t in range(steps):
        due.append((2.0 if t == middle else 0.5) ** 2 * due[-1] + 1e-3)
    assert_allclose(found, np.broadcast_to(due, found.shape), rtol=1e-9)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
@pytest.mark.parametrize("runs", [(), (3,)])
def test_a_wrong_slope_of_sightings_counts_where_all_values_are_alike(compiled, runs):
    """Two sightings of a step, of which the later has the other gear."""
    sight = pgm.NonlinearGaussianCPD(Y, (S, U), by_asarray, cov=1.0)
    prior = pgm.GaussianCPD(S, np.zeros((*runs, 1)), 1.0)
    stay = pgm.LinearGaussianCPD(S, {S.previous: 1.0}, 0.0)
    model = pgm.DynamicBayesianNetwork([prior], [stay], [sight])
    gears = np.array([[0.0], [2.0], [0.0], [2.0]])
    seen = pgm.sightings(np.zeros((*runs, 4, 1)), step=[1, 1, 2, 2], given={U: gears})
    found = pgm.filter(model, {Y: seen}, steps=2, compiled=compiled)[S].cov[..., -1, 0, 0]
    assert_allclose(found, np.full(runs, 1.0 / (1.0 + 2 * 0.25 + 2 * 4.0)), rtol=1e-9)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
def test_online_a_frozen_slope_counts_where_all_values_are_alike(compiled):
    move = pgm.NonlinearGaussianCPD(S, (S.previous, U), by_asarray, cov=1e-3)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(S, 0.0, 1.0)], [move], [])
    robot, due = pgm.OnlineFilter(model, compiled=compiled), 1.0
    belief = robot.initial()
    for gear in [0.0] * 12 + [2.0] * 3:
        belief, due = robot.predict(belief, {U: [gear]}), (2.0 if gear else 0.5) ** 2 * due + 1e-3
        assert_allclose(belief[S].cov, [[due]], rtol=1e-9)


def test_a_function_that_fails_beside_its_points_keeps_its_trace():
    def bounded(x):
        if isinstance(x, np.ndarray) and x.dtype == float and (np.abs(x) > 1e5).any():
            raise ValueError("beyond the map")
        return np.sin(x)

    tracer = Tracer(bounded, (1,), np.array([False]))
    assert tracer.confirm([np.ones(1)])
    found = Answers(tracer, ((0, 0),), (0,), (1.0,))
    found.single([np.array([1e5])], np.array([[1e6]]))
    found.close()
    assert found.fault is None


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
def test_online_a_function_may_return_an_array_that_it_uses_again(compiled):
    kept = {}

    def function(s, u):
        out = kept.setdefault(s.shape, np.empty(s.shape))
        out[..., 0] = np.sin(s[..., 0]) + u[..., 0]
        return out

    move = pgm.NonlinearGaussianCPD(S, (S.previous, U), function, cov=1e-3)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(S, 0.3, 1.0)], [move], [])
    robot = pgm.OnlineFilter(model, compiled=compiled)
    beliefs, due = [robot.initial()], [0.3]
    for _ in range(9):
        beliefs.append(robot.predict(beliefs[-1], {U: [0.4]}))
        due.append(np.sin(due[-1]) + 0.4)
    assert_allclose([belief[S].mean[0] for belief in beliefs], due, rtol=1e-9)
