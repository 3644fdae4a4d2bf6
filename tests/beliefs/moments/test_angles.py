"""Angles: readings on any branch, functions that wrap, and beliefs on one unwrapped chart."""

import numpy as np
import pytest
from robots import DRIVE, LANDMARKS, P0, SENSORS, Q, drive_along, drive_cpd, m, network, u, x
from textbooks import assert_belief, assert_log, assert_means, assert_same, wrap

import pgm
from models import sensors

T = 30
SIGHT, POSE = SENSORS["range_bearing"], SENSORS["pose"]
RULES = [pgm.Taylor(), pgm.Unscented(), pgm.Cubature(), pgm.MonteCarlo(50)]
WAYS = [("filter", 1), ("smooth", 1), ("smooth", 5)]
fix = pgm.Variable("fix", components=x.components, angles=x.angles)
FIXING = pgm.NonlinearGaussianCPD(fix, x, POSE.function, POSE.cov, jacobian={x: POSE.by_state})
rules = pytest.mark.parametrize("rule", RULES, ids=lambda rule: type(rule).__name__)
ways = pytest.mark.parametrize(("way", "iterations"), WAYS)


def infer(model, evidence, rule, way, iterations, **options):
    if way == "filter":
        return pgm.filter(model, evidence, lineariser=rule)
    return pgm.smooth(
        model, evidence, lineariser=rule, iterations=iterations, tolerance=0.0, **options
    )


@pytest.fixture(scope="module")
def circles():
    """Three turns to the left: commands, true states, fixes and sightings, all wrapped."""
    rng = np.random.default_rng(61)
    commands = np.column_stack([rng.uniform(0.5, 1.5, T), np.full(T, 6 * np.pi / T)])
    states = drive_along(commands, rng)
    landmarks = LANDMARKS[rng.integers(0, 3, T)]
    fixes = POSE.draw(states[1:], LANDMARKS[0], rng)
    return commands, states, fixes, landmarks, SIGHT.draw(states[1:], landmarks, rng)


def evidence_of(circles, turns=0.0):
    """`turns` whole turns, an array (T,), are added to every angle that is read."""
    commands, _, fixes, landmarks, seen = circles
    away = 2 * np.pi * np.asarray(turns)
    return {
        u: commands,
        m: landmarks,
        fix: fixes + away[..., None] * x.angle_mask,
        SIGHT.z: seen + away[..., None] * SIGHT.z.angle_mask,
    }


MODEL = network(SIGHT.cpd(), FIXING)


def test_the_readings_cross_the_seam(circles):
    _, _, fixes, _, seen = circles
    for angle in (fixes[:, 2], seen[:, 1]):
        assert angle.min() < -2.5
        assert angle.max() > 2.5


@rules
@ways
def test_posterior_headings_are_unwrapped_and_continuous(circles, rule, way, iterations):
    posterior = infer(MODEL, evidence_of(circles), rule, way, iterations)
    heading, true = posterior[x].mean[:, 2], circles[1][:, 2]
    assert np.abs(heading - true).max() < 1.0, "on the chart that the prior began"
    assert (np.abs(np.diff(heading)) < np.pi).all()
    assert heading[-1] > 5 * np.pi
    shown = posterior[x].wrapped()
    assert (np.abs(shown.mean[:, 2]) <= np.pi).all()
    np.testing.assert_allclose(np.unwrap(shown.mean[:, 2]), heading, atol=1e-9)


@rules
@ways
def test_the_branch_of_a_reading_does_not_matter(circles, rule, way, iterations):
    turns = np.random.default_rng(62).integers(-3, 4, T)
    plain = infer(MODEL, evidence_of(circles), rule, way, iterations)
    moved = infer(MODEL, evidence_of(circles, turns), rule, way, iterations)
    assert_same(moved[x], plain[x])
    assert_log(moved.log_evidence, plain.log_evidence)
    for sensor in (fix, SIGHT.z):
        residual = moved.innovations[sensor].residual
        np.testing.assert_allclose(residual, plain.innovations[sensor].residual, atol=1e-9)


@rules
@ways
def test_a_prior_some_turns_away_takes_all_with_it(circles, rule, way, iterations):
    away = np.array([0, 0, 4 * np.pi])
    plain = infer(MODEL, evidence_of(circles), rule, way, iterations)
    turned = MODEL.replace(prior=[pgm.GaussianCPD(x, away, P0)])
    moved = infer(turned, evidence_of(circles), rule, way, iterations)
    assert_belief(moved[x], plain[x].mean + away, plain[x].cov, 1e-8)
    assert_log(moved.log_evidence, plain.log_evidence)


def wrapping_drive(state, control):
    """The motion, with its heading wrapped as many write it."""
    out = DRIVE(state, control)
    out[..., 2] = wrap(out[..., 2])
    return out


