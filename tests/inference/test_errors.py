"""Each error that the design names: its class, what it is about, and what it says to do.

Rows of evidence, and of the online filter, are in test_evidence_errors.
"""

import numpy as np
import pytest
from robots import DRIVE, LANDMARKS, P0, SENSORS, Q, m, u, x
from textbooks import refusal

import pgm
from pgm import EvidenceError, GraphError, LinearisationError, ModelError, NumericalError
from pgm.clustergraph import check_families, check_running_intersection

z, SIGHT = SENSORS["range_bearing"].z, SENSORS["range_bearing"]
a, b, c, w = pgm.variables("a b c w")
pair = pgm.Variable("pair", components=("p", "q"))
I2, I3 = np.eye(2), np.eye(3)
T = 4
CALLS = []


def counting(function):
    def counted(*arguments):
        CALLS.append(arguments)
        return function(*arguments)

    return counted


def prior(variable, cov=1.0):
    size = variable.dimension
    return pgm.GaussianCPD(variable, np.zeros(size), cov * np.eye(size))


def walk(variable, cov=1.0):
    size = variable.dimension
    return pgm.LinearGaussianCPD(variable, {variable.previous: 1.0}, cov=cov * np.eye(size))


def network(prior, transition, observation=()):
    return lambda: pgm.DynamicBayesianNetwork(prior, transition, observation)


def linear(child, *given, cov=1.0):
    def matrix(parent):
        return np.zeros((child.dimension, parent.dimension))

    return pgm.LinearGaussianCPD(
        child, {p: matrix(p) for p in given}, cov=cov * np.eye(child.dimension)
    )


def model_row(name, call, *words, **attributes):
    return refusal(name, call, ModelError, *words, **attributes)


def gaussian(cov, mean=(0, 0)):
    return lambda: pgm.GaussianCPD(pair, mean, cov)


NOT_SYMMETRIC, INDEFINITE = [[1, 0.5], [0.4, 1]], [[1, 2], [2, 1]]

CPDS = [
    model_row("a mean of 3", gaussian(I2, [0, 0, 0]), "pair", "(3,)", "('p', 'q')", variable=pair),
    model_row("a mean of NaN", gaussian(I2, [0, np.nan]), "pair", "NaN", variable=pair),
    model_row("a mean of words", gaussian(I2, "here"), "pair", "numbers", variable=pair),
    model_row("a cov of 3", gaussian(I3), "pair", "(3, 3)", "(2, 2)", variable=pair),
    model_row("a negative variance", gaussian(-1.0), "pair", "negative", "-1", variable=pair),
    model_row("asymmetric", gaussian(NOT_SYMMETRIC), "pair", "not symmetric", variable=pair),
    model_row("indefinite", gaussian(INDEFINITE), "pair", "negative", "-1", variable=pair),
    model_row("infinite", gaussian([[1, np.inf], [np.inf, 1]]), "pair", "infinite", variable=pair),
    model_row(
        "infinite in part", gaussian([[np.inf, 1], [1, 1]]), "pair", "must be 0", variable=pair
    ),
    model_row(
        "an infinite noise",
        lambda: pgm.LinearGaussianCPD(pair, {a: [[1], [1]]}, cov=[[np.inf, 0], [0, 1]]),
        "pair",
        "infinite",
        variable=pair,
    ),
    model_row(
        "a negative variance", lambda: pgm.GaussianCPD(a, 0.0, -0.5), "a", "-0.5", variable=a
    ),
    model_row(
        "an asymmetric noise",
        lambda: pgm.LinearGaussianCPD(pair, {a: [[1], [1]]}, cov=NOT_SYMMETRIC),
        "pair",
        "not symmetric",
        variable=pair,
    ),
    model_row(
        "an indefinite noise of a function",
        lambda: pgm.NonlinearGaussianCPD(pair, a, np.sin, INDEFINITE),
        "pair",
        "negative",
        variable=pair,
    ),
    model_row(
        "a matrix of a wrong shape",
        lambda: pgm.LinearGaussianCPD(pair, {a: [[1.0, 2.0]]}, cov=I2),
        "pair",
        "a",
        "(1, 2)",
        "(2, 1)",
        variable=a,
    ),
    model_row(
        "a number for a tall matrix",
        lambda: pgm.LinearGaussianCPD(pair, {a: 1.0}, cov=I2),
        "()",
        "(2, 1)",
        variable=a,
    ),
    model_row(
        "a matrix of NaN",
        lambda: pgm.LinearGaussianCPD(a, {b: np.nan}, cov=1.0),
        "a",
        "matrix of b",
        "NaN",
    ),
    model_row(
        "an offset of 3",
        lambda: pgm.LinearGaussianCPD(pair, {pair.previous: 1.0}, cov=I2, offset=[1, 2, 3]),
        "pair",
        "offset",
        "(3,)",
        "(2,)",
        variable=pair,
    ),
    model_row(
        "parents without matrices",
        lambda: pgm.LinearGaussianCPD(a, (b,), cov=1.0),
        "a",
        "given={x: 1.0}",
        variable=a,
    ),
    model_row(
        "a child before its time",
        lambda: walk(a.previous),
        "a[t-1]",
        "declare it",
        variable=a.previous,
    ),
    model_row(
        "its own parent",
        lambda: pgm.LinearGaussianCPD(a, {a: 1.0}, cov=1.0),
        "a",
        "a.previous",
        variable=a,
    ),
    model_row(
        "no function", lambda: pgm.NonlinearGaussianCPD(a, b, 3.0, 1.0), "a", "function", "callable"
    ),
    model_row(
        "a Jacobian by a stranger",
        lambda: pgm.NonlinearGaussianCPD(a, b, np.sin, 1.0, jacobian={c: np.cos}),
        "a",
        "c",
        "parents",
        variable=c,
    ),
    model_row(
        "a lineariser that cannot be called",
        lambda: pgm.NonlinearGaussianCPD(a, b, np.sin, 1.0, lineariser="Taylor"),
        "a",
        "Taylor",
        "called",
    ),
    model_row("noise of no function", lambda: pgm.noise(I2, given=a), "function"),
    model_row("angles that are no components", lambda: pgm.Variable("v", ("p",), ("q",)), "q", "p"),
    model_row("a component twice", lambda: pgm.Variable("v", ("p", "p")), "v", "repeat"),
    model_row("a step before the first", lambda: x.at(0).previous, "x", "-1"),
]

