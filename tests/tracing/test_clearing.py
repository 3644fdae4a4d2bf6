"""Traces that machine code clears are those in which the judge finds nothing, and nearly all."""

from importlib.util import find_spec

import numpy as np
import pytest

import pgm
from pgm.tracing import Answers, Tracer
from pgm.tracing.clearing import Standing

pytestmark = pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed")


def turned(x, u):
    """A motion along an arc, whose slopes by the turn rate cancel where that is small."""
    rate = x[..., 2] * u[..., 0]
    safe = np.where(np.abs(rate) < 1e-9, 1e-9, rate)
    way = (np.sin(x[..., 1] + safe) - np.sin(x[..., 1])) / safe
    return np.stack([x[..., 0] + way, x[..., 1] + rate], axis=-1)


def seen(x, m):
    away = m - x[..., :2]
    bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
    return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)


def kinked(x, u):
    return np.stack([np.abs(x[..., 0]) + u[..., 0], np.maximum(x[..., 1], x[..., 2])], axis=-1)


def plain(x, u):
    return np.stack([x[..., 0] * x[..., 1], np.sin(x[..., 2]) + u[..., 1]], axis=-1)


FUNCTIONS = {"turned": turned, "seen": seen, "kinked": kinked, "plain": plain}


class Traced:
    """A function that may change after it was traced, and its trace, which a call has proved."""

    def __init__(self, function, angles=(False, True)):
        self.factor, self.bump = 1.0, None
        self.tracer = Tracer(self.called(function), (3, 2), np.array(angles))
        assert self.tracer.confirm([np.ones(3), np.full(2, 5.0)])
        self.tracer.prove(self.tracer.trace)

    def called(self, function):
        def call(x, u):
            found = self.factor * function(x, u)
            return found if self.bump is None else self.bump(found, x)

        return call

    def answers(self):
        columns = tuple((0, k) for k in range(3))
        return Answers(self.tracer, columns, range(3), (0.01, 0.04))

    def judged(self, x, u, std):
        """What the judge finds, and whether machine code clears all."""
        answers = self.answers()
        clearing = answers.slopes.clearing(answers.trace, differentiated=std is not None)
        cleared = clearing.clears(Standing.of(np.concatenate([x, u], axis=-1), std))
        self.tracer._calls = 0  # so that the judge looks by NumPy
        answers.judge([x, u], std)
        answers.close()
        self.tracer.prove(answers.trace)
        return answers.fault, cleared


def points(rng, count, far=0.0):
    x = rng.normal(size=(count, 3)) + far
    return x, 5.0 + rng.normal(size=(count, 2)), rng.uniform(0.01, 0.3, size=(count, 3))


@pytest.mark.parametrize("count", [1, 2, 16, 17, 60, 500])
@pytest.mark.parametrize("name", ["seen", "plain", "turned"])
def test_ordinary_points_are_cleared(name, count):
    found = Traced(FUNCTIONS[name]).judged(*points(np.random.default_rng(count), count))
    assert found == (None, True)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_values_alone_are_cleared(name):
    x, u, _ = points(np.random.default_rng(3), 40)
    assert Traced(FUNCTIONS[name]).judged(x, u, None) == (None, True)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("name", FUNCTIONS)
def test_nothing_is_cleared_that_the_judge_finds(name, seed):
    """Functions that changed a little or much, at singular, far, flat and unknown points."""
    rng = np.random.default_rng(seed)
    function = Traced(FUNCTIONS[name])
    x, u, std = points(rng, int(rng.integers(1, 80)), far=10.0 ** rng.uniform(-3, 7))
    some = rng.random(len(x)) < 0.2
    x[some, 2] = 10.0 ** rng.uniform(-14, -6)
    std[rng.random(std.shape) < 0.1] = rng.choice([0.0, np.nan, np.inf, 1e-12])
    function.factor = 1.0 + rng.choice([0.0, 0.0, 1e-12, 1e-8, 1e-3])
    fault, cleared = function.judged(x, u, std)
    assert fault is None or not cleared


@pytest.mark.parametrize(
    "bump",
    [
        lambda y, x: y + np.where(x[..., :1] == x[0, 0], 1e-3, 0.0),  # at one point alone
        lambda y, x: np.where(np.arange(len(y))[:, None] == 0, np.nan, y),
        lambda y, x: y[:, :1],
        lambda y, x: y + 1e-4 * np.arange(len(y))[:, None],
        lambda y, x: 1 / 0,
    ],
    ids=["one", "nan", "shape", "batch", "error"],
)
def test_functions_that_changed_are_not_cleared(bump):
    function = Traced(seen)
    function.bump = bump
    fault, cleared = function.judged(*points(np.random.default_rng(1), 30))
    assert not cleared
    assert fault is not None


def test_whole_turns_are_no_difference():
    function = Traced(seen)
    function.bump = lambda y, x: y + np.array([0.0, 2 * np.pi])
    assert function.judged(*points(np.random.default_rng(1), 30)) == (None, True)


def test_a_wrong_slope_is_not_cleared():
    """A branch narrower than the belief, whose values are right."""
    function = Traced(turned)
    x, u, std = points(np.random.default_rng(1), 30)
    x[:, 2] = 0.0
    fault, cleared = function.judged(x, u, std)
    assert "its formula cancels there, or is of a branch" in fault
    assert not cleared


def test_derivatives_that_were_given_are_compared():
    factor = [1.0]
    x, z = pgm.Variable("x"), pgm.Variable("z")
    sensor = pgm.NonlinearGaussianCPD(
        z, (x,), np.sin, cov=0.1, jacobian={x: lambda a: factor[0] * np.cos(a)[..., None]}
    )
    walk = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.1)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(x, 0.2, 1.0)], [walk], [sensor])
    evidence = {z: np.full((20, 1), 0.5)}
    for each in (*[1.0] * 9, 0.5):
        factor[0] = each
        found = pgm.filter(model, evidence, compiled=True)
        due = pgm.filter(model, evidence, compiled=False)
        np.testing.assert_allclose(found[x].mean, due[x].mean, atol=1e-12)
