"""Errors of functions, noises and linearisers: before data meets them, and while messages flow."""

import numpy as np
import pytest
from refusing import CALLS, EVIDENCE, SIGHT, T, U, a, function_row, linear, prior, robot, w, walk
from robots import DRIVE, Q, u, x
from textbooks import refusal

import pgm
from pgm import LinearisationError, ModelError, NumericalError
from pgm.tracing.traced import Traced


def noisy(function):
    return pgm.noise(function, given=u)


def uneven(state, control):
    return DRIVE(state, control)[..., :2]


def first_row(state, control):
    return np.stack([state[0] + control[0], state[1], state[2]], axis=-1)


def flat(state, landmark):
    return np.hypot(state[..., 0], landmark[..., 0])


def raising(state, landmark):
    raise KeyError("landmark 7")


FUNCTIONS = [
    function_row(
        "a motion of 2 components",
        ModelError,
        ("x", "function", "(4, 5, 2)", "(4, 5, 3)", "a[..., i]"),
        robot(drive=uneven),
    ),
    function_row(
        "a sensor without its axis",
        ModelError,
        ("z", "function", "(4, 5)", "(4, 5, 2)", "a[..., i]"),
        robot(sight=flat),
        2,
    ),
    function_row("a function of x[0]", ModelError, ("x",), robot(drive=first_row)),
    function_row(
        "one that raises", ModelError, ("z", "KeyError", "landmark 7"), robot(sight=raising), 2
    ),
    function_row(
        "one of too few arguments", ModelError, ("x", "argument"), robot(drive=lambda state: state)
    ),
    function_row(
        "a Jacobian of a wrong shape",
        ModelError,
        ("x", "jacobian", "x[t-1]", "(4, 5, 3, 2)", "(4, 5, 3, 3)"),
        robot(by={x.previous: DRIVE.by_control}),
    ),
    function_row(
        "a Jacobian of x[0]",
        ModelError,
        ("z", "jacobian"),
        robot(by_sight={x: lambda state, landmark: np.zeros((2, 3))}),
        2,
    ),
]

NOISES = [
    function_row(
        "an asymmetric noise at step 3",
        ModelError,
        ("x", "noise", "step 3", "not symmetric"),
        robot(cov=noisy(lambda k: Q + (np.arange(T) == 2)[:, None, None, None] * np.eye(3, k=1))),
        step=3,
    ),
    function_row(
        "an indefinite noise at step 2",
        ModelError,
        ("x", "noise", "step 2", "negative"),
        robot(cov=noisy(lambda k: Q * np.array([1, -1, 1, 1])[:, None, None, None])),
        step=2,
    ),
    function_row(
        "NaN in the noise at step 4",
        ModelError,
        ("x", "noise", "step 4", "NaN"),
        robot(cov=noisy(lambda k: Q * np.array([1, 1, 1, np.nan])[:, None, None, None])),
        step=4,
    ),
    function_row(
        "a noise of a wrong shape",
        ModelError,
        ("x", "noise", "(4, 1, 2)", "(4, 1, 3, 3)"),
        robot(cov=noisy(lambda k: k)),
    ),
    function_row(
        "one noise for all", ModelError, ("x", "noise", "(3, 3)"), robot(cov=noisy(lambda k: Q))
    ),
    function_row(
        "a noise that raises",
        ModelError,
        ("x", "noise", "step 1", "IndexError"),
        robot(cov=noisy(lambda k: k[..., 7])),
        step=1,
    ),
]


# ---- numbers that turn out bad while messages flow


def blind_after(east):
    def sight(state, landmark):
        seen = SIGHT.function(state, landmark)
        return np.where(state[..., :1] > east, np.nan, seen)

    return sight


def stuck_at(east):
    def drive(state, control):
        return np.where(state[..., :1] > east, np.inf, DRIVE(state, control))

    return drive


class Shrinking:
    """A lineariser whose error is a negative covariance."""

    def __init__(self, child, size, step):
        self.child, self.size, self.step = child, size, step

    def __call__(self, function, at):
        affine = pgm.Taylor()(function, at)
        due = function.name == self.child and function.step == self.step
        cov = -self.size * np.eye(affine.cov.shape[-1]) if due else affine.cov
        return pgm.AffineGaussian(affine.F, affine.b, cov)

    def __repr__(self):
        return "Shrinking()"


def turned(function, at):
    affine = pgm.Taylor()(function, at)
    return pgm.AffineGaussian(affine.F[..., :-1, :], affine.b[..., :-1], affine.cov[:-1, :-1])


def too_wide(function, at):
    affine = pgm.Taylor()(function, at)
    return pgm.AffineGaussian(np.concatenate([affine.F] * 2, axis=-1), affine.b, affine.cov)


def by_tuple(function, at):
    affine = pgm.Taylor()(function, at)
    return affine.F, affine.b, affine.cov


def blank(function, at):
    affine = pgm.Taylor()(function, at)
    return pgm.AffineGaussian(affine.F * np.nan, affine.b, affine.cov)


def blank_later(function, at):
    """Taylor, but NaN in the row of step 2 where one call covers many steps."""
    affine = pgm.Taylor()(function, at)
    if function.name != "x" or np.ndim(function.step) == 0:
        return affine
    F = np.where((np.asarray(function.step) == 2)[..., None, None], np.nan, affine.F)
    return pgm.AffineGaussian(F, affine.b, affine.cov)


