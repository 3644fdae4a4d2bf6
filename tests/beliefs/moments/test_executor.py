"""Executors share the runs, and change no result."""

import os
import pickle
import signal
import threading
import time
import warnings
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context, parent_process

import numpy as np
import pytest
from crossed import crossed, slow_after
from numpy.testing import assert_allclose, assert_array_equal
from robots import LANDMARKS, P0, SENSORS, controls, drive_along, drive_cpd, m, network, u, x

import pgm
from models import discrete
from pgm.beliefs.moments.parts import split as parts
from pgm.beliefs.moments.parts.join import one_status
from pgm.posteriors.status import CLOSE_POINTS, FAR_APART, Status
from pgm.workers.shared_memory import idle_blocks

RUNS, T = 23, 8
SIGHT = SENSORS["range_bearing"]
z = SIGHT.z


def elsewhere():
    """Whether this is a worker's process."""
    return parent_process() is not None


class Remote(Executor):
    """Workers who share nothing with their caller: all that goes to and fro is bytes."""

    def __init__(self):
        self.handed = 0

    def submit(self, fn, /, *args, **kwargs):
        self.handed += 1
        call, future = pickle.loads(pickle.dumps((fn, args, kwargs))), Future()
        try:
            future.set_result(pickle.loads(pickle.dumps(call[0](*call[1], **call[2]))))
        except Exception as error:
            future.set_exception(error)
        return future


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    """Make parts of five runs at the most."""
    monkeypatch.setattr(parts, "MOST", 5)


@pytest.fixture(scope="module")
def workers():
    with (
        ThreadPoolExecutor(2) as threads,
        ProcessPoolExecutor(2, get_context("fork")) as forked,
    ):
        yield {"threads": threads, "processes": forked, "remote": Remote()}


KINDS = ["threads", "processes", "remote"]


def recording(command=u, lead=(RUNS,), seed=5):
    rng = np.random.default_rng(seed)
    commands = controls(rng, T)
    states = drive_along(commands, rng)
    step = np.array([0, 2, 2, 3, 5, 8])
    marks = LANDMARKS[[0, 1, 2, 0, 1, 2]]
    read = SIGHT.draw(np.broadcast_to(states[step], (*lead, 6, 3)), marks, rng)
    read[..., 1, :][rng.random(lead) < 0.3] = np.nan
    own = commands + 0.01 * rng.normal(size=(*lead, T, 2))
    return {command: own, z: pgm.sightings(read, step=step, given={m: marks})}


def same(one, other):
    for part in ("predicted", "filtered"):
        assert_allclose(getattr(one, part)[x].mean, getattr(other, part)[x].mean, atol=1e-11)
    assert_allclose(one[x].mean, other[x].mean, atol=1e-11)
    assert_allclose(one[x].cov, other[x].cov, atol=1e-12)
    assert_allclose(one.log_evidence, other.log_evidence, atol=1e-11)
    assert (one.kind, one.log_evidence_kind) == (other.kind, other.log_evidence_kind)
    assert one.status.iterations == other.status.iterations
    assert_array_equal(one.status.converged, other.status.converged)
    for name in ("residual", "cov", "step", "nis", "dof"):
        ours, theirs = (getattr(each.innovations[z], name) for each in (one, other))
        assert_allclose(ours, theirs, rtol=1e-8, atol=1e-11)
    ours, theirs = one.joint(x.at(7), x.at(2)), other.joint(x.at(7), x.at(2))
    assert_allclose(ours.mean, theirs.mean, atol=1e-11)
    assert_allclose(ours.cov, theirs.cov, atol=1e-12)
    for ask in (
        lambda each: each.message(3, 4),
        lambda each: each.belief(5),
        lambda each: each.message(4, 3),
    ):
        try:
            theirs = ask(other)
        except pgm.GraphError:  # a filter has sent none backward
            with pytest.raises(pgm.GraphError, match="was not sent"):
                ask(one)
            continue
        ours = ask(one)
        for name in ("K", "h", "g"):
            assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-6, atol=1e-6)
    assert_allclose(
        pgm.audit(one, samples=20, rng=1).log_evidence,
        pgm.audit(other, samples=20, rng=1).log_evidence,
        atol=1e-7,
    )


