"""A function that changes between two calls, by whatever it refers to, counts as it is."""

import enum
import functools
import sys
import types
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm

MACHINE = pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed")
X = pgm.Variable("x")
SCALE, TABLE = 2.0, {"gain": 1.5}


class Base:
    rate = 1.0

    def gain(self):
        return 1.1

    def move(self, x):
        return self.rate * self.gain() * x


class Robot(Base):
    def __init__(self):
        self.dt, self.scale = 0.5, SCALE

    def again(self, x):
        return type(self)().scale * x

    def offset(self, x):
        return x + self.shift if hasattr(self, "shift") else x

    @property
    def twice(self):
        return 2.0 * self.dt

    def doubled(self, x):
        return self.twice * x


class Faster(Base):
    def gain(self):
        return 3.0


class Slots:
    __slots__ = ("dt",)

    def __init__(self):
        self.dt = 0.5


class Gain(float):
    def __mul__(self, other):
        return float(self) * SCALE * other


class Mode(enum.IntEnum):
    SLOW = 1

    @property
    def gain(self):
        return SCALE


@dataclass
class Named:
    name: str

    def __str__(self):
        return self.name


def attempt(robot):
    def function(x):
        try:
            return x + robot.shift
        except AttributeError:
            return x

    return function


def matched(known):
    def function(x):
        match known:
            case object(name="slow"):
                return x
        return 2.0 * x

    return function


def keywords(x, *, by=1.5):
    return by * x


def rescaled(function):
    return function, lambda patch: patch.setitem(globals(), "SCALE", 5.0)


def setting(known, use, name, value):
    return use(known), lambda patch: patch.setattr(known, name, value, raising=False)


def record():
    known = np.array([(0.5,)], dtype=[("dt", float)])[0]
    return lambda x: known["dt"] * x, lambda _: known.__setitem__("dt", 2.0)


def lazy():
    state, module = {"rate": 1.0}, types.ModuleType("lazy")
    module.__getattr__ = lambda name: state[name]
    return lambda x: module.rate * x, lambda _: state.update(rate=2.0)


def imported():
    name = "pgm_test_settings"
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].rate = 1.0

    def function(x):
        import pgm_test_settings

        return pgm_test_settings.rate * x

    return function, lambda _: setattr(sys.modules[name], "rate", 2.0)


def listed():
    known = [0.5]
    return lambda x: x + known[0], lambda _: known.__setitem__(0, 3.0)


def vectorized():
    known = [0.5]
    wrapped = np.vectorize(lambda x: x + known[0], signature="(n)->(n)")
    return wrapped, lambda _: known.__setitem__(0, 3.0)


def large():
    known = np.zeros(1000)
    return lambda x: x + known[7], lambda _: known.__setitem__(7, 2.0)


def partials():
    known = functools.partial(keywords, by=1.5)
    return known, lambda _: known.keywords.update(by=0.5)


def table():
    known = {"limit": 1.2}
    return (
        lambda x: np.where(x < known["limit"], x + 0.3, 0.5 * x),
        lambda _: known.update(limit=2.5),
    )


FAST = Named("fast")
GAIN, SLOW = Gain(2.0), Mode.SLOW
CHANGES = {
    "list": listed,
    "np.vectorize": vectorized,
    "large array": large,
    "keywords of a partial": partials,
    "limit in a table": table,
    "keyword's default": lambda: (
        keywords,
        lambda patch: patch.setattr(keywords, "__kwdefaults__", {"by": 0.5}),
    ),
    "global": lambda: rescaled(lambda x: SCALE * x),
    "attribute of a class": lambda: setting(Robot, lambda _: Robot().move, "rate", 2.0),
    "method of a class": lambda: setting(Robot, lambda _: Robot().move, "gain", lambda self: 2.0),
    "method of an object": lambda: setting(
        Robot(), lambda known: lambda x: known.gain() * x, "gain", lambda: 2.0
    ),
    "class of an object": lambda: setting(
        Base(), lambda known: lambda x: known.gain() * x, "__class__", Faster
    ),
    "attribute by a property": lambda: setting(Robot(), lambda known: known.doubled, "dt", 2.0),
    "slot": lambda: setting(Slots(), lambda known: lambda x: known.dt * x, "dt", 2.0),
    "attribute that is asked for": lambda: setting(
        Robot(), lambda known: known.offset, "shift", 2.0
    ),
    "attribute that is tried": lambda: setting(Robot(), attempt, "shift", 2.0),
    "object made by type": lambda: rescaled(Robot().again),
    "operator of a number": lambda: rescaled(lambda x: (GAIN * 1.0) * x),
    "property of a number": lambda: rescaled(lambda x: SLOW.gain * x),
    "record": record,
    "module's attributes by a function": lazy,
    "import": imported,
    "equality": lambda: setting(
        Named("slow"), lambda known: lambda x: 2.0 * x if known == FAST else x, "name", "fast"
    ),
    "text": lambda: setting(
        Named("slow"),
        lambda known: lambda x: 2.0 * x if str(known) == "fast" else x,
        "name",
        "fast",
    ),
    "match": lambda: setting(Named("slow"), matched, "name", "fast"),
    "eval": lambda: rescaled(lambda x: eval("SCALE") * x),
    "a table of a module": lambda: (
        lambda x: TABLE["gain"] * x,
        lambda patch: patch.setitem(TABLE, "gain", 0.5),
    ),
}


