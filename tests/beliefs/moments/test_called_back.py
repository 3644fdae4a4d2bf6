"""Functions and linearisers that cannot be compiled are called in the middle of machine code."""

import gc
import threading
import traceback

import numpy as np
import pytest
from crossed import crossed
from robots import DRIVE, drive_cpd
from scipy.special import erf
from test_compiled import assert_posterior, both
from textbooks import assert_belief, assert_log
from zoo import SIGHT, STEP, plain, recording, wrapping, x

import pgm
from pgm.kernels.machine.emitter.module import Module

pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")

GRID = np.linspace(-200.0, 200.0, 4001)
WAVE = np.sin(GRID)


def branching(state, control):
    if np.any(state[..., 0] > 1e9):
        return state
    return DRIVE(state, control)


def branching_and_wrapping(state, control):
    return wrapping(state, control) if np.any(state[..., 0] < 1e9) else state


def looked_up(state, control):
    moved = DRIVE(state, control)
    moved[..., 0] += 0.01 * np.interp(state[..., 1], GRID, WAVE)
    return moved


def seen(state, landmark):
    if not np.any(state[..., 0] < 1e9):
        return landmark
    return SIGHT.function(state, landmark)


class External:
    """State beside the model: the function counts its calls."""

    def __init__(self):
        self.calls = 0

    def __call__(self, state, control):
        self.calls += 1
        return looked_up(state, control)


def by_scipy(state, control):
    moved = DRIVE(state, control)
    moved[..., 0] += 0.01 * erf(state[..., 1])
    return moved


def bare(function, at):
    return pgm.Cubature()(function, at)


def motion(function, **options):
    return plain(drive_cpd(function=function, jacobian=None, **options))


def sensor(function=seen, **options):
    return plain(sensor=SIGHT.cpd(function=function, jacobian=None, **options))


CALLED = {
    "branch": motion(branching),
    "table": motion(looked_up),
    "external state": motion(External()),
    "own lineariser": plain(sensor=SIGHT.cpd(lineariser=bare)),
    "scipy": motion(by_scipy),
    "monte carlo": plain(drive_cpd(lineariser=pgm.MonteCarlo(40, seed=1))),
    "fresh points": plain(drive_cpd(lineariser=pgm.MonteCarlo(40, fresh_per_run=True))),
    "sobol": plain(drive_cpd(lineariser=pgm.QuasiMonteCarlo(32))),
    "many points": plain(drive_cpd(lineariser=pgm.GaussHermite(6))),
    "sensor": sensor(),
    "both": plain(
        drive_cpd(function=branching, jacobian=None), SIGHT.cpd(function=seen, jacobian=None)
    ),
    "own derivative": plain(drive_cpd(function=branching)),
    "wrapping": motion(branching_and_wrapping),
    "grouped": sensor(grouped=True),
    "fresh sightings": plain(sensor=SIGHT.cpd(lineariser=pgm.MonteCarlo(40, fresh_per_run=True))),
    "robust": sensor(noise=pgm.Huber(1.5)),
    "robust lineariser": plain(sensor=SIGHT.cpd(lineariser=bare, noise=pgm.StudentT(4))),
}


def evidence(runs):
    found = recording("plain", max(runs, 2))
    if runs > 1:
        return found
    from zoo import of_run

    return of_run(found, 0)


@crossed(("name", "runs"), list(CALLED), [1, 3, 11])
def test_compiled_equals_plain(alone, name, runs):
    found = both(pgm.smooth, CALLED[name], evidence(runs))
    assert_posterior(*found)
    assert " called back: " in found[0].status.compilation
    assert found[0].status.compilation.startswith("compiled, ")


@crossed(("runs", "rule"), [1, 11], [pgm.Unscented(), pgm.Cubature()])
def test_points_of_compiled_rules(alone, rule, runs):
    assert_posterior(*both(pgm.smooth, CALLED["both"], evidence(runs), lineariser=rule))


def test_angles_that_differ_by_more_than_half_a_turn(alone):
    """Where a sighting's points do, its function is asked again, for its derivative."""
    shapes = []

    def noted(state, landmark):
        shapes.append(state.shape[-3:])
        return seen(state, landmark)

    prior = pgm.GaussianCPD(x, [0.0, 0.0, 0.0], np.diag([0.1, 0.1, 9.0]))
    model = plain(sensor=SIGHT.cpd(function=noted, jacobian=None), prior=prior)
    for rule in (pgm.Cubature(), pgm.GaussHermite(2)):
        found = pgm.smooth(model, evidence(11), lineariser=rule, compiled=True)
        assert {13, 2} <= {shape[1] for shape in shapes if len(shape) == 3}
        shapes.clear()
        assert_posterior(found, pgm.smooth(model, evidence(11), lineariser=rule, compiled=False))