@crossed(
    ("run", "kind", "rule"), [pgm.filter, pgm.smooth], KINDS, [pgm.Taylor(), pgm.MonteCarlo(40)]
)
def test_workers_change_nothing(run, kind, rule, workers):
    model, evidence = network(SIGHT.cpd()), recording()
    whole = run(model, evidence, lineariser=rule)
    shared = run(model, evidence, lineariser=rule, executor=workers[kind])
    same(shared, whole)
    assert shared.graph.model is model
    kept = run(model, evidence, lineariser=rule, executor=workers[kind], keep=[x])
    alone = run(model, evidence, lineariser=rule, keep=[x])
    assert_allclose(kept[x].mean, alone[x].mean, atol=1e-11)
    assert_allclose(kept[x].cov, alone[x].cov, atol=1e-12)
    assert_allclose(kept.log_evidence, alone.log_evidence, atol=1e-11)
    assert kept.graph.model is model


@pytest.mark.parametrize("kind", KINDS)
def test_iterations_hidden_controls_and_grouped_sightings(kind, workers):
    command = pgm.Variable("command", components=u.components)
    model = network(SIGHT.cpd(grouped=True)).replace(
        transition=[pgm.LinearGaussianCPD(u, {command: 1.0}, cov=0.01 * np.eye(2)), drive_cpd()]
    )
    evidence = recording(command)
    asked = {"iterations": 3, "tolerance": 0, "lineariser": pgm.Unscented()}
    whole = pgm.smooth(model, evidence, **asked)
    shared = pgm.smooth(model, evidence, **asked, executor=workers[kind])
    same(shared, whole)
    assert_allclose(shared[u].cov, whole[u].cov, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "asked",
    [
        {"iterations": 4, "tolerance": 0, "damping": pgm.LevenbergMarquardt()},
        {"start": {x: 0.1 * np.ones((RUNS, T + 1, 3)) * np.arange(RUNS)[:, None, None]}},
        {"method": pgm.Balanced(), "iterations": 2, "tolerance": 0},
    ],
)
def test_all_else_that_a_smoother_takes(asked, kind, workers):
    """The start differs by run, as do the model's prior and the axes of runs are two."""
    rng = np.random.default_rng(0)
    prior = pgm.GaussianCPD(x, 0.1 * rng.normal(size=(RUNS, 3)), P0)
    model, evidence = network(SIGHT.cpd(), prior=prior), recording()
    whole = pgm.smooth(model, evidence, **asked)
    shared = pgm.smooth(model, evidence, **asked, executor=workers[kind])
    for one, other in zip(
        *((each[x].mean, each.filtered[x].cov) for each in (shared, whole)), strict=True
    ):
        assert_allclose(one, other, atol=1e-9)
    assert_allclose(shared.log_evidence, whole.log_evidence, atol=1e-9)
    assert_allclose(shared.innovations[z].cov, whole.innovations[z].cov, atol=1e-9)
    assert_allclose(shared.belief(5).h, whole.belief(5).h, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_several_axes_of_runs(kind, workers):
    model, evidence = network(SIGHT.cpd()), recording(lead=(3, 5))
    whole = pgm.smooth(model, evidence)
    shared = pgm.smooth(model, evidence, executor=workers[kind])
    assert shared[x].mean.shape == (3, 5, T + 1, 3)
    assert_allclose(shared[x].cov, whole[x].cov, atol=1e-12)
    kept = pgm.smooth(model, evidence, executor=workers[kind], keep=x)
    assert_allclose(kept[x].mean, whole[x].mean, atol=1e-11)
    assert kept.log_evidence.shape == (3, 5)


def test_many_runs_are_bit_for_bit_those_of_one_process(workers, monkeypatch):
    """From 32 runs to a part on, where the arithmetic is the same."""
    monkeypatch.setattr(parts, "MOST", 60)
    model, evidence = network(SIGHT.cpd()), recording(lead=(400,))
    for run in (pgm.filter, pgm.smooth):
        whole = run(model, evidence)
        for kind in KINDS:
            shared = run(model, evidence, executor=workers[kind])
            kept = run(model, evidence, executor=workers[kind], keep=[x])
            for found in (shared, kept):
                assert_array_equal(found[x].mean, whole[x].mean)
                assert_array_equal(found[x].cov, whole[x].cov)
                assert_array_equal(found.log_evidence, whole.log_evidence)


def test_processes_that_are_spawned():
    model, evidence = network(SIGHT.cpd()), recording()
    whole = pgm.smooth(model, evidence)
    with ProcessPoolExecutor(1, get_context("spawn")) as spawned:
        same(pgm.smooth(model, evidence, executor=spawned), whole)


def test_results_are_not_overwritten_by_later_calls(workers):
    """Their memory is used again only once they are gone."""
    model, pool = network(SIGHT.cpd()), workers["processes"]
    for asked in ({}, {"keep": [x]}):
        first = pgm.filter(model, recording(), executor=pool, **asked)
        mean, cov = first[x].mean.copy(), first[x].cov.copy()
        for seed in range(3):
            other = pgm.filter(model, recording(seed=seed), executor=pool, **asked)
            assert not np.array_equal(other[x].mean, mean)
        assert_array_equal(first[x].mean, mean)
        assert_array_equal(first[x].cov, cov)
        held = first[x].cov
        del first, other
        pgm.filter(model, recording(seed=9), executor=pool, **asked)
        assert_array_equal(held, cov)


def test_memory_is_used_again(workers):
    pool = workers["processes"]
    for _ in range(3):
        pgm.filter(network(SIGHT.cpd()), recording(), executor=pool)
    idle = {block.number for block in idle_blocks(pool)}
    for _ in range(5):
        pgm.filter(network(SIGHT.cpd()), recording(), executor=pool)
    assert {block.number for block in idle_blocks(pool)} == idle


def test_the_threads_are_there(monkeypatch):
    """Two parts wait for each other, which one thread alone could not bear."""
    monkeypatch.setattr(parts, "MOST", 12)
    meet, seen = threading.Barrier(2, timeout=20), set()

    def function(x, m):
        if threading.get_ident() not in seen and x.shape[-2] in (11, 12):
            seen.add(threading.get_ident())
            meet.wait()
        return SIGHT.function(x, m)

    with ThreadPoolExecutor(2) as threads:
        pgm.filter(network(SIGHT.cpd(function=function)), recording(), executor=threads)
    assert len(seen) == 2
    assert threading.get_ident() not in seen


def at_home(x, m):
    """The sensor; a trial call, and a part of some runs, is made by another process."""
    assert x.shape[-2] > 5 or elsewhere()
    return SIGHT.function(x, m)


def test_the_processes_are_others(workers):
    model = network(SIGHT.cpd(function=at_home))
    pgm.filter(model, recording(), executor=workers["processes"])
    with pytest.raises(pgm.ModelError, match="AssertionError"):
        pgm.filter(model, recording(), executor=workers["remote"])


def test_a_single_run_is_no_work_for_workers(workers):
    model, evidence = network(SIGHT.cpd()), recording()
    read = evidence[z].values[0]
    seen = pgm.sightings(read, step=evidence[z].step, given=evidence[z].given)
    one = {u: evidence[u][0], z: seen}
    whole, handed = pgm.smooth(model, one), workers["remote"].handed
    assert_array_equal(pgm.smooth(model, one, executor=workers["remote"])[x].mean, whole[x].mean)
    assert workers["remote"].handed == handed


def test_infer_takes_an_executor(workers):
    model, evidence = network(SIGHT.cpd()), recording()
    graph = pgm.compile(model, steps=T)
    shared = pgm.infer(graph, evidence, executor=workers["processes"])
    same(shared, pgm.infer(graph, evidence))
    assert shared.graph is graph


class Scratch:
    """A sensor with arrays of its own: one to write to, one with names, one in another order."""

    def __init__(self):
        self.room = np.zeros(10_000)
        self.table = np.ones(700, dtype=[("offset", float), ("scale", float)])
        self.order = np.arange(600.0).reshape(20, 30).T[::2]

    def __call__(self, x, m):
        mark = threading.get_ident() + os.getpid()
        self.room[:] = mark
        time.sleep(1e-3)
        assert (self.room == mark).all()
        assert self.table["scale"].sum() == 700.0
        assert self.order.sum() == sum(30 * row + 2 * k for row in range(20) for k in range(15))
        return SIGHT.function(x, m)


@pytest.mark.parametrize("kind", ["processes", "remote"])
def test_arrays_of_a_function_are_each_worker_s_own(kind, workers):
    model, evidence = network(SIGHT.cpd(function=Scratch())), recording()
    shared = pgm.filter(model, evidence, executor=workers[kind])
    assert_allclose(shared[x].mean, pgm.filter(network(SIGHT.cpd()), evidence)[x].mean, atol=1e-11)


# Errors


def lost_early(x, m):
    """The sensor, lost where the robot started far away; the later the nearer."""
    value = SIGHT.function(x, m)
    return np.where(x[..., :1] > 500.0, np.nan, value)


class Boom(RuntimeError):
    """The user's own error."""


def raising(x, m):
    if (np.asarray(x)[..., 0] > 500.0).any():
        raise Boom("no such place")
    return SIGHT.function(x, m)


def starting(far):
    """A model some of whose runs start where functions fail, before or after a drive."""
    mean = np.zeros((RUNS, 3))
    for run, east in far.items():
        mean[run, 0] = east
    return pgm.GaussianCPD(x, mean, P0)


@crossed(("function", "kind", "asked"), [lost_early, raising], KINDS, [{}, {"keep": [x]}])
def test_errors_are_those_of_one_process(function, kind, asked, workers):
    """Run 3 fails later than 17, but in a part that is done earlier."""
    driven = recording()
    driven[u][3, 3, 0] += 1e3
    sensor = SIGHT.cpd(function=function, jacobian=None)
    model = network(sensor, prior=starting({17: 900.0, 20: 900.0}))
    with pytest.raises(pgm.PgmError) as due:
        pgm.filter(model, driven)
    with pytest.raises(pgm.PgmError) as found:
        pgm.filter(model, driven, executor=workers[kind])
    with pytest.raises(pgm.PgmError) as part:
        pgm.filter(model, driven, executor=workers[kind], keep=[x])
    with pytest.raises(pgm.PgmError) as due_of_part:
        pgm.filter(model, driven, keep=[x])
    for one, other in ((found, due), (part, due_of_part)):
        assert str(one.value) == str(other.value)
        assert type(one.value) is type(other.value)
        for name in ("variable", "cpd", "step", "run", "cluster"):
            assert getattr(one.value, name) is getattr(other.value, name), name
        assert type(one.value.__cause__) is type(other.value.__cause__)
    assert due.value.run == 17


def away(x, m):
    if elsewhere() and x.ndim == 2:
        raise Boom("not at home")
    return SIGHT.function(x, m)


def test_an_error_that_only_workers_see(workers):
    model = network(SIGHT.cpd(function=away))
    for asked in ({}, {"keep": [x]}):
        with pytest.raises(pgm.ModelError, match=r"z at step 0, run 0, failed: Boom: not") as found:
            pgm.filter(model, recording(), executor=workers["processes"], **asked)
        error = found.value
        assert (error.variable, error.step, error.run) == (z, 0, 0)
        assert error.cpd.child == z
        assert "Boom: not at home" in str(error.__cause__)
        assert "in away" in str(error.__cause__)


def dying(x, m):
    """Kills its process, which is a worker of the test's own, where a robot is far away."""
    if elsewhere() and (np.asarray(x)[..., 0] > 500.0).any():
        os.kill(os.getpid(), signal.SIGKILL)
    return SIGHT.function(x, m)


@pytest.mark.parametrize(
    ("start", "asked"),
    slow_after(2, [("fork", {}), ("fork", {"keep": [x]}), ("spawn", {"keep": [x]})]),
)
def test_a_worker_that_dies(start, asked):
    model = network(SIGHT.cpd(function=dying), prior=starting({12: 900.0}))
    with ProcessPoolExecutor(2, get_context(start)) as pool:
        begin = time.monotonic()
        with pytest.raises(pgm.ExecutorError, match=r"runs .* were lost: BrokenProcess") as found:
            pgm.filter(model, recording(), executor=pool, **asked)
        assert time.monotonic() - begin < 30.0
        assert any(first <= 12 < stop for first, stop in found.value.runs)
        assert found.value.run == found.value.runs[0][0]
        with pytest.raises(
            pgm.ExecutorError, match="runs 0 to 22 were lost: BrokenProcess"
        ) as again:
            pgm.filter(network(SIGHT.cpd()), recording(), executor=pool, **asked)
        assert again.value.runs == ((0, RUNS),)
    assert isinstance(found.value, pgm.PgmError | RuntimeError)
    copy = pickle.loads(pickle.dumps(found.value))
    assert (copy.runs, str(copy)) == (found.value.runs, str(found.value))


def test_an_executor_that_was_shut_down():
    pool = ThreadPoolExecutor(2)
    pool.shutdown()
    with pytest.raises(pgm.ExecutorError, match="runs 0 to 22 were lost: RuntimeError: cannot sch"):
        pgm.filter(network(SIGHT.cpd()), recording(), executor=pool)


def unseen(x, m):
    return SIGHT.function(x, m)


def local():
    def function(x, m):
        return SIGHT.function(x, m)

    return function


@pytest.mark.parametrize("kind", ["processes", "remote"])
@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"function": lambda x, m: SIGHT.function(x, m)}, "the function of Nonlinear.*<lambda>"),
        ({"function": local()}, r"the function of NonlinearGaussianCPD\(z .*<locals>.function"),
        (
            {"cov": pgm.noise(lambda m: 0.1 * np.eye(2) + 0 * m[..., None], given=m)},
            "the cov of Nonlinear.*<lambda>",
        ),
        ({"lineariser": lambda f, at: pgm.Taylor()(f, at)}, "the lineariser of Nonlin.*<lambda>"),
    ],
)
def test_what_cannot_be_pickled_is_named_before_work_starts(changed, told, kind, workers):
    model, handed = network(SIGHT.cpd(**changed)), workers["remote"].handed
    with pytest.raises(pgm.ModelError, match=told) as found:
        pgm.filter(model, recording(), executor=workers[kind])
    assert found.value.cpd is model.observation[0]
    assert found.value.variable == z
    assert workers["remote"].handed == handed
    pgm.filter(model, recording(), executor=workers["threads"])


