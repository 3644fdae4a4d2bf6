"""Late readings in a robot's loop are those of the filter that had them in time."""

import copy
import gc
import pickle
import tracemalloc
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from models import motion, sensors
from pgm.examples import walk
from pgm.examples import z as read

LAG = 8
x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u, m = pgm.Variable("u", components=("v", "omega", "dt")), pgm.Variable("m", ("east", "north"))
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
fix, compass = pgm.Variable("fix", components=("east", "north")), pgm.Variable("c", angles=("c",))
MARKS = np.array([[7.0, 1.0], [-6.0, 8.0], [4.0, 12.0]])
DRIVE = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(x, [0.0, 0.0, 3.0], np.diag([0.1, 0.1, 0.05]) ** 2)],
    [
        pgm.NonlinearGaussianCPD(
            x, (x.previous, u), motion.velocity, np.diag([0.05, 0.05, 0.03]) ** 2
        )
    ],
    [
        pgm.NonlinearGaussianCPD(z, (x, m), sensors.range_bearing, np.diag([0.2, 0.05]) ** 2),
        pgm.LinearGaussianCPD(fix, {x: np.eye(2, 3)}, cov=0.3, noise=pgm.Huber(1.5)),
        pgm.LinearGaussianCPD(compass, {x: [[0.0, 0.0, 1.0]]}, cov=0.01),
    ],
)
SETTINGS = {
    "plain": {"compiled": False, "lag": LAG},
    "judged": {"compiled": False, "gate": 0.9, "lag": LAG, "watch": True},
    "window": {"schedule": pgm.FixedLag(LAG, iterations=2, tolerance=0.0)},
}
if find_spec("llvmlite"):
    SETTINGS |= {
        "compiled": {"compiled": True, "lag": LAG},
        "compiled and judged": {"compiled": True, "gate": 0.9, "lag": LAG, "watch": True},
    }


def stream(rng, steps):
    """The control of each step, and readings: their step, when they come, and what was read."""
    pose, controls, readings = np.array([0.0, 0.0, 3.0]), [], []
    for step in range(1, steps + 1):
        controls.append(np.array([1.0, 0.2 * rng.normal(), 0.5]))
        pose = motion.velocity(pose, controls[-1]) + 0.03 * rng.normal(size=3)
        for _ in range(rng.integers(4)):
            kind, late = rng.integers(3), int(rng.integers(LAG + 1) * (rng.random() < 0.5))
            outlier = 3.0 * (rng.random() < 0.1)
            if kind == 0:
                seen = MARKS[rng.integers(3, size=rng.integers(1, 3))]
                value = sensors.range_bearing(np.tile(pose, (len(seen), 1)), seen)
                value += (1.0 + outlier) * rng.normal(size=value.shape) * [0.2, 0.05]
                found = {z: pgm.sightings(value, given={m: seen})}
            elif kind == 1:
                found = {fix: pose[:2] + (0.5 + outlier) * rng.normal(size=2)}
            else:
                wrapped = (pose[2:] + np.pi) % (2.0 * np.pi) - np.pi
                found = {compass: wrapped + 0.1 * rng.normal(size=1)}
            readings.append((step, min(step + late, steps), found))
    return controls, readings


def run(robot, controls, due):
    """The belief at the end, `due` having the readings of each step: their own, and the values."""
    belief = robot.initial()
    for now, control in enumerate(controls, start=1):
        belief = robot.predict(belief, {u: control})
        for step, readings in due.get(now, ()):
            belief = robot.update(belief, readings, step=step)
    return belief


def by_step(pairs):
    found = {}
    for now, each in pairs:
        found.setdefault(now, []).append(each)
    return found


