"""Changes that no name or value of a function shows: seen, or not called known."""

import enum
import functools
import sys
import types
from dataclasses import dataclass

import numpy as np
import pytest

from pgm.tracing import Tracer
from pgm.tracing.surroundings import Surroundings

SCALE = 2.0


class Base:
    rate = 1.0

    def gain(self):
        return 1.0

    def move(self, x):
        return self.rate * self.gain() * x


class Robot(Base):
    def __init__(self):
        self.dt, self.scale = 0.5, SCALE

    def again(self, x):
        return type(self)().scale * x

    def anew(self, x):
        return self.__class__().scale * x

    def offset(self, x):
        return x + self.shift if hasattr(self, "shift") else x


class Faster(Base):
    def gain(self):
        return 3.0


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


class Proxy:
    __class__ = property(lambda self: float)

    def __float__(self):
        return self.value


class Tagged(np.ndarray):
    pass


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


def late(x):
    from pgm_test_late import rate

    return rate * x


@functools.wraps(np.linalg.norm)
def norm(x):
    return SCALE * x


def rescaled(function):
    return function, lambda patch: patch.setitem(globals(), "SCALE", 5.0)


def setting(known, use, name, value):
    return use(known), lambda patch: patch.setattr(known, name, value, raising=False)


def record():
    known = np.array([(0.5,)], dtype=[("dt", float)])[0]
    return lambda x: known["dt"] * x, lambda _: known.__setitem__("dt", 2.0)


def shape():
    known = np.arange(4.0)
    return lambda x: known[-1] * x if known.ndim == 1 else x, lambda _: known.resize(2, 2)


def masked():
    known = np.ma.array([1e20, 2.0], mask=[False, False])
    return lambda x: float(known.sum()) * x, lambda _: known.__setitem__(0, np.ma.masked)


def lazy():
    state, module = {"rate": 1.0}, types.ModuleType("lazy")
    module.__getattr__ = lambda name: state[name]
    return lambda x: module.rate * x, lambda _: state.update(rate=2.0)


def loaded():
    def change(_):
        sys.modules["pgm_test_late"].rate = 2.0

    sys.modules["pgm_test_late"] = types.ModuleType("pgm_test_late")
    sys.modules["pgm_test_late"].rate = 1.0
    return late, change


def equal(use):
    def made():
        known = Named("slow")
        return use(known), lambda _: setattr(known, "name", "fast")

    return made


def by_alias():
    known, look = Robot(), getattr
    return lambda x: look(known, "dt") * x, lambda _: setattr(known, "dt", 2.0)


def inside():
    known = np.zeros(1, dtype=[("held", object)])
    known["held"][0] = [1.0]
    held = known["held"][0]
    return lambda x: known["held"][0][0] * x, lambda _: held.__setitem__(0, 2.0)


def calls(robot):
    return lambda x: robot.gain() * x


FAST = Named("fast")
GAIN, SLOW, PROXY, TAGGED = Gain(2.0), Mode.SLOW, Proxy(), np.ones(2).view(Tagged)
PROXY.value, TAGGED.unit = 1.0, 1.0
CHANGES = {
    "attribute of a class between": lambda: setting(Robot, lambda _: Robot().move, "rate", 2.0),
    "method of a class between": lambda: setting(
        Robot, lambda _: Robot().move, "gain", lambda self: 2.0
    ),
    "method of an object": lambda: setting(Robot(), calls, "gain", lambda: 2.0),
    "class of an object": lambda: setting(Base(), calls, "__class__", Faster),
    "attributes of an object": lambda: setting(
        Robot(), lambda known: lambda x: known.dt * x, "__dict__", {"dt": 2.0}
    ),
    "attribute that is asked for": lambda: setting(
        Robot(), lambda known: known.offset, "shift", 2.0
    ),
    "attribute that is tried": lambda: setting(Robot(), attempt, "shift", 2.0),
    "object made by type": lambda: rescaled(Robot().again),
    "object made by __class__": lambda: rescaled(Robot().anew),
    "operator of a number": lambda: rescaled(lambda x: (GAIN * 1.0) * x),
    "property of a number": lambda: rescaled(lambda x: SLOW.gain * x),
    "a proxy": lambda: setting(PROXY, lambda known: lambda x: float(known) * x, "value", 2.0),
    "wraps NumPy's": lambda: rescaled(lambda x: norm(x)),
    "attribute of an array": lambda: setting(
        TAGGED, lambda known: lambda x: known.unit * x, "unit", 2.0
    ),
    "record": record,
    "shape": shape,
    "mask": masked,
    "module's attributes by a function": lazy,
    "import": loaded,
    "equality": equal(lambda known: lambda x: 2.0 * x if known == FAST else x),
    "membership": equal(lambda known: lambda x: 2.0 * x if known in (FAST,) else x),
    "text": equal(lambda known: lambda x: 2.0 * x if str(known) == "fast" else x),
    "match": equal(matched),
    "getattr by another name": by_alias,
    "objects in an array": inside,
    "globals of a function": lambda: rescaled(lambda x: norm.__globals__["SCALE"] * x),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_is_not_taken_for_none(name, monkeypatch):
    function, change = CHANGES[name]()
    found, x = Surroundings(function), np.array([1.5, 2.5])
    before = function(x)
    with monkeypatch.context() as patch:
        change(patch)
        assert not found.same()
        assert not np.array_equal(function(x), before)


def test_functions_of_many_functions_are_not_followed_to_the_end():
    function = np.sin
    for _ in range(400):
        function = (lambda inner: lambda x: inner(x))(function)
    assert function(0.0) == 0.0
    assert not Surroundings(function).known


def test_no_thread_trusts_a_trace_while_another_is_made(monkeypatch):
    scale, told, module = 1.0, [], sys.modules["pgm.tracing.trace"]
    make, tracer = module.trace, Tracer(lambda x: scale * x, (1,), np.array([False]))

    def looked(*arguments):
        told.append(tracer.settled())
        return make(*arguments)

    monkeypatch.setattr(module, "trace", looked)
    for scale in (1.0, 2.0):  # noqa: B007
        assert tracer.confirm([np.zeros(1)])
        assert tracer.settled()
    assert told == [False, False]