def test_a_lineariser_that_cannot_be_pickled(workers):
    rule = lambda function, at: pgm.Taylor()(function, at)  # noqa: E731
    with pytest.raises(pgm.ModelError, match=r"<lambda>.* cannot be handed to another process"):
        pgm.filter(network(SIGHT.cpd()), recording(), lineariser=rule, executor=workers["remote"])


class Forgotten:
    """A function that can be pickled, but not read."""

    def __call__(self, x, m):
        return SIGHT.function(x, m)

    def __setstate__(self, state):
        raise ImportError("no module named yours")

    def __getstate__(self):
        return {"a": 1}


def test_a_model_that_a_worker_cannot_read(workers):
    model = network(SIGHT.cpd(function=Forgotten()))
    with pytest.raises(pgm.ExecutorError, match=r"cannot read .*no module named yours; functions"):
        pgm.filter(model, recording(), executor=workers["processes"])


def warning(x, m):
    if x.ndim == 2:
        warnings.warn("a steep slope", UserWarning, stacklevel=1)
    return SIGHT.function(x, m)


@pytest.mark.parametrize("kind", ["threads", "processes", "remote"])
def test_warnings_reach_the_user(kind, workers):
    model = network(SIGHT.cpd(function=warning))
    with pytest.warns(UserWarning, match="a steep slope") as found:
        pgm.filter(model, recording(), executor=workers[kind])
    assert found[0].filename == __file__


