"""A trace is made anew for very many points only where its function may have changed unseen."""

import math
import random
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import pgm
from models import motion
from pgm.tracing import Tracer
from pgm.tracing.reads import reads_of

rate, turn, box, names = 0.5, np.eye(2), [0.5], SimpleNamespace(rate=0.5)
wild = np.frompyfunc(lambda a: a + box[0], 1, 1)


def inner(a):
    return np.sin(a) + rate


def plain(a, scale=2.0):
    return np.stack([inner(a[..., 0]) * scale, abs(a[..., 1])], axis=-1)


def turned(a):
    return np.einsum("ij,...j->...i", turn, a)


def closed(value):
    return lambda a: a * value


def test_functions_of_numbers_and_of_numpy_are_known():
    for function in (plain, turned, closed(2.0), partial(plain, scale=2.0).func, np.sin, inner):
        assert reads_of(function).stand()
    assert reads_of(partial(lambda k, a: k * a, 2.0)).stand()
    assert reads_of(lambda a: a * math.pi + float(np.float64(2.0))).stand()


class Motion:
    rate = 0.5

    def move(self, a):
        return a + self.rate

    def __call__(self, a):
        return self.move(a)


@dataclass(frozen=True, slots=True)
class Turn:
    angle: float
    motion: Motion

    def by(self, a):
        return self.motion.move(np.cos(self.angle) * a)


class Listing(Motion):
    def __init__(self):
        self.others = [0.5]


class Adding(Motion):
    def __add__(self, other):
        return other + box[0]


class Computing(Motion):
    @property
    def rate(self):
        return box[0]


def by_module(a):
    return motion.velocity(a, a)


def storing(a):
    moving.rate = 0.5
    return a + moving.rate


moving = Motion()


def imports(a):
    from time import time

    return a + 0.0 * time()


def marked(a):
    return a + marked.rate


marked.rate = 0.5
held = partial(plain)
held.rate = 0.5


class Renewing:
    def __init__(self, a):
        self.moved = a + rate

    def move(self, a):
        return self.__class__(a).moved


@pytest.mark.parametrize(
    "function",
    [
        lambda a: a + box[0],
        lambda a: a + names.rate,
        lambda a: a + random.random(),
        lambda a: a + np.random.default_rng(0).normal() * names.rate,
        lambda a: a + Motion.rate,
        lambda a: a + eval("rate"),
        lambda a: a + np.random.default_rng().normal(),
        lambda a: a + np.load("rate.npy"),
        lambda a: a + motion.__dict__["rate"],
        lambda a: a + inner.__defaults__[0],
        lambda a: held(a) * held.rate,
        Renewing(0.0).move,
        lambda a: a + globals()["rate"],
        lambda a: wild(a),
        lambda a: [wild(b) for b in a],
        closed(box),
        closed(Adding()),
        Listing().move,
        Adding().move,
        Computing(),
        storing,
        closed(np.zeros(1000)),
        closed(np.zeros(2, dtype=object)),
        partial(plain, scale=2.0),
        np.vectorize(inner),
        imports,
        marked,
    ],
)
def test_functions_that_read_what_may_change_unseen_are_not(function):
    assert reads_of(function) is None


def _names(name, value):
    return lambda patch: patch.setitem(globals(), name, value)


@pytest.mark.parametrize(
    "change",
    [
        _names("rate", 0.25),
        _names("inner", np.cos),
        _names("abs", lambda a: a),
        lambda patch: patch.setattr(plain, "__defaults__", (3.0,)),
        lambda patch: patch.setattr(plain, "__code__", (lambda a, scale: a * scale).__code__),
        lambda patch: patch.setattr(inner, "__code__", (lambda a: a).__code__),
    ],
)
def test_a_change_is_seen(change, monkeypatch):
    reads = reads_of(plain)
    assert reads.stand()
    change(monkeypatch)
    assert not reads.stand()