CYCLE = [prior(a), prior(b)], [linear(a, a.previous, b), linear(b, b.previous, a)]
TWICE = [walk(a), walk(a)]
OTHER_A = pgm.Variable("a", components=("p", "q"))
SEES_PREVIOUS = linear(w, a.previous)
LAG_2 = linear(a, a.previous, b.previous.previous)
AT_3 = linear(a, a.at(3))
OF_READING = linear(a, a.previous, w)
HIDDEN_NOISE = pgm.LinearGaussianCPD(
    w, {a: 1.0}, cov=pgm.noise(lambda v: v[..., None] ** 2, given=a)
)

NETWORKS = [
    model_row("a cycle", network(*CYCLE), "cycle", "a -> b", ".previous"),
    model_row(
        "a cycle in the prior",
        network([linear(a, b), linear(b, a)], [walk(a), walk(b)]),
        "cycle",
        ".previous",
    ),
    model_row(
        "a state without a transition",
        network([prior(a), prior(b)], [walk(a)]),
        "b",
        "no transition",
        "b[t-1]",
        "cov=0",
        variable=b,
    ),
    model_row(
        "a state without a prior",
        network([prior(a)], [walk(a), walk(b)]),
        "b",
        "no prior",
        variable=b,
    ),
    model_row(
        "two transitions of a state",
        network([prior(a)], TWICE),
        "a",
        "two CPDs",
        cpd=TWICE[1],
        variable=a,
    ),
    model_row(
        "two priors of a state",
        network([prior(a), prior(a)], [walk(a)]),
        "a",
        "two CPDs",
        variable=a,
    ),
    model_row(
        "a state that is also read",
        network([prior(a)], [walk(a)], [linear(a, b)]),
        "a",
        "two CPDs",
        variable=a,
    ),
    model_row(
        "two variables of one name",
        network([prior(a)], [walk(a)], [linear(w, OTHER_A)]),
        "'a'",
        "('p', 'q')",
        "rename",
        variable=OTHER_A,
    ),
    model_row(
        "one name, other angles",
        network([prior(a)], [walk(a)], [linear(w, pgm.Variable("a", angles=("a",)))]),
        "'a'",
        "angles",
        "rename",
    ),
    model_row(
        "a sensor of the step before",
        network([prior(a)], [walk(a)], [SEES_PREVIOUS]),
        "a[t-1]",
        "sensor",
        "state",
        variable=a.previous,
        cpd=SEES_PREVIOUS,
    ),
    model_row(
        "two steps back",
        network([prior(a), prior(b)], [LAG_2, walk(b)]),
        "b[t-2]",
        "state of its own",
        variable=b.previous.previous,
        cpd=LAG_2,
    ),
    model_row(
        "a single step",
        network([prior(a)], [AT_3]),
        "a[3]",
        "single step",
        variable=a.at(3),
        cpd=AT_3,
    ),
    model_row(
        "a reading as a parent",
        network([prior(a)], [OF_READING], [linear(w, a)]),
        "w",
        "measurement",
        variable=w,
        cpd=OF_READING,
    ),
    model_row(
        "noise that a state sets",
        network([prior(a)], [walk(a)], [HIDDEN_NOISE]),
        "a",
        "noise",
        "inputs",
        variable=a,
        cpd=HIDDEN_NOISE,
    ),
    model_row(
        "an input in the prior", network([linear(a, b)], [walk(a)]), "b", "prior", variable=b
    ),
    model_row("no CPD", network([a], [walk(a)]), "prior", "CPDs", "a"),
    model_row(
        "replace what is not there",
        lambda: network([prior(a)], [walk(a)])().replace(sensors=[]),
        "sensors",
        "observation",
    ),
]