def wrapping(jacobians=True):
    by = {x.previous: DRIVE.by_state} if jacobians else None
    move = pgm.NonlinearGaussianCPD(x, (x.previous, u), wrapping_drive, Q, jacobian=by)
    return network(SIGHT.cpd(), FIXING, transition=move)


def assert_equal_but_for_turns(found, due, tolerance=1e-8):
    mean = found.mean.copy()
    mean[..., 2] += 2 * np.pi * np.round((due.mean[..., 2] - mean[..., 2]) / (2 * np.pi))
    assert_belief(pgm.Gaussian(x, mean, found.cov), due.mean, due.cov, tolerance)


@rules
@ways
@pytest.mark.parametrize("jacobians", [True, False], ids=["by hand", "numerical"])
def test_a_motion_that_wraps_its_heading(circles, rule, way, iterations, jacobians):
    plain_model = MODEL if jacobians else MODEL.replace(transition=[drive_cpd(jacobian=None)])
    plain = infer(plain_model, evidence_of(circles), rule, way, iterations)
    found = infer(wrapping(jacobians), evidence_of(circles), rule, way, iterations)
    assert_equal_but_for_turns(found[x], plain[x])
    assert_log(found.log_evidence, plain.log_evidence, 1e-8)


@ways
def test_a_motion_that_wraps_leaves_the_beliefs_on_one_chart(circles, way, iterations):
    """The design: beliefs live on one unwrapped chart and are never wrapped."""
    found = infer(wrapping(), evidence_of(circles), pgm.Taylor(), way, iterations)
    largest = np.abs(np.diff(found[x].mean[:, 2])).max()
    assert largest < np.pi, f"a heading jumps by {largest:.2f} in a step"


@pytest.mark.parametrize("start", ["unwrapped", "wrapped"])
def test_a_motion_that_wraps_from_a_start(circles, start):
    """Iterated to its end, the smoothing reaches one MAP, whatever wraps."""
    commands = circles[0]
    path = [np.zeros(3)]
    for command in commands:
        path.append(DRIVE(path[-1], command))
    path = np.array(path)
    if start == "wrapped":
        path[:, 2] = wrap(path[:, 2])
    due = pgm.smooth(MODEL, evidence_of(circles), iterations=50)
    found = pgm.smooth(wrapping(), evidence_of(circles), iterations=50, start={x: path})
    assert due.status.converged
    assert found.status.converged
    assert_equal_but_for_turns(found[x], due[x], 1e-6)


def test_joints_across_a_wrap(circles):
    """Covariances between steps know nothing of charts."""
    plain = pgm.smooth(MODEL, evidence_of(circles), iterations=3, tolerance=0.0)
    found = pgm.smooth(wrapping(), evidence_of(circles), iterations=3, tolerance=0.0)
    scope = (x.at(2), x.at(11), x.at(12), x.at(T))
    due = plain.joint(*scope).cov
    np.testing.assert_allclose(found.joint(*scope).cov, due, atol=1e-8 * np.abs(due).max())


# ---- one angle, read once, where wrapping at the wrong place gives another answer

a, z = pgm.Variable("a", angles=("a",)), pgm.Variable("z", angles=("z",))


def tripled(spread, wraps):
    """A reading of three times an angle."""

    def triple(angle):
        return wrap(3 * angle) if wraps else 3 * angle

    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, spread)],
        transition=[pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=1.0)],
        observation=[pgm.NonlinearGaussianCPD(z, a, triple, 0.01)],
    )


@pytest.mark.parametrize("wraps", [True, False])
@pytest.mark.parametrize("turns", [-1, 0, 2])
@pytest.mark.parametrize("iterations", [1, 4])
def test_a_reading_is_moved_to_the_branch_at_the_point_of_linearisation(wraps, turns, iterations):
    """About a = 1.5 the reading 4.4 is near 3a; from the mean 0 the innovation is 4.4, not wrapped.

    To wrap the affine innovation instead would give 4.4 − 2π, and an angle near −0.6.
    """
    seen = pgm.sightings([[4.4 + 2 * np.pi * turns]], step=[0])
    posterior = pgm.smooth(
        tripled(1.0, wraps), {z: seen}, steps=0, start={a: [[1.5]]}, iterations=iterations
    )
    due = 3 * 4.4 / (9 + 0.01)
    np.testing.assert_allclose(posterior[a].mean, [[due]], rtol=1e-9)
    found = posterior.innovations[z]
    np.testing.assert_allclose(found.residual, [[4.4]], rtol=1e-9)
    np.testing.assert_allclose(found.cov, [[[9.01]]], rtol=1e-9)