@pytest.mark.parametrize(
    "change",
    [
        lambda patch, turn: patch.setattr(turn.motion, "rate", 0.25, raising=False),
        lambda patch, turn: patch.setattr(Motion, "rate", 0.25),
        lambda patch, turn: patch.setattr(Motion, "move", lambda self, a: a),
        lambda patch, turn: patch.setattr(Turn, "by", lambda self, a: a),
        lambda patch, turn: patch.setattr(Motion.move, "__code__", (lambda self, a: a).__code__),
        lambda patch, turn: patch.setattr(turn.motion, "move", np.sin, raising=False),
        lambda patch, turn: patch.setattr(turn.motion, "__class__", Adding),
        lambda patch, turn: object.__setattr__(turn, "angle", 0.25),
        lambda patch, turn: patch.setattr(turn.motion, "__dict__", {"rate": 0.25}),
        lambda patch, turn: patch.setattr(Motion, "__bool__", lambda self: False, raising=False),
    ],
)
def test_a_change_of_an_object_or_its_class_is_seen(change, monkeypatch):
    turn = Turn(0.5, Motion())
    assert reads_of(turn.by).stand()
    reads = reads_of(lambda a: turn.by(a))
    assert reads.stand()
    change(monkeypatch, turn)
    assert not reads.stand()


def test_a_change_in_a_module_is_seen(monkeypatch):
    reads = reads_of(by_module)
    assert reads.stand()
    monkeypatch.setattr(motion, "forward", 1.0, raising=False)
    assert reads.stand()
    monkeypatch.setattr(motion.planar, "move", lambda *_: 0.0)
    assert not reads.stand()


def test_a_module_that_begins_to_compute_its_attributes_is_seen(monkeypatch):
    computing = type("computing", (ModuleType,), {"planar": property(lambda self: box[0])})
    for name, value in (("__getattr__", box.index), ("__class__", computing)):
        reads = reads_of(by_module)
        assert reads.stand()
        with monkeypatch.context() as patch:
            patch.setattr(motion, name, value, raising=False)
            assert not reads.stand()


def test_a_function_that_has_the_name_of_a_library_is_known_for_itself(monkeypatch):
    monkeypatch.setattr(inner, "__module__", "numpy")
    reads = reads_of(lambda a: inner(a))
    assert reads.stand()
    monkeypatch.setitem(globals(), "rate", 0.25)
    assert not reads.stand()


def test_objects_that_are_called_are_known(monkeypatch):
    reads = reads_of(Motion())
    assert reads.stand()
    monkeypatch.setattr(Motion, "__call__", lambda self, a: a)
    assert not reads.stand()


def test_changes_of_cells_and_arrays_are_seen():
    value = 2.0

    def scaled(a):
        return value * a

    reads = reads_of(scaled)
    value = 3.0
    assert not reads.stand()
    reads = reads_of(turned)
    turn[0, 1] = 0.5
    assert not reads.stand()
    turn[0, 1] = 0.0
    assert reads.stand()


def test_a_trace_of_many_points_is_made_once(monkeypatch):
    made, tracing = [], import_module("pgm.tracing.trace")

    def counted(function, *rest):
        made.append(function)
        return trace(function, *rest)

    trace = tracing.trace
    monkeypatch.setattr(tracing, "trace", counted)
    centres = [np.ones(2)]
    known, open_ = (Tracer(f, (2,), np.zeros(2, dtype=bool)) for f in (plain, lambda a: a + box[0]))
    for _ in range(3):
        assert known.confirm(centres, anew=True)
        assert open_.confirm(centres, anew=True)
    assert made.count(plain) == 1
    assert len(made) == 4
    monkeypatch.setitem(globals(), "rate", 0.25)
    assert known.confirm(centres, anew=True)
    assert made.count(plain) == 2


@pytest.mark.parametrize("compiled", [False, True])
def test_a_branch_that_a_change_adds_far_from_all_samples_is_seen(compiled, monkeypatch):
    """At one of 5,000 runs: the points that are judged do not show it, a new trace does."""
    x, u, y = pgm.variables("x u y")
    motion = pgm.NonlinearGaussianCPD(x, (x.previous, u), jump, cov=0.1)
    prior, sensor = pgm.GaussianCPD(x, 0.0, 1.0), pgm.LinearGaussianCPD(y, {x: 1.0}, cov=0.1)
    model = pgm.DynamicBayesianNetwork([prior], [motion], [sensor])
    pushed = np.zeros((5000, 1, 1))
    pushed[1237] = 1.0
    for due in (1.0, 5.0):
        monkeypatch.setitem(globals(), "leap", due)
        given = {u: pushed, y: np.full((5000, 1, 1), np.nan)}
        found = pgm.filter(model, given, steps=1, compiled=compiled)
        np.testing.assert_allclose(found[x].mean[1237, 1], due)


leap = 1.0


def jump(x, u):
    return x + np.where(u > 0.5, leap, 0.0)
