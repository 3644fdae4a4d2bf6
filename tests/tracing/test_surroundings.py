"""What a function refers to is watched; what cannot be is not called known."""

import functools
import math
import random
import sys
import types
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import pytest
from numpy import stack

from models import motion, sensors
from pgm.tracing.surroundings import Surroundings

SCALE, POINTS, MANY = 2.0, np.arange(3.0), np.zeros(1000)
TABLE, PAIR = [1.0], (1.0, "a")
OWN = types.ModuleType("pgm_test_settings")
OWN.rate, OWN.other = 0.5, [1]
sys.modules["pgm_test_settings"] = OWN


@dataclass(frozen=True)
class Fixed:
    dt: float

    def __call__(self, x):
        return self.dt * SCALE * x


@dataclass(frozen=True)
class Helped:
    dt: float
    gain: ClassVar[float] = 2.0

    def __call__(self, x):
        return self._by(x)

    def _by(self, x):
        return self._times(x)

    def _times(self, x):
        return self.dt * self.gain * x

    def never(self, x):
        return TABLE[0] * x


def told(x):
    return told.rate * x


told.rate = 2.0


@dataclass
class Loose:
    dt: float

    def __call__(self, x):
        return self.dt * x


class Plain:
    def method(self, x):
        return x


class Robot:
    rate = 2.0

    def __init__(self):
        self.dt, self.log, self.wheel = 0.5, [], Loose(0.25)

    def move(self, x):
        return through(self, x) * self.rate

    def record(self, x):
        self.log.append(x)
        return x

    @property
    def twice(self):
        return 2.0 * self.dt

    @staticmethod
    def scaled(x):
        return SCALE * x

    def static(self, x):
        return self.scaled(x)

    @functools.cached_property
    def thrice(self):
        return 3.0 * SCALE * self.dt

    def tripled(self, x):
        return self.thrice * x

    def doubled(self, x):
        return self.twice * x


class Slots:
    __slots__ = ("dt",)

    def __init__(self):
        self.dt = 0.5

    def __call__(self, x):
        return self.dt * x


class Pair(NamedTuple):
    dt: float
    gain: float

    def times(self, x):
        return self.dt * self.gain * x


class Config:
    dt, log = 0.5, [1.0]


class Nearer(Config):
    pass


class Made:
    def __init__(self):
        self.dt = Nearer.dt

    def times(self, x):
        return self.dt * x


class Looked:
    def __init__(self):
        self.table = [1.0]

    def __getitem__(self, k):
        return self.table[k]


def through(robot, x):
    return robot.dt * robot.wheel.dt * x


ROBOT, SLOTS, BOTH, LOOKED = Robot(), Slots(), Pair(0.5, 2.0), Looked()


def inner(x, by=3.0):
    return stack([np.sin(x), math.pi * x]) * by


def imports(x):
    import pgm_test_settings

    return pgm_test_settings.rate * x


def closes(dt, also=None):
    def function(x):
        return [dt * each for each in (lambda: inner(x), lambda: also)]

    return function


