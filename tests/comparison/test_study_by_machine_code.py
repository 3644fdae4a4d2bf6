"""Studies in machine code against NumPy's kernels: NIS of sweeps, errors and sums over runs."""

from threading import current_thread, main_thread

import numpy as np
import pytest
from comparison.test_study_workers import require_same
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.beliefs.moments.compiled import judged as judging
from pgm.beliefs.moments.compiled import sweep
from pgm.comparison import drawn_runs, judged_runs, studying
from pgm.comparison.study_methods import Method
from pgm.comparison.tally import Tally
from pgm.compile.machine import Squared
from pgm.inference.engine import send

pytest.importorskip("llvmlite")

from pgm.kernels.machine.sweeps import chain as sweeps

T = 9
x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("v", "omega"))
m = pgm.Variable("m", components=("east", "north"))
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
near = pgm.Variable("near")
fix = pgm.Variable("fix", components=("east", "north"))


def drive(x, u):
    heading = x[..., 2] + 0.5 * u[..., 1]
    change = [u[..., 0] * np.cos(heading), u[..., 0] * np.sin(heading), u[..., 1]]
    return x + np.stack(change, axis=-1)


def sight(x, m):
    away = m - x[..., :2]
    bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
    return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)


def distance(x, m):
    return np.hypot(x[..., 0] - m[..., 0], x[..., 1] - m[..., 1])[..., None]


def robot(noise=None, several=True, **given):
    start, moving = np.square([0.1, 0.1, 0.05]), np.square([0.05, 0.05, 0.03])
    sensors = [pgm.NonlinearGaussianCPD(z, (x, m), sight, cov=[0.04, 0.01], noise=noise, **given)]
    if several:
        sensors.append(pgm.LinearGaussianCPD(fix, {x: np.eye(3)[:2]}, cov=0.3))
        sensors.append(pgm.NonlinearGaussianCPD(near, (x, m), distance, cov=0.04, noise=noise))
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.0, 0.0], start)],
        [pgm.NonlinearGaussianCPD(x, (x.previous, u), drive, cov=moving)],
        sensors,
    )


MAP = np.tile([[7.0, 1.0], [-6.0, 8.0], [4.0, 12.0]], (3, 1))
INPUTS = {
    u: np.tile([1.0, 0.3], (T, 1)),
    z: pgm.sightings(step=[1, 1, 3, 3, 3, 7, 9], given={m: MAP[:7]}),
    near: pgm.sightings(step=[2, 1, 1, 3, 8], given={m: MAP[:5]}),
    fix: pgm.sightings(step=np.arange(T)),
}
ALONE = {variable: INPUTS[variable] for variable in (u, z)}


def solved(model, inputs, schedule, rule, runs, choice):
    drawn = studying.drawn_runs(model, inputs, T, runs, 1)._replace(block=runs)
    evidence = drawn.sample(0).evidence
    graph = pgm.compile(model, T, compiled=choice)
    return send(graph, evidence, Method(rule, schedule).call)