def check(robot, seed, steps=30):
    controls, readings = stream(np.random.default_rng(seed), steps)
    came = by_step((now, (step, each)) for step, now, each in sorted(readings, key=lambda r: r[1]))
    # A step's readings are taken in the order in which they came.
    order = by_step((step, (step, each)) for now in sorted(came) for step, each in came[now])
    late, due = run(robot, controls, came), run(robot, controls, order)
    assert_allclose(late[x].mean, due[x].mean, rtol=1e-10, atol=1e-10)
    assert_allclose(late[x].cov, due[x].cov, rtol=1e-10, atol=1e-12)
    assert_allclose(late.log_evidence, due.log_evidence, rtol=1e-10)
    assert_allclose(late.lagged[x].mean, due.lagged[x].mean, rtol=1e-9, atol=1e-9)
    if due.watch is not None:
        assert late.lost == due.lost
    assert (late.step, late.kind) == (due.step, due.kind)
    return sum(step < now for step, now, _ in readings)


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
@pytest.mark.parametrize("name", list(SETTINGS))
def test_drawn_streams(name):
    """Delays up to the lag, several readings of a step, angles, robust noise, gates."""
    robot = pgm.OnlineFilter(DRIVE, **SETTINGS[name])
    assert (
        sum(
            check(robot, seed, 12 if name == "window" else 30)
            for seed in range(1 + (name != "window"))
        )
        > 5
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
@pytest.mark.parametrize("name", [each for each in SETTINGS if each != "window"])
def test_a_thousand_drawn_streams(name):
    robot = pgm.OnlineFilter(DRIVE, **SETTINGS[name])
    assert sum(check(robot, seed) for seed in range(250)) > 1000


def test_arrays_may_be_used_again_and_beliefs_pickled():
    robot = pgm.OnlineFilter(DRIVE, lag=LAG, compiled=bool(find_spec("llvmlite")))
    control, value, belief = np.empty(3), np.empty(2), robot.initial()
    due = robot.initial()
    for k in range(20):
        control[:], value[:] = (1.0, 0.1 * k, 0.5), (0.3 * k, 0.0)
        belief = robot.update(robot.predict(belief, {u: control}), {fix: value})
        due = robot.update(robot.predict(due, {u: control.copy()}), {fix: value.copy()})
        if k == 15:
            due = robot.update(due, {compass: [3.0]})
    control[:], value[:] = np.nan, np.nan
    for each in (belief, pickle.loads(pickle.dumps(belief)), copy.deepcopy(belief)):
        own = robot if each is belief else pgm.OnlineFilter(each.layout.model, lag=LAG)
        late = own.update(each, {compass: [3.0]}, step=16)
        assert_allclose(late[x].mean, due[x].mean, rtol=1e-9)
        assert_allclose(late.log_evidence, due.log_evidence, rtol=1e-9)


@pytest.mark.parametrize("variance", [1.0, np.inf])
def test_sightings_without_identity(variance):
    """Identities are asked for anew where steps are made again; flat priors are as others."""
    place, seen = pgm.Variable("place", components=("p", "v")), pgm.Variable("seen")
    at, mark = pgm.variables("at mark")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, [0.0, 1.0], variance)],
        [pgm.LinearGaussianCPD(place, {place.previous: [[1, 1.0], [0, 1]]}, cov=0.1)],
        [
            pgm.LinearGaussianCPD(at, {place: [[1.0, 0.0]]}, cov=0.2),
            pgm.LinearGaussianCPD(seen, {place: [[-1.0, 0.0]], mark: 1.0}, cov=0.3),
        ],
    )
    nameless = {mark: pgm.unknown([[0.0], [10.0]], gate=0.99, association="likelihood")}
    robot = pgm.OnlineFilter(model, lag=4)
    late = due = robot.initial()
    for k in range(1, 8):
        late, due = robot.predict(late), robot.predict(due)
        if k < 4:
            late, due = robot.update(late, {at: [1.1 * k]}), robot.update(due, {at: [1.1 * k]})
        else:
            sighted = {seen: pgm.sightings([[10.2 - k], [-k]], given=nameless)}
            late, due = robot.update(late, sighted), robot.update(due, sighted)
        if k in (3, 6):
            due = robot.update(due, {at: [float(k)]})
    for step in (6, 3):
        late = robot.update(late, {at: [float(step)]}, step=step)
    assert_allclose(late[place].mean, due[place].mean, rtol=1e-10)
    assert_allclose(late.log_evidence, due.log_evidence, rtol=1e-10)


@pytest.mark.parametrize("lag", [2, 5])
def test_tables(lag):
    s, o = pgm.Discrete("s", ("a", "b")), pgm.Discrete("o", ("yes", "no"))
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(s, table=[0.5, 0.5])],
        [pgm.TableCPD(s, s.previous, table=[[0.9, 0.1], [0.2, 0.8]])],
        [pgm.TableCPD(o, s, table=[[0.8, 0.2], [0.3, 0.7]])],
    )
    robot = pgm.OnlineFilter(model, lag=lag)
    belief = robot.initial()
    for k in range(6):
        belief = robot.predict(belief)
        if k != 3:
            belief = robot.update(belief, {o: "yes"})
    late = robot.update(belief, {o: "no"}, step=4)
    due = pgm.filter(model, {o: ["yes"] * 3 + ["no"] + ["yes"] * 2})
    assert_allclose(late[s].probabilities, due[s].probabilities[-1], rtol=1e-12)
    assert_allclose(late.log_evidence, due.log_evidence, rtol=1e-12)
    with pytest.raises(pgm.EvidenceError, match="keeps those of steps"):
        robot.update(belief, {o: "no"}, step=6 - lag - 1)


def test_what_comes_too_late_is_refused():
    robot = pgm.OnlineFilter(walk, lag=3)
    belief = robot.initial()
    for _ in range(5):
        belief = robot.predict(belief)
    for step, words in (
        (1, r"are 4 steps late, and the filter keeps those of steps 2\.\.5"),
        (6, "ahead of it; predict first"),
        (-1, "are 6 steps late"),
        (2.0, "the number of a step was due"),
    ):
        with pytest.raises(pgm.EvidenceError, match=words):
            robot.update(belief, {read: [1.0]}, step=step)
    robot.update(belief, {read: [1.0]}, step=2)
    for other in (
        pgm.OnlineFilter(walk),
        pgm.OnlineFilter(walk, belief=pgm.Particles(1000, seed=1)),
    ):
        known = other.predict(other.initial())
        other.update(known, {read: [1.0]}, step=1)
        with pytest.raises(pgm.EvidenceError, match=r"OnlineFilter\(model, lag=20\)"):
            other.update(known, {read: [1.0]}, step=0)
    with pytest.raises(pgm.ModelError, match="no belief of this filter's model"):
        robot.update(pgm.OnlineFilter(DRIVE, lag=3).initial(), {read: [1.0]}, step=0)


@pytest.mark.parametrize("compiled", [False, True] if find_spec("llvmlite") else [False])
def test_memory_stays_flat(compiled):
    """An hour at 10 Hz is 36,000 steps; the last thousands take no more than the first."""
    robot = pgm.OnlineFilter(walk, lag=20, compiled=compiled)

    def drive(belief, steps):
        for k in range(steps):
            belief = robot.update(robot.predict(belief), {read: np.array([0.1])})
            if k % 10 == 9:
                belief = robot.update(belief, {read: [0.2]}, step=belief.step - 7)
        return belief

    belief = drive(robot.initial(), 150)
    tracemalloc.start()
    belief = drive(belief, 50)
    gc.collect()
    before, _ = tracemalloc.get_traced_memory()
    belief = drive(belief, 3000 if compiled else 400)
    gc.collect()
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after < 1.5 * before + 20_000