def test_a_warning_of_many_calls_is_shown_once(workers):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("default")
        pgm.filter(network(SIGHT.cpd(function=warning)), recording(), executor=workers["processes"])
    assert [str(each.message) for each in found] == ["a steep slope"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("run", [pgm.filter, pgm.smooth])
def test_runs_that_take_twice_the_digits(run, kind, workers):
    """Alone or by workers, results and digits are the same, and lost digits are told of."""
    a, b = pgm.variables("a b")
    deviations = np.where(np.arange(RUNS) == 14, 1e9, 1.0)[:, None, None] ** 2
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, np.zeros((RUNS, 1)), deviations)],
        transition=[pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=1e-8)],
        observation=[pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1e-10)],
    )
    evidence = {b: np.random.default_rng(0).normal(size=(RUNS, T, 1))}
    whole = run(model, evidence)
    assert whole.status.digits is not None
    shared = run(model, evidence, executor=workers[kind])
    assert_array_equal(shared[a].mean, whole[a].mean)
    assert_array_equal(shared.status.digits, whole.status.digits)
    assert_array_equal(shared.joint(a.at(1), a.at(2)).cov, whole.joint(a.at(1), a.at(2)).cov)
    kept = run(model, evidence, executor=workers[kind], keep=[a])
    assert_allclose(kept[a].mean, whole[a].mean, rtol=1e-9)
    assert kept.status.digits.shape == (RUNS,)