def assert_squares(posterior, of):
    """The NIS that sweeps have kept are those of the innovations by NumPy's kernels."""
    squares = posterior._squares
    for sensor, innovations in of.innovations.items():
        nis, dof = squares[sensor]
        assert_array_equal(dof, innovations.dof)
        read = innovations.dof > 0
        assert_allclose(np.where(read, nis, np.nan), innovations.nis, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize(
    "schedule",
    [
        pgm.Filtering(),
        pgm.Filtering(iterations=3),
        pgm.Filtering(gate=0.8),
        pgm.Smoothing(),
        pgm.Smoothing(iterations=3),
        pgm.FixedLag(3, iterations=2),
    ],
    ids=str,
)
@pytest.mark.parametrize("noise", [None, pgm.StudentT(5.0)], ids=str)
def test_sweeps_keep_the_nis_of_each_sensor_by_itself(noise, schedule):
    model = robot(noise)
    rule = pgm.Taylor() if noise else pgm.Unscented()
    kept = solved(model, INPUTS, schedule, rule, 19, Squared())
    assert "not compiled" not in kept.status.compilation
    if not isinstance(schedule, pgm.FixedLag):
        assert len(kept._outcome._swept.squares) == 3
    assert_squares(kept, solved(model, INPUTS, schedule, rule, 19, False))


def test_a_group_of_sightings_is_one_innovation():
    model = robot(grouped=True, lineariser=pgm.Unscented())
    kept = solved(model, INPUTS, pgm.Filtering(), pgm.Taylor(), 17, Squared())
    assert kept._outcome._swept.squares
    assert_squares(kept, solved(model, INPUTS, pgm.Filtering(), pgm.Taylor(), 17, False))


def test_of_a_single_sensor_numpy_keeps_the_nis_too():
    for schedule in (pgm.Filtering(), pgm.Smoothing(), pgm.Filtering(iterations=3)):
        kept = solved(robot(several=False), ALONE, schedule, pgm.Taylor(), 9, False)
        assert kept._outcome._swept.squares
        assert_squares(kept, kept)


def test_runs_that_machine_code_leaves_have_their_nis():
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, 2.5, 0.5)],
        [pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.2)],
        [pgm.NonlinearGaussianCPD(b, (a,), lambda a: a**3, cov=0.04)],
    )
    inputs = {}
    kept = solved(model, inputs, pgm.Filtering(), pgm.Taylor(), 64, Squared())
    assert "but for" in kept.status.compilation
    assert "of 64" in kept.status.compilation
    assert_squares(kept, solved(model, inputs, pgm.Filtering(), pgm.Taylor(), 64, False))


def assert_tallies(found, other, atol=1e-12):
    assert found.keys() == other.keys()
    for name, tally in found.items():
        for field in Tally._fields:
            one, two = (np.asarray(getattr(each, field)) for each in (tally, other[name]))
            assert one.shape == two.shape
            assert_allclose(one, two, rtol=1e-12, atol=atol * max(1.0, np.abs(two).max()))


