"""Solving in logarithmic rounds against solving step by step, from the same first linearisation."""

from fractions import Fraction

import numpy as np
import pytest
from crossed import crossed
from robots import DRIVE, SENSORS, T, drive_cpd, m, network, u, x
from textbooks import assert_log, assert_same

import pgm
from pgm.beliefs.moments.passes import backward, forward, newton
from pgm.beliefs.moments.smoothers import parallel
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.schedules.binding import bind_chain

SIGHT, POSITION = SENSORS["range_bearing"], SENSORS["position"]
LANDMARKS = np.array([[4.0, 9.0], [-3.0, 2.0], [8.0, -4.0]])
RULES = [pgm.Taylor(), pgm.Unscented()]


def drive(runs=(), seed=0, steps=T):
    """Controls, sightings of landmarks at random steps, some missing; a start near the truth."""
    rng = np.random.default_rng(seed)
    commands = np.stack([np.ones(steps), 0.3 * np.sin(np.arange(steps) / 5)], axis=-1)
    truth = np.zeros((*runs, steps + 1, 3))
    for k in range(steps):
        noise = rng.multivariate_normal(np.zeros(3), np.diag([0.02, 0.01, 0.005]), runs)
        command = np.broadcast_to(commands[k], (*runs, 2))
        truth[..., k + 1, :] = drive_cpd().function(truth[..., k, :], command) + noise
    step = np.sort(rng.integers(0, steps + 1, 2 * steps))
    which = rng.integers(0, 3, step.size)
    seen = SIGHT.draw(truth[..., step, :], LANDMARKS[which], rng)
    seen[..., ::7, :] = np.nan
    evidence = {u: commands, SIGHT.z: pgm.sightings(seen, step, {m: LANDMARKS[which]})}
    return evidence, {x: truth + 0.05 * rng.normal(size=truth.shape)}


def both(model, evidence, steps=T, **asked):
    """The posteriors of a chain of slices and of a balanced tree."""
    balanced = pgm.compile(model, steps, method=pgm.Balanced())
    return tuple(
        pgm.infer(graph, evidence, **asked) for graph in (pgm.compile(model, steps), balanced)
    )


def assert_equal(one, other, variables, tolerance=1e-9):
    for variable in variables:
        assert_same(other[variable], one[variable], tolerance)
        assert_same(other.filtered[variable], one.filtered[variable], tolerance)
        assert_same(other.predicted[variable], one.predicted[variable], tolerance)
    assert_log(other.log_evidence, one.log_evidence, 1e-8)
    assert other.log_evidence_kind == one.log_evidence_kind


@pytest.mark.parametrize("lineariser", RULES, ids=str)
@pytest.mark.parametrize("runs", [(), (2, 3)], ids=str)
@pytest.mark.parametrize("iterations", [1, 2, 5])
def test_from_one_start_both_go_the_same_way(lineariser, runs, iterations):
    evidence, start = drive(runs)
    schedule = pgm.Smoothing(iterations, tolerance=0.0)
    one, other = both(
        network(SIGHT.cpd()), evidence, lineariser=lineariser, start=start, schedule=schedule
    )
    assert_equal(one, other, [x])
    assert other.status.iterations == one.status.iterations


@pytest.mark.parametrize(
    "damping", [0.3, pgm.LevenbergMarquardt(), pgm.LevenbergMarquardt(start=10.0)], ids=str
)
def test_damped_they_do_too(damping):
    evidence, start = drive((3,), seed=1)
    start = {x: start[x] + np.array([3.0, -2.0, 1.0])}
    schedule = pgm.Smoothing(4, tolerance=0.0, damping=damping)
    one, other = both(network(SIGHT.cpd()), evidence, start=start, schedule=schedule)
    assert_equal(one, other, [x], 1e-7)


@pytest.mark.parametrize("lineariser", RULES, ids=str)
def test_grouped_sightings_keep_their_cross_terms(lineariser):
    evidence, start = drive(seed=2)
    model = network(SIGHT.cpd(grouped=True))
    schedule = pgm.Smoothing(3, tolerance=0.0)
    one, other = both(model, evidence, lineariser=lineariser, start=start, schedule=schedule)
    assert_equal(one, other, [x])