# ---- functions: found before any of them meets data

U, VALUES = np.tile([1.0, 0.1], (T, 1)), np.tile([8.0, 1.0], (T, 1))
EVIDENCE = {u: U, z: VALUES, m: pgm.constant(LANDMARKS[0])}


def robot(drive=DRIVE, sight=SIGHT.function, cov=Q, by=None, by_sight=None, **options):
    """A robot with other functions, and its CPDs."""
    move = pgm.NonlinearGaussianCPD(
        x, (x.previous, u), counting(drive), cov, jacobian=by, **options
    )
    look = pgm.NonlinearGaussianCPD(
        z, (x, m), counting(sight), SIGHT.cov, jacobian=by_sight, **options
    )
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(x, [0, 0, 0], P0)], [move], [look])
    return model, move, look


def function_row(name, error, words, made, about=1, infer=pgm.smooth, step=None, options=None):
    """A row about the motion (about=1) or the sensor (about=2) of a robot."""
    model, cpd = made[0], made[about]
    attributes = {"cpd": cpd, "variable": cpd.child, "step": step}

    def call():
        infer(model, EVIDENCE, **(options or {}))

    return refusal(name, call, error, *words, **attributes)


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
        ("x", "function", "(2, 3, 2)", "(2, 3, 3)", "a[..., i]"),
        robot(drive=uneven),
    ),
    function_row(
        "a sensor without its axis",
        ModelError,
        ("z", "function", "(2, 3)", "(2, 3, 2)", "a[..., i]"),
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
        ("x", "jacobian", "x[t-1]", "(2, 3, 3, 2)", "(2, 3, 3, 3)"),
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

BEFORE_INFERENCE = CPDS + NETWORKS + FUNCTIONS + NOISES


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


# ---- graphs, schedules, and what is asked of a posterior

GRAPH = pgm.compile(robot()[0], steps=T)
FILTERED = pgm.filter(robot()[0], EVIDENCE)
SMOOTHED = pgm.smooth(robot()[0], EVIDENCE)


def graph_row(name, call, *words, **attributes):
    return refusal(name, call, GraphError, *words, **attributes)


def asked(name, call, *words, **attributes):
    return refusal(name, call, EvidenceError, *words, **attributes)


GRAPHS = [
    graph_row(
        "a family that its cluster lacks",
        lambda: check_families([(a, b), (b, c)], [[(a, b)], [(c, a)]]),
        "family preservation",
        "cluster 1",
        "(a)",
        variable=a,
        cluster=1,
    ),
    graph_row(
        "a family in no cluster",
        lambda: check_families([(a, b)], [[(a, b)]], families=[(a, b), (b,)]),
        "family preservation",
        "b",
        "0 clusters",
        variable=b,
    ),
    graph_row(
        "a family in two clusters",
        lambda: check_families([(a, b), (a, b)], [[(a, b)], [(a, b)]]),
        "family preservation",
        "2 clusters",
        variable=a,
    ),
    graph_row(
        "a variable in two parts",
        lambda: check_running_intersection([(a, b), (b,), (a, b)], {(0, 1): (b,), (1, 2): (b,)}),
        "running intersection",
        "a",
        "[0]",
        "[2]",
        "add it to the sepsets",
        variable=a,
    ),
    graph_row(
        "a variable around a loop",
        lambda: check_running_intersection(
            [(a,), (a,), (a,)], {(0, 1): (a,), (1, 2): (a,), (0, 2): (a,)}
        ),
        "running intersection",
        "a",
        "loop",
        "take it out",
        variable=a,
    ),
    graph_row(
        "a sepset with a stranger",
        lambda: check_running_intersection([(a, b), (b, c)], {(0, 1): (a,)}),
        "sepset",
        "a",
        "cluster 1",
        variable=a,
        cluster=1,
    ),
    graph_row("no steps", lambda: pgm.compile(robot()[0]), "steps=T", "None"),
    graph_row("negative steps", lambda: pgm.compile(robot()[0], -1), "steps=T", "-1"),
    graph_row("half a step", lambda: pgm.compile(robot()[0], 2.5), "steps=T", "2.5"),
    refusal("no network", lambda: pgm.compile(GRAPH, 3), ModelError, "network"),
    graph_row("a model for a graph", lambda: pgm.infer(robot()[0], EVIDENCE), "pgm.compile"),
    refusal("a graph for a model", lambda: pgm.filter(GRAPH, EVIDENCE), ModelError, "network"),
    graph_row("no such cluster", lambda: SMOOTHED.belief(T + 1), "0..4", "5", cluster=T + 1),
    graph_row("cluster -1", lambda: SMOOTHED.belief(-1), "0..4", "-1", cluster=-1),
    graph_row("no neighbours", lambda: SMOOTHED.message(1, 3), "1", "3", "not joined", cluster=1),
    graph_row("a message to itself", lambda: SMOOTHED.message(2, 2), "not joined", cluster=2),
    graph_row(
        "what a filter does not send",
        lambda: FILTERED.message(3, 2),
        "not sent",
        "is filtered",
        "3",
        "2",
        "pgm.smooth",
        cluster=3,
    ),
]

STATES = np.zeros((T + 1, 3))


def smooth(**options):
    return lambda: pgm.smooth(robot()[0], EVIDENCE, **options)


SCHEDULES = [
    model_row("no iterations", lambda: pgm.Smoothing(iterations=0), "iterations", "0", "1 or more"),
    model_row("no iterations of smooth", smooth(iterations=0), "iterations", "0", "1 or more"),
    model_row("half an iteration", lambda: pgm.Smoothing(iterations=1.5), "iterations", "1.5"),
    model_row("true iterations", lambda: pgm.Smoothing(iterations=True), "iterations", "True"),
    model_row("a negative tolerance", lambda: pgm.Smoothing(tolerance=-1.0), "tolerance", "-1"),
    model_row("no tolerance", lambda: pgm.Smoothing(tolerance=np.nan), "tolerance", "nan"),
    model_row(
        "a schedule in words",
        lambda: pgm.infer(GRAPH, EVIDENCE, schedule="smooth"),
        "smooth",
        "pgm.Smoothing()",
    ),
    model_row("a lineariser in words", smooth(lineariser="Taylor"), "Taylor", "pgm.Taylor()"),
    model_row(
        "a lineariser in words online",
        lambda: pgm.OnlineFilter(robot()[0], "Taylor"),
        "Taylor",
        "pgm.Taylor()",
    ),
    asked(
        "a start for a filter",
        lambda: pgm.infer(GRAPH, EVIDENCE, schedule=pgm.Filtering(), start={x: STATES}),
        "start",
        "smoothing",
    ),
    asked("a start without its variable", smooth(start=STATES), "start", "ndarray"),
    asked("an empty start", smooth(start={}), "start lacks x", variable=x),
    asked("a start of an input", smooth(start={x: STATES, u: U}), "u", "not hidden", variable=u),
    asked("a start of T rows", smooth(start={x: STATES[1:]}), "x", "4", "0..4", variable=x),
    asked("a start of 2 components", smooth(start={x: STATES[:, :2]}), "x", "(5, 2)", variable=x),
    asked("a start of NaN", smooth(start={x: STATES * np.nan}), "x", "NaN", variable=x),
    asked("a start of runs", smooth(start={x: np.zeros((3, T + 1, 3))}), "x", "(3", variable=x),
    refusal(
        "points without weight",
        smooth(lineariser=pgm.Unscented(alpha=1.0, kappa=-3.0)),
        LinearisationError,
        "kappa=-3.0",
        "positive",
    ),
    refusal("no samples", lambda: pgm.MonteCarlo(0), LinearisationError, "samples=0", "from 1"),
]

ASKED = [
    asked("an observed variable", lambda: SMOOTHED[z], "z", ".innovations[z]", variable=z),
    asked("one reading", lambda: SMOOTHED[z.at(2)], ".innovations", variable=z.at(2)),
    asked("an input", lambda: SMOOTHED[u], "u", "observed", variable=u),
    asked("a stranger", lambda: SMOOTHED[a], "a", "hidden", "x", variable=a),
    asked("the step before", lambda: SMOOTHED[x.previous], "x[t-1]", variable=x.previous),
    asked(
        "a step past the end",
        lambda: SMOOTHED[x.at(T + 1)],
        "x[5]",
        "0..4",
        variable=x.at(5),
        step=5,
    ),
    asked(
        "a prediction past the end",
        lambda: FILTERED.predicted[x.at(T + 1)],
        "x[5]",
        "0..4",
        variable=x.at(5),
        step=5,
    ),
    asked("a joint without steps", lambda: SMOOTHED.joint(x), "x.at(3)", variable=x),
    asked(
        "a joint with a reading", lambda: SMOOTHED.joint(x.at(1), z.at(1)), "z", variable=z.at(1)
    ),
    asked("a joint past the end", lambda: SMOOTHED.joint(x.at(1), x.at(9)), "x[9]", step=9),
]

TABLE = BEFORE_INFERENCE + DURING + GRAPHS + SCHEDULES + ASKED


@pytest.mark.parametrize("refused", TABLE, ids=lambda r: r.name)
def test_every_refusal(refused):
    refused.check()


@pytest.mark.parametrize("refused", BEFORE_INFERENCE, ids=lambda r: r.name)
def test_before_inference_functions_meet_no_data(refused):
    """At the most a trial call, whose leading axes are none of the evidence's."""
    CALLS.clear()
    refused.check()
    assert len(CALLS) <= 5
    assert all(argument.shape[:2] == (2, 3) for call in CALLS for argument in call)


# A rule is asked for its points when it meets a function: those rows are no part of this.
EARLY = [row for row in SCHEDULES if row.error is not LinearisationError]


@pytest.mark.parametrize("refused", EARLY, ids=lambda r: r.name)
def test_schedules_and_starts_are_refused_before_any_call(refused):
    CALLS.clear()
    refused.check()
    assert not CALLS


def test_kinds_of_errors():
    for kind in (ModelError, GraphError, EvidenceError, LinearisationError):
        assert issubclass(kind, pgm.PgmError)
        assert issubclass(kind, ValueError)
    assert issubclass(NumericalError, pgm.PgmError)
    assert issubclass(NumericalError, ArithmeticError)
    assert not issubclass(NumericalError, ValueError)


def test_the_robot_of_these_tests_runs():
    """Else the rows would say nothing."""
    assert pgm.smooth(robot()[0], EVIDENCE, iterations=2)[x].mean.shape == (T + 1, 3)
    GRAPH.check()


def test_whole_numbers_of_numpy_are_whole_numbers():
    """As in steps=step.max()."""
    steps = np.int64(T)
    assert pgm.smooth(robot()[0], EVIDENCE, steps=steps)[x].mean.shape == (T + 1, 3)
    assert pgm.compile(robot()[0], steps=steps).steps == T
    assert SMOOTHED.message(np.int64(1), np.int64(2)).scope == (x.at(1),)
    assert pgm.Smoothing(iterations=np.int64(2)).iterations == 2