@crossed(("rule", "size"), [pgm.Taylor(), pgm.Cubature(), pgm.MonteCarlo(60)], [7, 14])
def test_many_components(alone, size, rule):
    """Matrices are in memory, for packs of runs too, and their room outlasts a call."""
    states = pgm.Variable("states", components=tuple(f"c{k}" for k in range(size)))
    ranges = pgm.Variable("ranges", components=("r", "s"))

    def turning(state):
        if np.any(state > 1e9):
            return state
        return 0.9 * state + 0.1 * np.sin(np.roll(state, 1, axis=-1))

    def ranged(state):
        return np.interp(state[..., :2], GRID, np.arctan(GRID))

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(states, np.zeros(size), 1.0)],
        [pgm.NonlinearGaussianCPD(states, (states.previous,), turning, cov=0.1)],
        [pgm.NonlinearGaussianCPD(ranges, (states,), ranged, cov=0.1)],
    )
    for lead in ((), (11,)):
        given = {ranges: np.random.default_rng(3).normal(size=(*lead, 6, 2))}
        assert_posterior(*both(pgm.smooth, model, given, lineariser=rule))


SCHEDULES = [
    pgm.Filtering(iterations=4, tolerance=0),
    pgm.Filtering(gate=0.9),
    pgm.Filtering(iterations=3, tolerance=0, gate=0.9),
    pgm.FixedLag(3),
    pgm.Smoothing(iterations=3, tolerance=0),
]


@crossed(("name", "schedule"), ["both", "robust", "own lineariser"], SCHEDULES)
def test_schedules(name, schedule):
    for runs in (1, 19):
        found = []
        for compiled in (True, False):
            graph = pgm.compile(CALLED[name], 8, compiled=compiled)
            found.append(pgm.infer(graph, evidence(runs), schedule=schedule))
        for variable in CALLED[name].states:
            one, other = (each[variable] for each in found)
            assert_belief(one, other.mean, other.cov, 1e-8)
        assert " called back: " in found[0].status.compilation


@crossed(
    ("name", "compiled"),
    ["both", "fresh points", "robust"],
    [pgm.Compiled(threads=2), pgm.Compiled(threads=3)],
)
def test_threads(alone, name, compiled):
    given = evidence(43)
    found = pgm.smooth(CALLED[name], given, compiled=compiled)
    assert_posterior(found, pgm.smooth(CALLED[name], given, compiled=False))


def test_differences_of_more_components_are_no_more_code(monkeypatch):
    lengths, compiled = [], Module.compile

    def noted(module, *level):
        lengths.append(len(module.text()))
        return compiled(module, *level)

    monkeypatch.setattr(Module, "compile", noted)
    for size in (6, 12):
        states = pgm.Variable("states", components=tuple(f"c{k}" for k in range(size)))

        def moved(state):
            return state if np.any(state > 1e9) else np.sin(state)

        model = pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(states, np.zeros(size), 1.0)],
            [pgm.NonlinearGaussianCPD(states, (states.previous,), moved, cov=0.1)],
            [],
        )
        pgm.infer(pgm.compile(model, 3, compiled=True), {}, schedule=pgm.Filtering())
    short, long = lengths
    assert long < 1.5 * short


def test_runs_are_called_together():
    shapes = []

    def noted(state, control):
        shapes.append(state.shape)
        return branching(state, control)

    pgm.filter(motion(noted), evidence(40), compiled=True)
    assert [shape for shape in shapes if shape[:2] == (40, 13)] == [(40, 13, 3)] * 8


def test_what_a_function_keeps_is_not_written_to():
    kept = []

    def keeping(state, control):
        moved = branching(state, control)
        kept.append((state, np.copy(state)))
        return moved

    for runs in (1, 8):
        pgm.filter(motion(keeping), evidence(runs), compiled=True)
    assert all((array == copy).all() for array, copy in kept)


class Failing:
    """It fails from some call on, by an error of a kind."""

    def __init__(self, error, step):
        self.error, self.step, self.at = error, step, None

    def __call__(self, state, control, clock):
        if np.any(clock >= self.step):
            raise self.error
        return branching(state, control)


clock = pgm.Variable("clock")


def failing(error, step=5):
    from zoo import u

    cpd = pgm.NonlinearGaussianCPD(
        x, (x.previous, u, clock), Failing(error, step), cov=drive_cpd().cov
    )
    return plain(cpd)


def timed(runs):
    lead = () if runs == 1 else (runs,)
    times = np.broadcast_to(np.arange(8.0)[:, None], (*lead, 8, 1))
    return evidence(runs) | {clock: times}