@pytest.mark.parametrize("lineariser", RULES, ids=str)
@pytest.mark.parametrize("analytic", [False, True], ids=["numerical", "analytic"])
def test_controls_that_are_hidden(lineariser, analytic):
    evidence, start = drive(seed=3)
    told = pgm.Variable("told", components=("v", "omega"))
    model = network(
        SIGHT.cpd(),
    )
    push = pgm.LinearGaussianCPD(u, {told: np.eye(2)}, cov=np.diag([0.01, 0.02]))
    by = {x.previous: DRIVE.by_state, u: DRIVE.by_control} if analytic else {}
    model = model.replace(transition=[push, drive_cpd(jacobian=by)])
    commands = evidence.pop(u)
    evidence[told] = commands
    start = {**start, u: commands}
    schedule = pgm.Smoothing(4, tolerance=0.0)
    one, other = both(model, evidence, lineariser=lineariser, start=start, schedule=schedule)
    assert_equal(one, other, [x, u])
    pair = (x.at(7), u.at(8), x.at(20))
    assert_same(other.joint(*pair), one.joint(*pair))


def test_without_a_start_it_is_dead_reckoning():
    """One iteration is then a Gauss–Newton step from there."""
    evidence, _ = drive()
    model = network(SIGHT.cpd())
    dead = [np.zeros(3)]
    for command in evidence[u]:
        dead.append(drive_cpd().function(dead[-1], command))
    graph = pgm.compile(model, T, method=pgm.Balanced())
    for iterations in (1, 3):
        schedule = pgm.Smoothing(iterations, tolerance=0.0)
        found = pgm.infer(graph, evidence, schedule=schedule)
        due = pgm.infer(graph, evidence, schedule=schedule, start={x: np.array(dead)})
        assert_same(found[x], due[x])


def test_both_end_at_one_optimum():
    evidence, _ = drive(seed=4)
    one, other = both(network(SIGHT.cpd()), evidence, schedule=pgm.Smoothing(50))
    assert one.status.converged
    assert other.status.converged
    assert_equal(one, other, [x], 1e-7)
    assert other.log_evidence_kind == "laplace"


def test_a_last_residual_is_no_smaller_than_the_move_in_deviations():
    """Until the last one they count in the deviation of a component given all others."""
    evidence, start = drive(seed=5)
    graph = pgm.compile(network(SIGHT.cpd()), T, method=pgm.Balanced())
    asked = {"start": start, "schedule": pgm.Smoothing(3, tolerance=0.0)}
    before = pgm.infer(graph, evidence, start=start, schedule=pgm.Smoothing(2, tolerance=0.0))
    after = pgm.infer(graph, evidence, **asked)
    move = (np.abs(after[x].mean - before[x].mean) / after[x].std).max()
    assert move <= after.status.residuals[-1] * (1 + 1e-9)


def plan_of(model, evidence, steps):
    return ChainPlan.make(
        pgm.compile(model, steps), bind_chain(model, evidence, steps), pgm.Taylor()
    )


WALK = pgm.LinearGaussianCPD(x, {x.previous: np.eye(3)}, cov=np.diag([0.1, 0.2, 0.0]))


