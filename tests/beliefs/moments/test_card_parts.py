"""Runs that a card's memory does not hold together: swept in parts, with the same digits."""

import ctypes
from types import SimpleNamespace

import numpy as np
import pytest
from card import forget, needs_libdevice, with_a
from fake_driver import Driver
from numpy.testing import assert_array_equal
from robots import m, sighted
from zoo import MODELS, SIGHT, T, plain, recording

import pgm
from pgm.beliefs.moments.compiled.spans import ByRuns, spans_of
from pgm.kernels.machine.emitter import driver as drivers

needs_libdevice()
CARD = pgm.Compiled(device="cuda")


@pytest.fixture(autouse=True)
def forgotten():
    """No card of one test is that of another."""
    forget()
    yield
    forget()


def assert_same(one, other, model):
    for variable in model.states:
        assert_array_equal(one[variable].mean, other[variable].mean)
        assert_array_equal(one[variable].cov, other[variable].cov)
    assert_array_equal(one.log_evidence, other.log_evidence)


def in_parts(monkeypatch, share, model, evidence, steps, schedule, driver=Driver):
    """A call on a card that holds all runs, and on one with a share of the memory that it took."""

    def call():
        graph = pgm.compile(model.replace(), steps, compiled=CARD)
        return pgm.infer(graph, evidence, schedule=schedule)

    whole, taken = with_a(Driver(), monkeypatch), {}
    taken["whole"] = call()
    parts = with_a(driver(memory=int(share * whole.peak)), monkeypatch)
    taken["parts"] = call()
    assert_same(*taken.values(), model)
    assert len(parts.launched) > len(whole.launched)
    assert parts.peak <= parts.memory
    assert not parts.taken
    assert not parts.contexts
    return *taken.values(), parts


@pytest.mark.parametrize(
    "schedule",
    [
        pgm.Filtering(gate=0.9),
        pgm.Filtering(iterations=3, tolerance=1.0),
        pytest.param(pgm.FixedLag(2, iterations=2, tolerance=1.0), marks=pytest.mark.slow),
        pgm.Smoothing(),
    ],
)
def test_parts_have_the_digits_of_all(schedule, monkeypatch):
    model, evidence = plain(sensor=SIGHT.cpd(noise=None)), sighted(5, steps=2)
    whole, parts, _ = in_parts(monkeypatch, 0.5, model, evidence, 2, schedule)
    for one, other in zip(whole.status.residuals, parts.status.residuals, strict=True):
        assert_array_equal(one, other)
    if schedule.gate is not None:
        assert str(whole.rejected[SIGHT.z]) == str(parts.rejected[SIGHT.z])


def test_missing_components_and_noise_by_control(monkeypatch):
    name = "noise by control"
    in_parts(monkeypatch, 0.6, MODELS[name], recording(name), T, pgm.Filtering())


@pytest.mark.parametrize("turned", [False, True])
def test_evidence_lies_as_it_is_given(turned, monkeypatch):
    """Runs first, and runs from the last to the first, whose memory is not divided."""
    model = plain()
    evidence = {v: rows for v, rows in sighted(4, steps=2).items() if v in model.inputs}
    rng = np.random.default_rng(2)
    seen = rng.normal([3.0, 0.4], 0.1, (4, 2, 2))
    evidence[SIGHT.z] = pgm.sightings(
        seen[::-1] if turned else seen, step=[1, 2], given={m: np.full((2, 2), 3.0)}
    )
    in_parts(monkeypatch, 0.7, model, evidence, 2, pgm.Filtering())


def test_a_driver_that_takes_more_than_it_is_asked_for(monkeypatch):
    class Taking(Driver):
        def cuLaunchKernel(self, kernel, x, y, z, bx, by, bz, *rest):
            if x * bx > 128:
                return (2,)  # as for memory of threads, of which there is one for each
            return super().cuLaunchKernel(kernel, x, y, z, bx, by, bz, *rest)

    model, evidence = plain(), sighted(130, steps=1)
    schedule = pgm.Filtering()
    _, _, driver = in_parts(monkeypatch, 2.0, model, evidence, 1, schedule, Taking)
    assert set(driver.launched) == {(1, 128)}


def test_a_run_that_never_fits(monkeypatch):
    class Full(Driver):
        def cuMemAlloc(self, count):
            return 2, None

    driver = with_a(Full(), monkeypatch)
    with pytest.raises(pgm.ExecutorError, match=r"a single run's arrays take .* leave out device="):
        pgm.filter(plain(), sighted(3, steps=1), compiled=CARD)
    assert not driver.contexts


def test_lines_that_are_far_apart_are_copied_one_by_one(monkeypatch):
    monkeypatch.setattr(drivers, "_PITCH", 7)
    monkeypatch.setattr(Driver, "cuMemcpy2DUnaligned", None)
    in_parts(monkeypatch, 0.5, plain(), sighted(5, steps=2), 2, pgm.Filtering())


# How memory is divided


def test_blocks_of_many_layouts():
    """A part of each layout, moved as blocks are, is NumPy's slice of it."""
    runs = 7
    whole = np.arange(4.0 * 5 * 6 * runs * 2)
    by_step, by_run = whole.reshape(4, 5, 6, runs, 2), whole.reshape(runs, 40, 6)
    layouts = {
        "runs fastest": (by_step.reshape(4, 60, runs).transpose(0, 2, 1), 240),
        "vectors of runs": (whole.reshape(120, runs, 2), 120),
        "runs first": (by_run.swapaxes(0, 1), 1),
        "some of the components": (by_run[..., 1:3].swapaxes(0, 1), 1),
        "steps backwards": (by_run[:, ::-2].swapaxes(0, 1), 1),
        "matrices, runs fastest": (by_step[..., 0].transpose(0, 3, 1, 2), 120),
    }
    for name, (array, count) in layouts.items():
        (span,) = spans_of([array], runs)
        by_runs = span.by_runs
        assert by_runs.blocks == count, name
        first, last = 2, 6
        part = by_runs.of(last - first)
        memory = np.full(part.length // 8 + 1, np.nan)
        begin = span.first + first * by_runs.apart
        for k in range(by_runs.blocks):
            to = memory.ctypes.data + k * part.pitch
            ctypes.memmove(to, begin + k * by_runs.pitch, part.width)
        offset = array.__array_interface__["data"][0] - span.first
        strides = [
            each if axis == 1 else by_runs.moved(each, last - first)
            for axis, each in enumerate(array.strides)
        ]
        start = memory[by_runs.moved(offset, last - first) // 8 :]
        low = start.ctypes.data
        interface = {"shape": (len(array), last - first, *array.shape[2:]), "typestr": "<f8"}
        there = SimpleNamespace(
            __array_interface__={**interface, "data": (low, False), "strides": tuple(strides)}
        )
        assert_array_equal(np.asarray(there), array[:, first:last], name)


def test_memory_that_no_division_fits():
    runs = 7
    whole = np.zeros((4, runs, 6))
    assert spans_of([whole], runs)[0].by_runs == ByRuns(4, runs, 48, 48)
    assert spans_of([whole[:, :, :2]], runs)[0].by_runs == ByRuns(4, runs, 48, 16)
    for arrays in (
        [whole[:, ::-1]],  # from the last run to the first
        [whole[:, :1]],  # of one run
        [np.broadcast_to(whole[:, :1], whole.shape)],
        [whole, whole.reshape(-1)[:42].reshape(6, 7)],  # runs that are apart in two ways
        [whole, whole.ravel()],
        [whole, whole.reshape(4, 42)[:, 6:13]],
    ):
        assert spans_of(arrays, runs)[0].by_runs is None, arrays