@crossed(("error", "runs"), [ValueError("out of range"), pgm.PgmError("no map")], [1, 3, 8, 11])
def test_errors_are_as_without_machine_code(runs, error):
    told = []
    model = failing(error)
    for compiled in (False, True):
        with pytest.raises(pgm.PgmError) as caught:
            pgm.filter(model, timed(runs), compiled=compiled)
        told.append(caught.value)
    plainly, found = told
    assert type(found) is type(plainly)
    assert str(found) == str(plainly)
    assert (found.cpd, found.step, found.run) == (plainly.cpd, plainly.step, plainly.run)
    frames = traceback.extract_tb((found.__cause__ or found).__traceback__)
    assert frames[-1].name == "__call__"


def test_an_own_lineariser_that_fails():
    def refusing(function, at):
        if function.step == 4:
            raise RuntimeError("too far")
        return pgm.Taylor()(function, at)

    model, told = plain(sensor=SIGHT.cpd(lineariser=refusing)), []
    for compiled in (False, True):
        with pytest.raises(pgm.ModelError, match="too far") as caught:
            pgm.filter(model, evidence(8), compiled=compiled)
        told.append(str(caught.value))
    assert told[0] == told[1]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SystemExit(3)], ids=repr)
def test_interrupts_go_through(error):
    for runs, compiled in ((1, True), (11, True), (43, pgm.Compiled(threads=2))):
        with pytest.raises(type(error)) as caught:
            pgm.filter(failing(error), timed(runs), compiled=compiled)
        assert caught.value is error
    # What was given up in the middle leaves nothing behind.
    assert_posterior(*both(pgm.smooth, CALLED["both"], evidence(11)))


def test_collections_in_the_middle():
    def collecting(state, control):
        gc.collect(0)
        return branching(state, control)

    given = evidence(11)
    assert_posterior(*both(pgm.smooth, motion(collecting), given))


def test_sweeps_within_sweeps_and_beside_each_other():
    """A function may filter itself, and threads of the user may each have a sweep."""
    small = evidence(1)
    due = pgm.filter(CALLED["sensor"], small, compiled=True)[x].mean

    def filtering(state, control):
        if state.ndim == 2:
            inner = pgm.filter(CALLED["sensor"], small, compiled=True)[x].mean
            assert (inner == due).all()
        return branching(state, control)

    assert_posterior(*both(pgm.smooth, motion(filtering), small))
    found = []
    work = [
        threading.Thread(
            target=lambda: found.append(pgm.filter(CALLED["both"], small, compiled=True)[x].mean)
        )
        for _ in range(4)
    ]
    for each in work:
        each.start()
    for each in work:
        each.join()
    assert len(found) == 4
    assert all((each == found[0]).all() for each in found)


def test_beliefs_that_may_be_wrong_do_not_fail():
    """A run that machine code gives up may ask a function for values of nothing."""
    wide = pgm.GaussianCPD(x, [0.0, 0.0, 0.0], np.diag([1e12, 1e12, 1e-12]))

    def careful(state, landmark):
        if not np.isfinite(state).all():
            raise ValueError("not finite")
        return seen(state, landmark)

    model = plain(
        sensor=SIGHT.cpd(function=careful, jacobian=None, cov=1e-9 * np.eye(2)), prior=wide
    )
    found = both(pgm.filter, model, evidence(3))
    assert_belief(found[0][x], found[1][x].mean, found[1][x].cov, 1e-6)


@pytest.mark.parametrize("name", CALLED)
def test_what_is_called_is_told(name):
    compilation = pgm.compile(CALLED[name], 8).compilation
    called = [words for words in compilation.values() if words.startswith("called back: ")]
    assert called
    under = compilation.under(pgm.Filtering())
    assert under.startswith("compiled, ")
    assert called[0] in under
    status = pgm.filter(CALLED[name], evidence(1), compiled=True).status
    assert status.compilation == under
    assert "called back" in str(status)
    control = pgm.Filtering(iterations=3, damping=pgm.LevenbergMarquardt())
    assert compilation.under(control).startswith("left to NumPy: ")
    assert pgm.filter(
        CALLED[name], evidence(1), compiled=True, iterations=3, tolerance=0, damping=control.damping
    ).status.compilation.startswith("not compiled: ")


def test_sightings_of_a_step_are_called_together():
    shapes = []

    def noted(state, landmark):
        shapes.append(state.shape)
        return seen(state, landmark)

    # Of angles, the value at the mean comes before those at a rule's points.
    for rule, points in ((pgm.Taylor(), 13), (pgm.Cubature(), 7)):
        for runs in (1, 8):
            lead = () if runs == 1 else (runs,)
            pgm.filter(
                plain(sensor=SIGHT.cpd(function=noted, jacobian=None)),
                evidence(runs),
                lineariser=rule,
                compiled=True,
            )
            counts = np.bincount(STEP)
            due = [(*lead, points, *((k,) if k > 1 else ()), 3) for k in counts[counts > 0]]
            assert [shape for shape in shapes if points in shape] == due
            shapes.clear()