@pytest.mark.parametrize("runs", [(), (5,)], ids=str)
@pytest.mark.parametrize("steps", [0, 1, 2, 3, 17, 64])
def test_the_scan_back_is_the_sweep_back(runs, steps):
    rng = np.random.default_rng(steps)
    seen = rng.normal(size=(*runs, steps + 1, 2))
    model = network(POSITION.cpd(), transition=WALK)
    plan = plan_of(model, {POSITION.z: pgm.sightings(seen, np.arange(steps + 1))}, steps)
    ahead, _ = forward.run(plan, pgm.Filtering())
    if not steps:
        return
    reverse = backward.Reverse.make(plan, ahead)
    due, found = backward.sweep(ahead, reverse), backward.scan(ahead, reverse)
    np.testing.assert_allclose(found.mean, due.mean, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(found.cov, due.cov, rtol=1e-11, atol=1e-13)


def test_a_step_of_means_alone_is_the_smoother_s():
    evidence, start = drive((2,), seed=6)
    model = network(SIGHT.cpd())
    graph = pgm.compile(model, T, method=pgm.Balanced())
    plan = pgm.infer(graph, evidence, start=start)._outcome._plan
    reference = np.moveaxis(start[x], 0, 1)
    found = newton.step(plan, reference)
    due = parallel.filtered(plan, reference)
    smoothed = backward.scan(due, backward.Reverse.make(plan, due))
    std = np.sqrt(np.diagonal(smoothed.cov, axis1=-2, axis2=-1))
    assert (np.abs(found.means - smoothed.mean) / std).max() < 1e-9
    assert (found.variance <= std**2 * (1 + 1e-12)).all()


def test_where_rounding_leaves_no_step_of_means_all_is_solved(monkeypatch):
    evidence, start = drive(seed=9)
    asked = {"start": start, "schedule": pgm.Smoothing(5, tolerance=0.0)}
    step, calls = newton.step, []

    def fails(plan, at):
        calls.append(at)
        return step(plan, at) if len(calls) < 3 else None

    monkeypatch.setattr(newton, "step", fails)
    one, other = both(network(SIGHT.cpd()), evidence, **asked)
    assert len(calls) == 5
    assert_equal(one, other, [x])


@pytest.mark.parametrize("part", ["prior", "transition", "sensor"])
def test_a_singular_noise_has_no_normal_equations(part):
    evidence, start = drive(seed=7)
    flat = np.diag([0.1, 0.1, 0.0])
    prior = pgm.GaussianCPD(x, np.zeros(3), flat if part == "prior" else np.eye(3))
    move = drive_cpd(cov=flat) if part == "transition" else drive_cpd()
    if part == "sensor":
        z = pgm.Variable("compass")
        cpd = pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0, 0.0]]}, cov=0.0)
        evidence[z] = pgm.sightings(start[x][[3, 9], :1], [3, 9])
        model = network(SIGHT.cpd(), cpd, prior=prior, transition=move)
    else:
        model = network(SIGHT.cpd(), prior=prior, transition=move)
    graph = pgm.compile(model, T, method=pgm.Balanced())
    plan = pgm.infer(graph, evidence, start=start)._outcome._plan
    assert newton.step(plan, start[x][:, None]) is None
    one, other = both(model, evidence, start=start, schedule=pgm.Smoothing(3, tolerance=0.0))
    assert_equal(one, other, [x])


def line(motion=1.0, cov=1.0, noise=1.0, mean=0.0, prior=1.0):
    """A scalar walk that is read at each step."""
    s, z = pgm.Variable("s"), pgm.Variable("z")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, mean, prior)],
        [pgm.LinearGaussianCPD(s, {s.previous: motion}, cov=cov)],
        [pgm.LinearGaussianCPD(z, {s: 1.0}, cov=noise)],
    )
    return model, s, z


SCHEDULES = [pgm.Filtering(), pgm.Smoothing()]


@pytest.mark.filterwarnings("ignore:.*too small beside its mean:pgm.PrecisionWarning")
@crossed(("place", "schedule"), [0.0, 1e3, 1e9], SCHEDULES)
def test_large_coordinates_cost_no_digits(schedule, place):
    """The prior knows nothing of where the readings are; at 10⁹ a last place is 10⁻⁵ deviations."""
    rng = np.random.default_rng(0)
    model, s, z = line(cov=1e-4, noise=1e-4, prior=1e6)
    seen = place + np.cumsum(0.01 * rng.normal(size=(200, 1)), axis=0)
    one, other = both(model, {z: seen}, 200, schedule=schedule)
    scale = max(place, 1.0) * 1e-15 / 0.01
    assert_equal(one, other, [s], 1e-9 + 10 * scale)


@pytest.mark.parametrize("schedule", SCHEDULES, ids=str)
@pytest.mark.parametrize("motion", [1.5, -3.0, 0.0])
def test_a_motion_that_leads_beyond_all_numbers(schedule, motion):
    model, s, z = line(motion=motion, mean=1.0)
    seen = np.random.default_rng(0).normal(size=(2000, 1))
    one, other = both(model, {z: seen}, 2000, schedule=schedule)
    assert_equal(one, other, [s])


@pytest.mark.parametrize("schedule", SCHEDULES, ids=str)
def test_a_heading_that_turns_away_from_dead_reckoning(schedule):
    """Readings are wrapped, and the prediction of each step tells their branch."""
    turn, compass = (
        pgm.Variable(name, components=("angle",), angles=("angle",)) for name in ("turn", "compass")
    )
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(turn, 0.0, 0.01)],
        [pgm.LinearGaussianCPD(turn, {turn.previous: 1.0}, cov=0.3)],
        [pgm.LinearGaussianCPD(compass, {turn: 1.0}, cov=0.01)],
    )
    rng = np.random.default_rng(0)
    truth = np.cumsum(0.4 + 0.2 * rng.normal(size=(100, 1)), axis=0)
    seen = np.mod(truth + np.pi, 2 * np.pi) - np.pi
    one, other = both(model, {compass: seen}, 100, schedule=schedule)
    assert_equal(one, other, [turn])
    assert other[turn].mean[-1] == pytest.approx(truth[-1], abs=1.0)


