"""Progress of what takes long: what is counted, and where bars are shown."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import pgm
from pgm.progress import counted, reporting

ROOT = Path(__file__).parents[1]
T = 9
x = pgm.Variable("x")
z = pgm.Variable("z")
MODEL = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
    transition=[pgm.NonlinearGaussianCPD(x, x.previous, np.sin, cov=0.1)],
    observation=[pgm.LinearGaussianCPD(z, given={x: 1.0}, cov=0.5)],
)
EVIDENCE = {z: np.linspace(-1, 1, T)[:, None]}
RUNS = {z: np.random.default_rng(0).normal(size=(5000, T, 1))}
GRID = pgm.Grid({"x": (-4, 4, 80)})
CLOUD = pgm.Particles(200, seed=1)
sick, tested = (pgm.Discrete(name, states=("no", "yes")) for name in ("sick", "tested"))
HIDDEN = pgm.DynamicBayesianNetwork(
    prior=[pgm.TableCPD(sick, table=[0.9, 0.1])],
    transition=[pgm.TableCPD(sick, given=sick.previous, table=[[0.9, 0.1], [0.3, 0.7]])],
    observation=[pgm.TableCPD(tested, given=sick, table=[[0.8, 0.2], [0.1, 0.9]])],
)
a, b, c = pgm.variables("a b c")
LOOP = pgm.ClusterGraph(
    pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, given={a: 0.5}, cov=1.0),
            pgm.LinearGaussianCPD(c, given={a: 0.3, b: 0.2}, cov=1.0),
        ]
    ),
    [{a, b, c}, {a}, {b}, {c}, {a, b}],
    sepsets={(0, 1): {a}, (0, 2): {b}, (0, 3): {c}, (1, 4): {a}, (2, 4): {b}},
)


def stages(call):
    """The totals of the stages that a call reports; each is counted one by one, from zero."""
    told = []
    call(lambda done, total: told.append((done, total)))
    starts = [k for k, (done, _) in enumerate(told) if done == 0]
    found = []
    for first, end in pairwise([*starts, len(told)]):
        counts, totals = zip(*told[first:end], strict=True)
        assert counts == tuple(range(len(counts)))
        assert len(set(totals)) == 1
        assert counts[-1] <= totals[0]
        found.append((counts[-1], totals[0]))
    return found


@pytest.mark.parametrize(
    ("call", "due"),
    [
        (lambda p: pgm.filter(MODEL, EVIDENCE, progress=p), [(T + 1, T + 1)]),
        (lambda p: pgm.filter(MODEL, EVIDENCE, iterations=3, progress=p), [(T + 1, T + 1)]),
        (lambda p: pgm.smooth(MODEL, EVIDENCE, lag=2, progress=p), [(T + 1, T + 1)]),
        (
            lambda p: pgm.smooth(MODEL, EVIDENCE, lag=2, iterations=2, tolerance=0, progress=p),
            [(T + 1, T + 1)],
        ),
        (lambda p: pgm.filter(MODEL, EVIDENCE, keep=[x], progress=p), [(T + 1, T + 1)]),
        (lambda p: pgm.filter(MODEL, EVIDENCE, belief=GRID, progress=p), [(T + 1, T + 1)]),
        (
            lambda p: pgm.smooth(MODEL, EVIDENCE, belief=GRID, progress=p),
            [(T + 1, T + 1), (T, T)],
        ),
        (
            lambda p: pgm.filter(MODEL, {z: RUNS[z][:3]}, belief=GRID, progress=p),
            [(3, 3)],
        ),
        (
            lambda p: pgm.smooth(MODEL, EVIDENCE, belief=CLOUD, progress=p),
            [(T + 1, T + 1), (T, T)],
        ),
        (
            lambda p: pgm.smooth(HIDDEN, {tested: [1] * 6 + [-1]}, progress=p),
            [(7, 7)],  # of one state variable step 0 is no step of the loop
        ),
        (
            lambda p: pgm.filter(HIDDEN, {tested: [1] * 100}, progress=p),
            [(10, 10), (10, 10)],  # ten blocks of ten steps, side by side: what each does, then all
        ),
        (lambda p: pgm.smooth(HIDDEN, {tested: [[1] * 100] * 3}, lag=2, progress=p), [(100, 100)]),
        (
            lambda p: pgm.most_probable(pgm.compile(HIDDEN, 6), {tested: [1] * 6}, progress=p),
            [(7, 7), (6, 6)],
        ),
        (
            lambda p: pgm.compare(MODEL, EVIDENCE, oracle=GRID, progress=p),
            [(T + 1, T + 1), (T, T), (6, 6)],
        ),
        (
            lambda p: pgm.audit(
                pgm.smooth(MODEL, {z: RUNS[z][:300]}), samples=100, rng=0, progress=p
            ),
            None,
        ),
        (lambda p: pgm.infer(LOOP, {}, schedule=pgm.Flooding(), progress=p), None),
        (lambda p: pgm.filter(MODEL, RUNS, keep=[x], progress=p), None),
    ],
)
def test_the_outermost_loop_is_counted(call, due):
    found = stages(call)
    if due is None:
        assert len(found) == 1
        assert found[0][1] > 1
    else:
        assert found == due


def test_iterations_are_counted_after_the_first_sweep():
    *first, again = stages(lambda p: pgm.smooth(MODEL, EVIDENCE, iterations=30, progress=p))
    assert first == [(T + 1, T + 1), (T, T)]
    assert again[1] == 29
    assert 1 < again[0] < 29  # settled before


def test_the_parts_of_an_executor_are_counted():
    with ThreadPoolExecutor(2) as workers:
        (parts,) = stages(lambda p: pgm.filter(MODEL, RUNS, keep=[x], executor=workers, progress=p))
    assert parts[0] == parts[1] > 1


def test_results_are_those_without():
    plain = pgm.smooth(MODEL, EVIDENCE, iterations=30)
    told = pgm.smooth(MODEL, EVIDENCE, iterations=30, progress=lambda done, total: None)
    assert_array_equal(plain[x].mean, told[x].mean)
    assert plain.log_evidence == told.log_evidence


def test_an_error_ends_the_call_and_the_report():
    class Enough(Exception):
        pass

    calls = []

    def stop(done, total):
        calls.append(done)
        if done == 4:
            raise Enough

    with pytest.raises(Enough):
        pgm.filter(MODEL, EVIDENCE, progress=stop)
    assert calls == [0, 1, 2, 3, 4]
    pgm.filter(MODEL, EVIDENCE)
    assert calls == [0, 1, 2, 3, 4]
    for evidence in ([1] * 7, [[1] * 100] * 3, [1] * 100):
        calls.clear()
        with pytest.raises(Enough):
            pgm.smooth(HIDDEN, {tested: evidence}, progress=stop)
        assert calls == [0, 1, 2, 3, 4]


def test_an_error_within_leaves_no_report_behind():
    def fails(x):
        raise RuntimeError

    told = []
    broken = MODEL.replace(transition=[pgm.NonlinearGaussianCPD(x, x.previous, fails, cov=0.1)])
    with pytest.raises(pgm.ModelError) as kept:
        pgm.filter(broken, EVIDENCE, progress=lambda *numbers: told.append(numbers))
    before = list(told)
    pgm.filter(MODEL, EVIDENCE)
    del kept
    pgm.filter(MODEL, EVIDENCE)
    assert told == before


@pytest.mark.parametrize("wrong", [3, "bar", None, int])
def test_no_progress(wrong):
    calls = [
        lambda: pgm.filter(MODEL, EVIDENCE, progress=wrong),
        lambda: pgm.smooth(MODEL, EVIDENCE, progress=wrong),
        lambda: pgm.infer(LOOP, {}, schedule=pgm.Flooding(), progress=wrong),
        lambda: pgm.compare(MODEL, EVIDENCE, progress=wrong),
        lambda: pgm.audit(pgm.smooth(MODEL, EVIDENCE), rng=0, progress=wrong),
    ]
    for call in calls:
        with pytest.raises(pgm.ModelError, match=r"progress= is True, for a bar, or a function"):
            call()


def test_without_a_report_a_loop_has_its_own_items():
    items = range(5)
    assert counted(items, "steps") is items
    with reporting(False):
        assert counted(items, "steps") is items
    with reporting(lambda done, total: None):
        assert counted(range(1), "one") == range(1)
        for _ in counted(items, "outer"):
            assert counted(items, "inner") is items
        assert counted(items, "again") is not items


PROGRAM = """
import sys
from tests.test_progress import EVIDENCE, MODEL, pgm
assert "tqdm" not in sys.modules
pgm.smooth(MODEL, EVIDENCE, iterations=9, progress=True)
assert "tqdm" in sys.modules
"""


def test_nothing_is_shown_where_there_is_no_terminal():
    run = subprocess.run([sys.executable, "-c", PROGRAM], cwd=ROOT, capture_output=True, check=True)
    assert (run.stdout, run.stderr) == (b"", b"")


def test_bars_are_shown_in_a_notebook():
    """Without its widgets, as text."""
    kernel = "import sys, types; sys.modules['ipykernel.zmqshell'] = types.ModuleType('kernel')\n"
    program = [sys.executable, "-c", kernel + PROGRAM]
    run = subprocess.run(program, cwd=ROOT, capture_output=True, check=True)
    assert b"forward" in run.stderr
    assert run.stdout == b""


def test_bars_are_shown_on_a_terminal():
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    termios = pytest.importorskip("termios")
    termios.tcsetwinsize(theirs, (24, 80))
    run = subprocess.run([sys.executable, "-c", PROGRAM], cwd=ROOT, stderr=theirs, check=True)
    shown = os.read(ours, 100_000).decode()
    os.close(ours)
    os.close(theirs)
    assert run.returncode == 0
    assert "forward" in shown
    assert f"{T + 1}/{T + 1}" in shown
    assert "linearisations" in shown