def test_an_error_at_several_sightings():
    told = []

    def failing_at(state, landmark):
        if np.any(landmark[..., 0] > 1e6):
            raise ValueError("no such landmark")
        return seen(state, landmark)

    model = plain(sensor=SIGHT.cpd(function=failing_at, jacobian=None))
    for runs in (1, 11):
        given = evidence(runs)
        z, m = SIGHT.z, next(iter(given[SIGHT.z].given))
        places = given[z].given[m].copy()
        places[..., 5, :] = 2e6  # the second sighting of a step
        given[z] = pgm.sightings(given[z].values, step=STEP, given={m: places})
        for compiled in (False, True):
            with pytest.raises(pgm.PgmError, match="no such landmark") as caught:
                pgm.filter(model, given, compiled=compiled)
            told.append((str(caught.value), caught.value.step, caught.value.run))
        assert told[-1] == told[-2]


GROUPS = {
    "traced": plain(sensor=SIGHT.cpd(grouped=True)),
    "called": sensor(grouped=True),
    "own lineariser": plain(sensor=SIGHT.cpd(grouped=True, lineariser=bare)),
    "fresh points": plain(
        sensor=SIGHT.cpd(grouped=True, lineariser=pgm.MonteCarlo(40, fresh_per_run=True))
    ),
}


@pytest.mark.parametrize("name", GROUPS)
@pytest.mark.parametrize("runs", [1, 11])
def test_groups_whose_errors_are_correlated(alone, name, runs):
    """They are one vector; what is kept of them is where a smoother goes on."""
    given = evidence(runs)
    for schedule in (
        pgm.Filtering(iterations=2, tolerance=0),
        pgm.Smoothing(iterations=2, tolerance=0),
    ):
        found = [
            pgm.infer(
                pgm.compile(GROUPS[name], 8, compiled=compiled),
                given,
                schedule=schedule,
                lineariser=pgm.Cubature(),
            )
            for compiled in (True, False)
        ]
        assert_belief(found[0][x], found[1][x].mean, found[1][x].cov, 1e-10)
        assert_log(found[0].log_evidence, found[1].log_evidence, 1e-10)
        assert found[0].status.compilation.startswith("compiled")
    due = "compiled" if name == "traced" else "compiled, z called back: "
    told = pgm.compile(GROUPS[name], 8).compilation.under(pgm.Filtering(iterations=2))
    assert told.startswith(due)


@pytest.mark.parametrize(
    ("sensor", "gate"), [(GROUPS["called"], 0.9), (sensor(grouped=True, noise=pgm.Huber(2)), None)]
)
def test_groups_whose_sightings_are_judged_one_by_one(sensor, gate):
    found = [
        pgm.filter(sensor, evidence(3), gate=gate, lineariser=pgm.Cubature(), compiled=compiled)
        for compiled in (True, False)
    ]
    assert_belief(found[0][x], found[1][x].mean, found[1][x].cov, 1e-12)
    assert "several sightings in a group" in found[0].status.compilation


def test_what_a_graph_tells_of_groups():
    rule = pgm.Cubature()
    compilation = pgm.compile(plain(sensor=SIGHT.cpd(grouped=True, lineariser=rule)), 8).compilation
    assert compilation.under(pgm.Smoothing()) == "compiled"
    for schedule in (pgm.Filtering(gate=0.9), pgm.Smoothing(iterations=2)):
        assert "its sightings are grouped" in compilation.under(schedule)
    robust = SIGHT.cpd(grouped=True, lineariser=rule, noise=pgm.Huber(2))
    assert "grouped" in pgm.compile(plain(sensor=robust), 8).compilation[robust]


def test_runs_of_a_group_that_are_left():
    """What a run was linearised to by NumPy is put beside that of the others."""
    spreads = np.array([1.0, 1e4, 1.0])[:, None, None] * np.diag([0.1, 0.1, 0.01])
    model = GROUPS["called"].replace(prior=[pgm.GaussianCPD(x, np.zeros((3, 3)), spreads)])
    found = [
        pgm.smooth(
            model,
            evidence(3),
            iterations=2,
            tolerance=0,
            lineariser=pgm.Cubature(),
            compiled=compiled,
        )
        for compiled in (True, False)
    ]
    assert "in 1 of 3 runs" in found[0].status.compilation
    assert_belief(found[0][x], found[1][x].mean, found[1][x].cov, 1e-8)