def lineariser_row(name, words, lineariser, **more):
    options = {"lineariser": lineariser}
    return function_row(name, LinearisationError, words, robot(), options=options, **more)


def exact_robot():
    look = pgm.LinearGaussianCPD(w, {x: [[1.0, 0, 0]]}, cov=0.0)
    return robot()[0].replace(observation=[look]), look


EXACT, EXACT_LOOK = exact_robot()
STILL = pgm.DynamicBayesianNetwork([prior(a)], [walk(a, cov=0.0)], [linear(w, a, cov=0.0)])
SEES_A = STILL.replace(observation=[pgm.LinearGaussianCPD(w, {a: 1.0}, cov=0.0)])

# The predictive variance is positive, 9.1, though that of the reading's error is negative.
ROUGH = pgm.DynamicBayesianNetwork(
    [prior(a, 9.0)],
    [walk(a, cov=0.1)],
    [pgm.NonlinearGaussianCPD(w, a, np.sin, 0.01, lineariser=Shrinking("w", 0.9, 2))],
)

DURING = [
    function_row(
        "a motion that is infinite at step 3",
        LinearisationError,
        ("x", "step 3", "NaN or infinite"),
        robot(drive=stuck_at(1.5)),
        infer=pgm.filter,
        step=3,
    ),
    function_row(
        "a sensor that is NaN at step 2",
        LinearisationError,
        ("z", "step 2", "NaN"),
        robot(sight=blind_after(1.5)),
        2,
        infer=pgm.filter,
        step=2,
    ),
    function_row(
        "points that leave the domain",
        LinearisationError,
        ("z", "step 1", "NaN"),
        robot(sight=blind_after(1.5)),
        2,
        step=1,
        options={"lineariser": pgm.Unscented()},
    ),
    function_row(
        "a relinearisation that fails",
        LinearisationError,
        ("x", "NaN"),
        robot(),
        step=2,
        options={"iterations": 2, "lineariser": blank_later},
    ),
    function_row(
        "an indefinite prediction at step 2",
        NumericalError,
        ("x", "step 2", "indefinite", "Shrinking()"),
        robot(),
        step=2,
        options={"lineariser": Shrinking("x", 9.0, 2)},
    ),
    function_row(
        "an indefinite predictive covariance at step 3",
        NumericalError,
        ("z", "step 3", "indefinite", "Shrinking()"),
        robot(),
        2,
        step=3,
        options={"lineariser": Shrinking("z", 99.0, 3)},
    ),
    *(
        refusal(
            f"a belief made indefinite by the last reading, {way.__name__}",
            lambda way=way: way(ROUGH, {w: pgm.sightings([[0.0]], [2])}, steps=2),
            NumericalError,
            "step 2",
            "indefinite",
            "Shrinking()",
            variable=w,
            step=2,
            cpd=ROUGH.observation[0],
        )
        for way in (pgm.filter, pgm.smooth)
    ),
    lineariser_row("a lineariser of tuples", ("x", "step 1", "tuple", "AffineG"), by_tuple, step=1),
    lineariser_row("one of 2 rows", ("x", "step 1", "(2, 3)", "(3, 3)"), turned, step=1),
    lineariser_row("one of 6 columns", ("x", "step 1", "(3, 6)", "(3, 3)"), too_wide, step=1),
    lineariser_row("a lineariser of NaN", ("x", "step 1", "NaN"), blank, step=1),
    refusal(
        "too few samples",
        lambda: pgm.smooth(robot()[0], EVIDENCE, lineariser=pgm.MonteCarlo(7)),
        LinearisationError,
        "MonteCarlo(samples=7)",
        "x",
        "8 or more",
    ),
    refusal(
        "an exact reading that is impossible",
        lambda: pgm.filter(SEES_A, {w: [[1.0], [1.0], [1.5]]}),
        NumericalError,
        "w",
        "step 3",
        "contradicts",
        "noise",
        variable=w,
        step=3,
        cpd=SEES_A.observation[0],
    ),
    refusal(
        "two exact readings that differ",
        lambda: pgm.smooth(EXACT, {u: U, w: pgm.sightings([[1.0], [2.0], [2.5]], step=[1, 2, 2])}),
        NumericalError,
        "w",
        "step 2",
        "contradicts",
        variable=w,
        step=2,
        cpd=EXACT_LOOK,
    ),
]

BEFORE = FUNCTIONS + NOISES
TABLE = BEFORE + DURING


@pytest.mark.parametrize("refused", TABLE, ids=lambda r: r.name)
def test_every_refusal(refused):
    refused.check()


@pytest.mark.parametrize("refused", BEFORE, ids=lambda r: r.name)
def test_before_inference_functions_meet_no_data(refused):
    """At the most trial calls, one in another order, and a trace, with its points about zero."""
    CALLS.clear()
    refused.check()
    assert len(CALLS) <= 6
    arguments = [each for call in CALLS for each in call if not isinstance(each, Traced)]
    assert all(argument.shape[:2] in [(4, 5), (2, 3)] for argument in arguments)