def still(far):
    """A number far from zero that a nonlinear CPD keeps."""
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, far, 1.0)],
        transition=[pgm.NonlinearGaussianCPD(a, a.previous, np.abs, cov=0.1)],
        observation=[pgm.LinearGaussianCPD(b, {a: 1.0}, cov=0.5)],
    )
    return a, model, {b: np.broadcast_to(far, (RUNS, 1))[:, None] + np.full((T, 1), 0.3)}


@pytest.mark.parametrize("kind", [None, *KINDS])
@pytest.mark.parametrize("keep", [False, True])
@pytest.mark.parametrize("run", [pgm.filter, pgm.smooth])
def test_lost_digits_are_told_once_with_their_cause(run, keep, kind, workers):
    """Of all runs together, though parts know of their own alone; as of one call for all."""
    rule, far = pgm.Unscented(alpha=1e-3), np.full((RUNS, 1), 1e6)
    far[:7] = 10.0  # parts that lose nothing
    a, model, evidence = still(far)
    with pytest.warns(pgm.PrecisionWarning) as due:
        whole = run(model, evidence, lineariser=rule)
    options = {"keep": [a]} if keep else {}
    with pytest.warns(pgm.PrecisionWarning) as said:
        found = run(model, evidence, lineariser=rule, executor=workers.get(kind), **options)
    assert [str(each.message) for each in said] == [str(each.message) for each in due]
    assert len(said) == 1
    assert (found.status.digits < 6.0).sum() == RUNS - 7
    assert "sigma points of a small alpha" in str(said[0].message)
    assert said[0].filename == __file__
    assert_allclose(found.status.digits, whole.status.digits, rtol=0, atol=0.1)