def test_a_filter_takes_the_branch_at_the_prediction():
    seen = pgm.sightings([[4.4]], step=[0])
    posterior = pgm.filter(tripled(1.0, True), {z: seen}, steps=0)
    near = 4.4 - 2 * np.pi
    np.testing.assert_allclose(posterior[a].mean, [[3 * near / 9.01]], rtol=1e-9)
    np.testing.assert_allclose(posterior.innovations[z].residual, [[near]], rtol=1e-9)


@rules
def test_points_on_both_sides_of_the_seam(rule):
    """A landmark straight behind: the mean bearing is π or −π, its spread that of a front view."""
    mirrored = np.array([-4.0, 0.0])
    z_of = SIGHT.z
    beliefs = []
    for landmark, offset in ((mirrored, np.pi), (mirrored, -np.pi), (mirrored, 3 * np.pi)):
        evidence = {
            z_of: pgm.sightings([[4.1, offset + 0.02]], step=[0], given={m: [landmark]}),
            u: np.zeros((0, 2)),
        }
        beliefs.append(pgm.filter(network(SIGHT.cpd()), evidence, lineariser=rule))
    for other in beliefs[1:]:
        assert_same(other[x], beliefs[0][x])
        assert_log(other.log_evidence, beliefs[0].log_evidence)
    assert abs(beliefs[0][x].mean[0, 2]) < 0.3
    assert beliefs[0].innovations[z_of].cov[0, 1, 1] < 0.5


def test_a_linear_reading_of_a_heading_is_moved_too():
    """Evidence of an angle is moved for linear CPDs as for others."""
    heading = pgm.LinearGaussianCPD(z, {x: [[0, 0, 1.0]]}, cov=0.01)
    model = network(heading, prior=pgm.GaussianCPD(x, [0, 0, 9.0], P0))
    posterior = pgm.filter(model, {u: np.zeros((0, 2)), z: pgm.sightings([[wrap(9.1)]], step=[0])})
    np.testing.assert_allclose(posterior.innovations[z].residual, [[0.1]], atol=1e-12)
    assert_means(
        posterior[x].mean[:, 2:], np.array([[9.0 + 0.1 * 0.05 / 0.06]]), posterior[x].cov[:, 2:, 2:]
    )


@pytest.mark.parametrize("way", [pgm.filter, pgm.smooth])
def test_linear_readings_are_moved_at_every_step(way):
    """A compass of a steady turn: its innovations are those of readings that were never wrapped."""
    h, c = (pgm.Variable(name, ("angle",), angles=("angle",)) for name in "hc")
    turning = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(h, 0.0, 0.1)],
        [pgm.LinearGaussianCPD(h, {h.previous: 1.0}, offset=1.0, cov=0.01)],
        [pgm.LinearGaussianCPD(c, {h: 1.0}, cov=0.01)],
    )
    values = np.arange(1.0, 11.0)[:, None] + 0.02 * np.cos(np.arange(10))[:, None]
    plain = way(turning, {c: values})
    found = way(turning, {c: (values + np.pi) % (2 * np.pi) - np.pi})
    np.testing.assert_allclose(found[h].mean, plain[h].mean, atol=1e-12)
    residual = found.innovations[c].residual
    np.testing.assert_allclose(residual, plain.innovations[c].residual, atol=1e-12)
    assert np.abs(residual).max() < 0.1


def test_runs_take_branches_of_their_own(circles):
    turns = np.random.default_rng(63).integers(-2, 3, (4, T))
    batch = pgm.smooth(MODEL, evidence_of(circles, turns), iterations=3, tolerance=0.0)
    alone = pgm.smooth(MODEL, evidence_of(circles), iterations=3, tolerance=0.0)
    for run in range(4):
        assert_belief(alone[x], batch[x].mean[run], batch[x].cov[run])


def test_online_headings_stay_on_their_chart(circles):
    commands, states, fixes, landmarks, seen = circles
    robot = pgm.OnlineFilter(MODEL)
    belief, headings = robot.initial(), []
    for k in range(T):
        belief = robot.predict(belief, {u: commands[k]})
        sighting = pgm.sightings(seen[k : k + 1], given={m: landmarks[k : k + 1]})
        belief = robot.update(belief, {fix: fixes[k], SIGHT.z: sighting})
        headings.append(belief[x].mean[2])
    assert np.abs(headings - states[1:, 2]).max() < 1.0
    filtered = pgm.filter(MODEL, evidence_of(circles))
    np.testing.assert_allclose(headings, filtered[x].mean[1:, 2], atol=1e-9)


def test_the_models_bearing_is_wrapped():
    """A guard: else these tests would not meet the seam in the function."""
    behind = sensors.range_bearing(np.array([0, 0, 2.0]), np.array([-1.0, -0.1]))
    assert -np.pi <= behind[1] < np.pi