@pytest.mark.parametrize("layout", ["runs last", "runs first"])
@pytest.mark.parametrize("runs", [8, 13, 32])
def test_errors_and_nees_are_those_of_arrays(runs, layout):
    rng = np.random.default_rng(runs)
    root = rng.normal(size=(runs, 5, 3, 3))
    cov = root @ root.swapaxes(-1, -2) + 0.1 * np.eye(3)
    cov[runs // 2, 2] = np.diag([1.0, 0.0, 1.0])  # no NEES at this step
    mean, truth = rng.normal(size=(2, runs, 5, 3)) * [1.0, 1.0, 9.0]
    truth[0, 3, 2] = mean[0, 3, 2] + np.pi
    if layout == "runs last":
        mean, cov, truth = (
            np.moveaxis(np.ascontiguousarray(np.moveaxis(each, 0, -1)), -1, 0)
            for each in (mean, cov, truth)
        )
    belief = pgm.Gaussian(x, mean, cov, steps=np.arange(5))
    found = judged_runs._by_machine_code(belief, truth, 0.9)
    other = judged_runs._by_arrays(belief, truth, 0.9)
    assert_tallies(found.tallies, other.tallies)
    assert found.tallies["nees"].known[2] == 0.0
    assert_allclose(found.most, other.most, rtol=1e-12)
    assert_allclose(found.last, other.last, rtol=1e-12)


def test_beliefs_that_are_singular_everywhere_have_no_nees():
    mean, cov = np.zeros((9, 2, 1)), np.zeros((9, 2, 1, 1))
    belief = pgm.Gaussian(near, mean, cov, steps=[0, 1])
    for by in (judged_runs._by_machine_code, judged_runs._by_arrays):
        found = by(belief, mean + 1.0, 0.9)
        assert np.isneginf(found.most).all()
        assert np.isnan(found.last).all()
        assert_array_equal(found.tallies["nees"].known, 0.0)
        assert_array_equal(found.tallies["error"].mean, -1.0)


def test_values_that_are_not_there_are_not_counted():
    values = np.random.default_rng(3).normal(size=(21, 4)) + 5.0
    values[3, 1] = values[20, 0] = values[:, 3] = np.nan
    for given in (values, np.asfortranarray(values)):
        found = judged_runs.tally_of(given, compiled=True)
        assert_tallies({"": found}, {"": Tally.of(values)})
    few = judged_runs.tally_of(values[:5], compiled=True)
    assert_tallies({"": few}, {"": Tally.of(values[:5])}, atol=0.0)


@pytest.mark.parametrize("runs", [5, 40])
def test_a_study_has_the_figures_of_numpy(runs):
    model, methods = robot(pgm.Huber(1.5)), {"EKF": pgm.Taylor(), "RTS": pgm.Smoothing()}
    given = {"runs": runs, "methods": methods, "seed": 4}
    found = pgm.study(model, INPUTS, compiled=True, **given)
    other = pgm.study(model, INPUTS, compiled=False, **given)
    for row, its in zip(found.rows, other.rows, strict=True):
        assert row.worst == its.worst
        for name, statistic in row._statistics().items():
            plain = its._statistics()[name]
            for each in ("value", "error", "by_step", "error_by_step"):
                one, two = getattr(statistic, each), getattr(plain, each)
                assert_allclose(one, two, rtol=1e-10, atol=1e-11)


def test_parts_of_the_runs_join_their_nis():
    from concurrent.futures import ThreadPoolExecutor

    evidence = studying.drawn_runs(robot(), INPUTS, T, 40, 1).sample(0).evidence
    graph = pgm.compile(robot(), T, compiled=Squared())
    with ThreadPoolExecutor(2) as workers:
        for schedule in (pgm.Smoothing(iterations=2, tolerance=0.0), pgm.Smoothing()):
            found = pgm.infer(graph, evidence, schedule=schedule, executor=workers)
            assert_squares(found, found)


@pytest.mark.parametrize("schedule", [pgm.Filtering(), pgm.Filtering(iterations=2)], ids=str)
@pytest.mark.parametrize("runs", [1200, 1205])
def test_traces_are_judged_at_predicted_beliefs_of_some_runs(runs, schedule, monkeypatch):
    """Of very many points some are looked at; predicted beliefs of other runs are not written."""
    seen = {}

    def judged(plan, known, predicted, done, *, again, thinned):
        points = [
            belief.mean for _, belief in judging.evaluated(plan, known, predicted, None, thinned)
        ]
        seen[sweep.THINNED] = predicted, thinned, points
        judging.judge(plan, known, predicted, done, again=again, thinned=thinned)

    monkeypatch.setattr(sweep, "judge", judged)
    inputs = {z: pgm.sightings(step=np.arange(T), given={m: MAP}), u: INPUTS[u]}
    for thinned in (8, 10**6):
        monkeypatch.setattr(sweep, "THINNED", thinned)
        model = robot(several=False)
        smooth = model.replace(
            observation=[pgm.NonlinearGaussianCPD(z, (x, m), lambda x, m: x[..., :2] * m, cov=9.0)]
        )
        solved(smooth, inputs, schedule, pgm.Taylor(), runs, Squared())
    (some, one, points), (every, other, _) = seen[8], seen[10**6]
    assert (one, other) == (8, 1)
    kept = sweeps.kept_runs(runs, 8)
    assert_array_equal(kept[:16], [*range(8), *range(64, 72)])
    assert kept[-1] < runs
    for part, whole in zip(some, every, strict=True):
        assert part.shape[1] == len(kept)
        assert_array_equal(part, whole[:, kept])
    known = {tuple(row) for row in every[0].reshape(-1, 3)}
    assert len(points[-1]) > 900
    assert all(tuple(point) in known for point in points[-1])


@pytest.mark.parametrize("most", [16, 1024])
def test_threads_change_no_digit(most, monkeypatch):
    """They share the blocks, or the runs of the only one."""
    monkeypatch.setattr(drawn_runs, "MOST", most)
    given = {"runs": 100, "methods": {"UKF": pgm.Unscented()}, "seed": 4}
    alone = pgm.study(robot(), INPUTS, compiled=True, **given)
    threads, sample = set(), drawn_runs.DrawnRuns.sample

    def counted(self, first):
        threads.add(current_thread())
        return sample(self, first)

    monkeypatch.setattr(drawn_runs.DrawnRuns, "sample", counted)
    require_same(pgm.study(robot(), INPUTS, compiled=pgm.Compiled(threads=3), **given), alone)
    assert (main_thread() in threads) == (most > 100)