@pytest.mark.parametrize("kind", [None, *KINDS])
@pytest.mark.parametrize("keep", [False, True])
@pytest.mark.parametrize("run", [pgm.filter, pgm.smooth])
def test_one_part_alone_loses_digits(run, keep, kind, workers):
    """The last run all of them; the others are told those that their means' last places leave."""
    far = np.full((RUNS, 1), 1e6)
    far[-1] = 1e17
    a, model, evidence = still(far)
    options = {"keep": [a]} if keep else {}
    with pytest.warns(pgm.PrecisionWarning, match="too small beside its mean") as said:
        found = run(model, evidence, executor=workers.get(kind), **options)
    assert len(said) == 1
    places = (0.5 * np.spacing(np.abs(found[a].mean)) / found[a].std).max(axis=(-2, -1))
    assert (found.status.digits <= -np.log10(places)).all()
    assert (found.status.digits > -np.log10(places) - 2.0).all()


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1]])
def test_the_cause_is_that_of_the_fewest_digits(order):
    parts = [Status.of([], np.ones(2, dtype=bool), (2,)) for _ in range(3)]
    parts[0] = parts[0]._losing(np.array([1e-9, 1e-5]), FAR_APART)
    parts[1] = parts[1]._losing(np.array([1e-3, 1e-9]), CLOSE_POINTS)
    found = one_status([parts[k] for k in order], (6,))
    due = np.concatenate([[[9.0, 5.0], [3.0, 9.0], [15.65, 15.65]][k] for k in order])
    assert_allclose(found.digits, due, rtol=0, atol=0.01)
    with pytest.warns(pgm.PrecisionWarning, match="fewer than 6 decimal .*sigma points"):
        found._warn()