def test_an_exact_compass_is_wrapped_before_it_contradicts():
    turn, compass = (
        pgm.Variable(name, components=("angle",), angles=("angle",)) for name in ("turn", "compass")
    )
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(turn, 7.0, 0.0)],
        [pgm.LinearGaussianCPD(turn, {turn.previous: 1.0}, cov=0.3)],
        [pgm.LinearGaussianCPD(compass, {turn: 1.0}, cov=0.0)],
    )
    seen = pgm.sightings(np.array([[7.0], [7.5]]) - 2 * np.pi, [0, 1])
    one, other = both(model, {compass: seen}, 3)
    assert_equal(one, other, [turn])


def test_a_nonlinear_filter_has_to_wait_for_its_beliefs():
    evidence, _ = drive()
    graph = pgm.compile(network(SIGHT.cpd()), T, method=pgm.Balanced())
    with pytest.raises(pgm.GraphError, match=r"nonlinear.*without pgm.Balanced"):
        pgm.infer(graph, evidence, schedule=pgm.Filtering())


@pytest.mark.parametrize("mean", [0, 3])
@pytest.mark.parametrize("motion", [1, 2])
@pytest.mark.parametrize("schedule", SCHEDULES, ids=str)
def test_an_exact_sensor_of_a_motion_without_noise(motion, mean, schedule):
    """It has no element, so that the tree goes step by step; in rational arithmetic it is 1-D."""
    variance, seen, steps = Fraction(5, 2), Fraction(7, 4), 3
    model, s, z = line(motion, cov=0.0, noise=0.0, mean=mean, prior=float(variance))
    graph = pgm.compile(model, steps, method=pgm.Balanced())
    found = pgm.infer(graph, {z: pgm.sightings([[float(seen)]], [2])}, schedule=schedule)
    # s_t = motionᵗ s₀ for one Gaussian number s₀, which the reading s₂ tells exactly.
    scale = [Fraction(motion) ** t for t in range(steps + 1)]
    open_ = [(g * mean, g**2 * variance) for g in scale]
    told = [(g * seen / scale[2], Fraction(0)) for g in scale]
    due = {
        found.predicted[s]: open_[:3] + told[3:],
        found.filtered[s]: open_[:2] + told[2:],
        found[s]: told if schedule == pgm.Smoothing() else open_[:2] + told[2:],
    }
    for belief, moments in due.items():
        expected = np.array(moments, dtype=float)
        np.testing.assert_allclose(belief.mean[:, 0], expected[:, 0], rtol=1e-15)
        np.testing.assert_allclose(belief.cov[:, 0, 0], expected[:, 1], rtol=1e-15)
    spread = scale[2] ** 2 * variance
    level = (seen - scale[2] * mean) ** 2 / spread
    assert_log(found.log_evidence, -0.5 * (float(level) + np.log(2 * np.pi * float(spread))), 1e-13)
    joint = found.joint(s.at(0), s.at(3)) if schedule == pgm.Smoothing() else None
    assert joint is None or not joint.cov.any()


@pytest.mark.parametrize("schedule", SCHEDULES, ids=str)
def test_exact_readings_of_a_motion_without_noise_that_differ(schedule):
    model, _, z = line(cov=0.0, noise=0.0)
    graph = pgm.compile(model, 3, method=pgm.Balanced())
    with pytest.raises(pgm.NumericalError, match=r"step 3, run 0, contradicts an exact") as caught:
        pgm.infer(graph, {z: pgm.sightings([[1.0], [1.5]], [2, 3])}, schedule=schedule)
    assert (caught.value.step, caught.value.run) == (3, 0)


def test_an_indefinite_noise_has_no_element():
    """Ten random points leave a covariance that only the prediction makes proper, or does not."""
    evidence, start = drive(seed=8)
    few = pgm.MonteCarlo(10, prior_moments=True, seed=3)
    model = network(POSITION.cpd(), transition=drive_cpd(lineariser=few, cov=1e-9 * np.eye(3)))
    seen = {u: evidence[u], POSITION.z: pgm.sightings(start[x][1:, :2], np.arange(1, T + 1))}
    graph = pgm.compile(model, T, method=pgm.Balanced())
    with pytest.raises(pgm.NumericalError, match="indefinite"):
        pgm.infer(graph, seen, start=start, schedule=pgm.Smoothing(3))
