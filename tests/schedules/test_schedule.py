"""Schedules refuse what is no number; a status is immutable and keeps its record."""

import copy
import pickle
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest

import pgm
from pgm.schedules.schedule import Loopy

LOOPY = (pgm.Flooding, pgm.Sequential, pgm.Residual)
TREES = (pgm.Calibration, pgm.Smoothing, pgm.Filtering)
ODD = ["a", None, 1j, True, [0.5], (), np.array([0.1, 0.2])]


@pytest.mark.parametrize("odd", ODD, ids=repr)
@pytest.mark.parametrize(
    ("kind", "argument", "words"),
    [
        *((kind, "damping", "damping is the share") for kind in LOOPY),
        *((kind, "tolerance", "a tolerance must be 0 or more") for kind in (*LOOPY, *TREES)),
        *((kind, "iterations", "iterations must be a whole number") for kind in LOOPY),
        *((kind, "iterations", "iterations, which count") for kind in TREES),
    ],
)
def test_what_is_no_number_is_refused(kind, argument, words, odd):
    with pytest.raises(pgm.ModelError, match=words) as caught:
        kind(**{argument: odd})
    assert str(caught.value).startswith(f"{kind.__name__}(")
    assert str(caught.value).endswith(f"not {odd!r}")


def test_smooth_refuses_it_too():
    x = pgm.Variable("x")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)], [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1.0)]
    )
    with pytest.raises(pgm.ModelError, match="a tolerance must be 0 or more, not 'tight'"):
        pgm.smooth(model, {}, steps=2, tolerance="tight")


@dataclass(frozen=True)
class Thorough(pgm.Smoothing):
    iterations: int = 5


@dataclass(frozen=True)
class Hasty(pgm.Flooding):
    tolerance: float = 1e-3


def test_a_subclass_is_run_as_its_base():
    x = pgm.Variable("x")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)],
        [pgm.NonlinearGaussianCPD(x, x.previous, lambda x: x + 0.1 * np.sin(x), 1.0)],
    )
    graph = pgm.compile(model, 3)
    own, plain = (
        pgm.infer(graph, {}, schedule=schedule) for schedule in (Thorough(), pgm.Smoothing(5))
    )
    assert own.status.iterations == plain.status.iterations > 1
    assert np.array_equal(own[x].mean, plain[x].mean)
    tree = pgm.compile(pgm.BayesianNetwork([pgm.GaussianCPD(x, 0.0, 1.0)]))
    assert pgm.infer(tree, {}, schedule=Hasty()).status.converged
    with pytest.raises(pgm.ModelError, match=r"pgm.Filtering\(\), .* not Hasty"):
        pgm.infer(graph, {}, schedule=Hasty())


@dataclass(frozen=True)
class Blocks(pgm.Filtering):
    size: int = 4


@dataclass(frozen=True)
class Gentle(pgm.Smoothing):
    share: float = 0.5


class Late(pgm.FixedLag):
    def __init__(self, lag, wait):
        super().__init__(lag)
        object.__setattr__(self, "wait", wait)


@dataclass(frozen=True, slots=True)
class Slotted(pgm.Filtering):
    size: int = 0


class Cached(pgm.Filtering):
    @cached_property
    def twice(self):
        return 2 * self.iterations


def test_what_a_schedule_keeps_for_itself_is_no_option():
    schedule = Cached()
    assert schedule.twice == 2
    x = pgm.Variable("x")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)], [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1.0)]
    )
    assert pgm.infer(pgm.compile(model, 2), {}, schedule=schedule).kind.lag == 0


def test_a_residual_has_no_turns():
    class Turned(pgm.Residual):
        def turns(self, messages):
            return [range(len(messages))]

    x = pgm.Variable("x")
    tree = pgm.compile(pgm.BayesianNetwork([pgm.GaussianCPD(x, 0.0, 1.0)]))
    with pytest.raises(pgm.ModelError, match=r"the order of a Residual follows .* pgm\.Loopy"):
        pgm.infer(tree, {}, schedule=Turned())


@pytest.mark.parametrize(
    "schedule",
    [Blocks(), Gentle(), Late(2, 3), Late(0, 3), Slotted(size=4)],
    ids=["a", "b", "c", "d", "e"],
)
@pytest.mark.parametrize("way", ["chain", "particles", "online", "static"])
def test_a_schedule_whose_options_nobody_knows_is_not_run_as_its_base(schedule, way):
    x = pgm.Variable("x")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)], [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1.0)]
    )
    graph, tree = pgm.compile(model, 3), pgm.compile(pgm.BayesianNetwork(model.prior))
    ways = {
        "chain": lambda: pgm.infer(graph, {}, schedule=schedule),
        "particles": lambda: pgm.infer(graph, {}, schedule=schedule, belief=pgm.Particles(9)),
        "online": lambda: pgm.OnlineFilter(model, schedule=schedule),
        "static": lambda: pgm.infer(tree, {}, schedule=schedule),
    }
    with pytest.raises(pgm.PgmError) as caught:
        ways[way]()
    smoother = isinstance(schedule, pgm.Smoothing)
    if way != ("online" if smoother else "static"):
        assert "which" in str(caught.value)
        assert any(name in str(caught.value) for name in (" size,", " share,", " wait,"))


def test_a_schedule_without_an_order_is_none():
    x = pgm.Variable("x")
    tree = pgm.compile(pgm.BayesianNetwork([pgm.GaussianCPD(x, 0.0, 1.0)]))
    with pytest.raises(pgm.ModelError, match=r"Loopy.* is no schedule"):
        pgm.infer(tree, {}, schedule=Loopy())


def test_numpys_numbers_are_numbers():
    assert pgm.Flooding(np.int64(7), np.float32(0.5), np.float64(0.25)) == pgm.Flooding(
        7, 0.5, 0.25
    )
    assert pgm.Flooding(tolerance=0, damping=0) == pgm.Flooding(1000, 0.0, 0.0)
    assert pgm.Calibration(tolerance=np.inf).tolerance == np.inf


def test_all_schedules_take_the_same_numbers_in_the_same_order():
    for kind in (*LOOPY, *TREES):
        made = kind(3, 1e-5)
        assert (made.iterations, made.tolerance) == (3, 1e-5)
    for kind in (*LOOPY, *TREES):
        assert kind(3, 1e-5, 0.5).damping == 0.5


WAYS = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda value: pickle.loads(pickle.dumps(value)),
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_a_status_is_immutable_and_so_are_its_copies(way):
    edges = {(0, 1): np.array(1e-12)}
    status = pgm.results.Status(3, np.array([1.0, 0.5, 1e-12]), np.array(True), edges)
    edges.clear()
    for one in (status, way(status)):
        assert one.iterations == 3
        assert list(one.by_edge) == [(0, 1)]
        np.testing.assert_array_equal(one.residuals, [1.0, 0.5, 1e-12])
        with pytest.raises(AttributeError, match="a Status is immutable; make a new one"):
            one.iterations = 4
        with pytest.raises(TypeError):
            one.by_edge[0, 1] = 0.0
        for array in (one.residuals, one.converged):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
    assert dict(pgm.results.Status(1, np.empty(0), np.array(True)).by_edge) == {}