SETTLED = {
    "README's": lambda x: np.where(x > 0.0, x, np.exp(x)) * SCALE,
    "models": motion.velocity,
    "models' class": motion.Velocity(0.5),
    "models' sensor": sensors.mounted(sensors.RANGE, (1.0, 2.0, 3.0)).function,
    "calls": lambda x: inner(x) + PAIR[0],
    "closure": closes(0.5),
    "frozen": Fixed(0.5),
    "method": Fixed(0.5).__call__,
    "helped": Helped(0.5),
    "helped method": Helped(0.5)._by,
    "partial": functools.partial(inner, by=2.0),
    "module": lambda x: OWN.rate * x,
    "array": lambda x: POINTS * x,
    "ufunc": np.sin,
    "mutable": Loose(0.5),
    "object": Plain().method,
    "closed over": closes(0.5, Plain()),
    "robot": ROBOT.move,
    "robot, to a helper": lambda x: through(ROBOT, x),
    "property": ROBOT.doubled,
    "cached property": ROBOT.tripled,
    "static method": ROBOT.static,
    "slots": SLOTS,
    "named tuple": lambda x: BOTH.times(x),
    "class": lambda x: Loose(1.0)(x),
    "constant of a class": lambda x: Config.dt * x,
    "made anew": lambda x: Made().times(x),
}
UNKNOWN = {
    "list": lambda x: x * TABLE[0],
    "large array": lambda x: x * MANY[0],
    "object with a list": ROBOT.record,
    "imports": imports,
    "operator": lambda x: LOOKED[0] * x,
    "frozen, that needs a list": Helped(0.5).never,
    "attribute of a function": told,
    "closed over": closes(0.5, [1.0]),
    "generator": lambda x: random.random() * x,
    "a list of a module": lambda x: OWN.other[0] * x,
    "eval": lambda x: eval("SCALE") * x,
    "a list of a class": lambda x: Config.log[0] * x,
}


@pytest.mark.parametrize("name", SETTLED)
def test_what_does_not_change_is_settled(name):
    found = Surroundings(SETTLED[name])
    assert found.known
    assert found.same()


@pytest.mark.parametrize("name", UNKNOWN)
def test_what_may_change_unseen_is_not(name):
    found = Surroundings(UNKNOWN[name])
    assert not found.known
    assert not found.same()


@pytest.mark.parametrize(
    ("name", "place", "attribute"),
    [
        ("README's", sys.modules[__name__], "SCALE"),
        ("frozen", sys.modules[__name__], "SCALE"),
        ("frozen", Fixed, "__call__"),
        ("helped", Helped, "gain"),
        ("helped", Helped, "_times"),
        ("helped method", Helped, "gain"),
        ("calls", inner, "__defaults__"),
        ("calls", inner, "__code__"),
        ("closure", inner, "__defaults__"),
        ("models", motion.velocity.__globals__["planar"], "move"),
        ("module", OWN, "rate"),
        ("robot", ROBOT, "dt"),
        ("robot", ROBOT.wheel, "dt"),
        ("robot", ROBOT, "rate"),
        ("robot", Robot, "rate"),
        ("robot, to a helper", ROBOT, "wheel"),
        ("robot, to a helper", ROBOT.wheel, "dt"),
        ("property", ROBOT, "dt"),
        ("property", Robot, "twice"),
        ("cached property", sys.modules[__name__], "SCALE"),
        ("cached property", Robot, "thrice"),
        ("static method", sys.modules[__name__], "SCALE"),
        ("slots", SLOTS, "dt"),
        ("named tuple", sys.modules[__name__], "BOTH"),
        ("named tuple", Pair, "times"),
        ("class", Loose, "__call__"),
        ("class", Loose.__init__, "__defaults__"),
        ("constant of a class", Config, "dt"),
        ("made anew", Nearer, "dt"),
        ("made anew", Config, "dt"),
        ("made anew", Made, "__init__"),
        ("made anew", Made, "times"),
    ],
)
def test_a_change_is_seen(name, place, attribute, monkeypatch):
    found = Surroundings(SETTLED[name])
    assert found.same()
    new = (lambda x: x).__code__ if attribute == "__code__" else (4.0,)
    with monkeypatch.context() as patch:
        patch.setattr(place, attribute, new)
        assert not found.same()
    assert found.same()


def test_a_closure_and_an_array_are_seen():
    dt, points = 0.5, np.ones(3)
    found = Surroundings(lambda x: dt * points * x)
    assert found.same()
    points[1] = 2.0
    assert not found.same()
    points[1] = 1.0
    assert found.same()
    dt = 0.25
    assert not found.same()


def test_a_variable_without_a_value_is_seen_when_it_has_one():
    found = Surroundings(lambda x: x if x.ndim else later)
    assert found.same()
    later = 1.0
    assert not found.same()