def pushed(function, steps=4):
    """Means of a chain without measurements."""
    means = [np.array([1.0])]
    for _ in range(steps):
        means.append(function(means[-1]))
    return np.array(means)


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_between_calls_counts(name, monkeypatch):
    function, change = CHANGES[name]()
    move = pgm.NonlinearGaussianCPD(X, X.previous, function, 0.1)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(X, 1.0, 0.01)], [move], [])
    graph = pgm.compile(model, 4)
    before = pgm.infer(graph, {}, schedule=pgm.Filtering())[X]
    assert_allclose(before.mean, pushed(function), rtol=1e-12)
    with monkeypatch.context() as patch:
        change(patch)
        found, due = pgm.infer(graph, {}, schedule=pgm.Filtering())[X], pushed(function)
    assert np.abs(due - before.mean).max() > 0.05
    assert_allclose(found.mean, due, rtol=1e-12)


@MACHINE
@pytest.mark.parametrize("name", ["list", "np.vectorize", "limit in a table", "eval"])
@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()])
@pytest.mark.parametrize("runs", [(), (9,)])
def test_a_change_counts_in_machine_code(name, rule, runs, monkeypatch):
    function, change = CHANGES[name]()
    move = pgm.NonlinearGaussianCPD(X, X.previous, function, 1e-6)
    prior = pgm.GaussianCPD(X, np.broadcast_to(1.0, (*runs, 1)), 1e-6)
    model = pgm.DynamicBayesianNetwork([prior], [move], [])
    graphs = [pgm.compile(model, 4, compiled=compiled) for compiled in (True, False)]
    for _ in range(2):
        found, due = (
            pgm.infer(graph, {}, schedule=pgm.Filtering(), lineariser=rule)[X] for graph in graphs
        )
        assert_allclose(found.mean, due.mean, rtol=1e-9)
        assert_allclose(found.cov, due.cov, rtol=1e-9)
        change(monkeypatch)


def test_a_change_counts_in_a_network_without_time():
    a, b = pgm.variables("a b")
    gain = [1.0]
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 2.0, 1.0),
            pgm.NonlinearGaussianCPD(b, a, lambda a: gain[0] * np.sin(a), 0.1),
        ]
    )
    graph = pgm.compile(net)
    for gain[0] in (1.0, 3.0):
        found = pgm.infer(graph, {})[b]
        assert_allclose(found.mean, [gain[0] * np.sin(2.0)], rtol=1e-12)
        assert_allclose(found.cov, [[(gain[0] * np.cos(2.0)) ** 2 + 0.1]], rtol=1e-12)


def test_a_function_that_was_disturbed_once_is_traced_again():
    """As by another thread that changes what it reads while it is called."""
    calls = 0

    def function(x):
        nonlocal calls
        calls += 1
        return x + (0.7 if calls == 3 else 0.0) + 0.1 * np.sin(x)

    move = pgm.NonlinearGaussianCPD(X, X.previous, function, 0.1)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(X, 1.0, 0.01)], [move], [])
    for _ in range(4):
        pgm.filter(model, {}, steps=5)
    assert dict(move.derivatives) == {X.previous: "traced"}
    assert move.derivatives.reason is None


def test_a_call_that_fails_leaves_the_traces_to_the_next():
    """Which else takes differences beside numbers just below infinity, and fails a step before."""
    broken = [False]

    def squared(x):
        if broken[0]:
            raise ArithmeticError("the wheel is off")
        return x**2

    def refusal(graph):
        with pytest.raises(pgm.PgmError) as found:
            pgm.infer(graph, {y: np.full((4, 1), np.nan)}, schedule=pgm.Filtering())
        return found.value.step, str(found.value)

    y = pgm.Variable("y")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, [1.79769313486e308**0.25], 1e-300)],
        [pgm.NonlinearGaussianCPD(X, (X.previous,), squared, cov=1e-200)],
        [pgm.LinearGaussianCPD(y, {X: 1.0}, cov=1.0)],
    )
    graph = pgm.compile(model, 4, compiled=False)
    first = refusal(graph)
    broken[0] = True
    assert "the wheel is off" in refusal(graph)[1]
    broken[0] = False
    assert refusal(graph) == first
    assert first[0] == 3


def test_a_function_that_draws_has_no_trace_for_more_and_more_calls():
    rng, calls = np.random.default_rng(0), 0

    def function(x):
        nonlocal calls
        calls += 1
        return x + 1e-3 * rng.normal(size=x.shape)

    move = pgm.NonlinearGaussianCPD(X, X.previous, function, 0.1)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(X, 1.0, 0.01)], [move], [])
    pgm.filter(model, {}, steps=5)
    assert move.derivatives[X.previous] == "numerical"
    assert "draws at random" in move.derivatives.reason
    for _ in range(64):
        pgm.filter(model, {}, steps=1)
    calls = 0
    for _ in range(32):
        pgm.filter(model, {}, steps=1)
    assert calls <= 32 * 3  # value, differences, and one comparison now and then