def test_a_part_without_residuals_moved_nothing():
    """Its residuals are zero; those of a part with fewer iterations stay as they were."""
    ones = np.ones(2, dtype=bool)
    parts = [
        Status.of([], ones, (2,)),
        Status.of([np.array([3.0, 4.0]), np.array([1.0, 2.0])], ~ones, (2,)),
        Status.of([np.array([5.0])], ones[:1], (1,)),
    ]
    due = [[0.0, 0.0, 3.0, 4.0, 5.0], [0.0, 0.0, 1.0, 2.0, 5.0]]
    for order in ([0, 1, 2], [2, 1, 0]):
        found = one_status([parts[k] for k in order], (5,))
        places = np.concatenate([[[0, 1], [2, 3], [4]][k] for k in order])
        assert_array_equal(found.residuals, np.array(due)[:, places])
        assert found.iterations == 3
    nothing = one_status([parts[0], parts[0]], (2, 2))
    assert nothing.residuals.shape == (0, 2, 2)


@pytest.mark.parametrize("executor", [0, 2, True, "2", ThreadPoolExecutor, get_context()])
def test_what_is_no_executor(executor):
    with pytest.raises(pgm.ModelError, match=r"executor= takes a concurrent.futures.Executor"):
        pgm.filter(network(SIGHT.cpd()), recording(), executor=executor)


def test_a_dask_client_is_not_its_executor():
    class Client:
        def get_executor(self):
            raise AssertionError

    with pytest.raises(pgm.ModelError, match=r"client\.get_executor\(\)"):
        pgm.filter(network(SIGHT.cpd()), recording(), executor=Client())


def test_networks_without_time_take_none():
    a, b = pgm.variables("a b")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(a, 0.0, 1.0), pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0)]
    )
    with pytest.raises(pgm.GraphError, match="executor= are for the runs of dynamic networks"):
        pgm.infer(pgm.compile(net), {b: 1.0}, executor=ThreadPoolExecutor(2))


# Sets of evidence


@crossed(("runs", "kind"), [(), (1,), (40,), (8, 5)], KINDS)
def test_the_most_probable_states_are_those_of_one_process(runs, kind, workers):
    graph = pgm.compile(discrete.asia())
    rng = np.random.default_rng(2)
    evidence = {
        variable: rng.integers(-1, 2, runs) if runs else 1
        for variable in (discrete.visit, discrete.xray, discrete.dyspnoea)
    }
    evidence[discrete.smoking] = pgm.soft(rng.random((*runs, 2)))
    whole = pgm.most_probable(graph, evidence)
    shared = pgm.most_probable(graph, evidence, executor=workers[kind])
    for variable in graph.network.variables:
        assert_array_equal(shared.assignment[variable], whole.assignment[variable])
        assert_array_equal(shared.states(variable), whole.states(variable))
    assert_array_equal(shared.log_probability, whole.log_probability)
