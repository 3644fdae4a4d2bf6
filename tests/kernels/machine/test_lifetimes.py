"""Machine code under garbage collection, threads and forks."""

import ctypes
import gc
import os
import threading
import weakref

import numpy as np
import pytest
from machine_code import elementwise

from pgm.kernels.machine.emitter.kinds import FLOAT
from pgm.kernels.machine.emitter.module import Module


def affine(factor):
    """Machine code of x ↦ factor x + sin x."""
    module = Module()
    code = module.function("affine", [FLOAT], FLOAT)
    (x,) = code.arguments
    code.give(x * factor + x.apply("sin"))
    return module.compile()


def value(factor, x):
    return x * factor + np.sin(x)


def test_a_callable_keeps_its_machine_code():
    machine = affine(3.0)
    alive, function = weakref.ref(machine), machine.callable("affine")
    del machine
    gc.collect()
    assert alive() is not None
    for factor in range(20):  # which would be written over it
        affine(float(factor))
    assert function(2.0) == pytest.approx(value(3.0, 2.0), rel=1e-15)
    del function
    gc.collect()
    assert alive() is None


def test_a_callable_passed_to_c_keeps_its_machine_code():
    function = affine(2.0).callable("affine")
    gc.collect()
    again = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(
        ctypes.cast(function, ctypes.c_void_p).value
    )
    assert again(1.0) == pytest.approx(value(2.0, 1.0), rel=1e-15)


def forked(child):
    """Whether a function is true in a forked child, which may take a minute."""
    place = os.fork()
    if not place:  # a child of pytest leaves without its ends
        try:
            os._exit(0 if child() else 1)
        finally:
            os._exit(2)
    done = threading.Timer(60.0, os.kill, (place, 9))
    done.start()
    _, status = os.waitpid(place, 0)
    done.cancel()
    return status == 0


needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="the platform has no fork")


@needs_fork
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_child_runs_and_compiles():
    function = affine(5.0).callable("affine")

    def child():
        own = affine(7.0).callable("affine")
        return np.isclose(function(2.0), value(5.0, 2.0)) and np.isclose(own(2.0), value(7.0, 2.0))

    assert forked(child)
    assert function(2.0) == pytest.approx(value(5.0, 2.0), rel=1e-15)


@pytest.mark.slow
@needs_fork
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_threads_compile_run_and_let_go_while_children_do_so_too():
    affine(1.0)  # a child that is forked while a thread imports waits for Python's own lock
    faults, over = [], threading.Event()

    def work(seed):
        rng, kept = np.random.default_rng(seed), []
        while not over.is_set():
            factor = float(rng.normal())
            kept.append((factor, affine(factor).callable("affine")))
            if len(kept) > 10:
                kept.pop(int(rng.integers(10)))
            x = float(rng.normal())
            faults.extend(own for own, f in kept if not np.isclose(f(x), value(own, x), rtol=1e-13))
            if rng.random() < 0.2:
                gc.collect()

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    try:
        for trial in range(25):
            factor = float(trial)
            assert forked(
                lambda own=factor: np.isclose(affine(own).callable("affine")(1.0), value(own, 1.0))
            )
    finally:
        over.set()
        for thread in threads:
            thread.join()
    assert not faults


@pytest.mark.slow
def test_long_arrays_in_threads():
    x = np.linspace(-50.0, 50.0, 400_000)
    function = elementwise(lambda _, x: x.apply("sin") * x.apply("exp"), 1, 8)
    due, found = function(x), [None] * 4

    def work(place):
        found[place] = function(x)

    threads = [threading.Thread(target=work, args=(place,)) for place in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for each in found:
        np.testing.assert_array_equal(each, due)


@pytest.mark.slow
def test_machine_code_let_go_takes_little_memory():
    resource = pytest.importorskip("resource", reason="the platform does not tell its memory")

    def peak():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    for _ in range(200):
        affine(1.5)
    before = peak()
    for _ in range(600):
        affine(1.5)
    assert peak() - before < 60_000  # KiB; llvmlite's pipelines of passes keep some 50 each
