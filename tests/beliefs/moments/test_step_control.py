"""Levenberg–Marquardt where it could go wrong: exact CPDs, edges of domains, odd batches."""

import numpy as np
import pytest
from robots import LANDMARKS, SENSORS, controls, drive_along, m, network, u, x
from scipy.optimize import brentq
from textbooks import assert_log, assert_same

import pgm
from pgm.beliefs.moments.smoothers.smoother import relinearise
from pgm.beliefs.moments.steps import cost
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.schedules.binding import bind_chain
from pgm.schedules.iteration import Anchor, Point

SIGHT = SENSORS["range_bearing"]
LM = pgm.LevenbergMarquardt()
CONTROLS = pytest.mark.parametrize("damping", [0.0, 0.4, LM], ids=["none", "a share", "LM"])
s, z = pgm.Variable("s"), pgm.Variable("z")
place = pgm.Variable("p", components=("east", "north"))


def far(p):
    return np.hypot(p[..., :1] - 1.0, p[..., 1:] - 2.0)


def walk(s, cov):
    return pgm.LinearGaussianCPD(s, {s.previous: 1.0}, cov=cov)


@CONTROLS
def test_an_exact_reading_is_obeyed(damping):
    """The predicted mean contradicts it, and would be the cheapest point of all."""
    y = pgm.Variable("y")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, [0.0, 0.0], np.eye(2))],
        [walk(place, np.eye(2))],
        [
            pgm.LinearGaussianCPD(y, {place: [[1.0, 0.0]]}, cov=0.0),
            pgm.NonlinearGaussianCPD(z, (place,), far, cov=0.04),
        ],
    )
    seen = {y: pgm.sightings([[3.0]], [0]), z: pgm.sightings([[2.2]], [0])}
    found = pgm.filter(model, seen, steps=0, iterations=60, damping=damping)[place].mean[0]

    def slope(north):
        distance = np.hypot(2.0, north - 2.0)
        return north - (2.2 - distance) * (north - 2.0) / distance / 0.04

    assert found[0] == pytest.approx(3.0, abs=1e-12)
    assert slope(found[1]) == pytest.approx(0.0, abs=1e-6)


@CONTROLS
def test_a_start_need_not_obey_a_static_unknown(damping):
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 1.0, 1.0)],
        [walk(s, 0.0)],
        [pgm.NonlinearGaussianCPD(z, (s,), lambda s: s**2, cov=0.01)],
    )
    start = np.linspace(0.5, 1.5, 6)[:, None]  # explains each reading, and is no static unknown
    seen = {z: start[1:] ** 2}
    asked = {"iterations": 60, "damping": damping, "start": {s: start}}
    posterior = pgm.smooth(model, seen, **asked)
    total = float(seen[z].sum())
    # (s − 1)² + 100 Σ (z − s²)² is stationary
    roots = np.roots([4 * 500.0, 0.0, 2 - 4 * 100 * total, -2.0])
    due = roots[np.argmin(np.abs(roots - 1.0))].real
    np.testing.assert_allclose(posterior[s].mean, due, atol=1e-6)


def test_a_try_outside_the_domain_has_failed():
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 1.0, 9.0)],
        [walk(s, 1.0)],
        [pgm.NonlinearGaussianCPD(z, (s,), np.log, cov=1e-2)],
    )
    seen = {z: pgm.sightings([[[-3.0]], [[0.1]]], [0])}
    found = pgm.filter(model, seen, steps=0, iterations=60, damping=LM)
    value = found[s].mean[:, 0, 0]
    gradient = (value - 1.0) / 9.0 + (np.log(value) - [-3.0, 0.1]) / (0.01 * value)
    np.testing.assert_allclose(gradient, 0.0, atol=1e-5)
    with pytest.raises(pgm.LinearisationError, match="NaN or infinite"):
        pgm.filter(model, seen, steps=0, iterations=60)


def plan_of(model, seen, steps, rule):
    return ChainPlan.make(pgm.compile(model, steps), bind_chain(model, seen, steps), rule)


def test_the_cost_is_that_of_the_expected_function():
    """E s³ = μ³ + 3 μ P, which Gauss–Hermite knows exactly, and a Taylor expansion does not."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 0.0, 4.0)],
        [walk(s, 1.0)],
        [pgm.NonlinearGaussianCPD(z, (s,), lambda s: s**3, cov=0.5)],
    )
    plan = plan_of(model, {z: pgm.sightings([[2.0]], [0])}, 0, pgm.GaussHermite(3))
    mean, spread = np.array([[[1.5]]]), np.array([[[[0.3]]]])
    found = cost.trajectory(plan, Point(mean, spread, np.zeros((0, 1, 2, 2))))
    # The noise is laid out, not linearised yet: the CPD's own.
    due = 1.5**2 / 4 + (2.0 - (1.5**3 + 3 * 1.5 * 0.3)) ** 2 / 0.5
    assert found[0] == pytest.approx(due, rel=1e-12)


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(8)
    commands = controls(rng, 10)
    states = drive_along(commands, rng)
    step = np.sort(rng.integers(0, 11, 18))
    which = rng.integers(0, 3, step.size)
    values = SIGHT.draw(states[step], LANDMARKS[which], rng)
    many = values + rng.normal(0.0, 0.2, (6, *values.shape))
    many[1, ::3] = np.nan
    return commands, step, which, many


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()], ids=str)
def test_a_missing_sighting_of_a_group_is_left_out(drive, rule):
    commands, step, which, many = drive
    model = network(SIGHT.cpd(grouped=True))
    with_gaps = many[1]
    kept = ~np.isnan(with_gaps[:, 0])
    asked = {"lineariser": rule, "iterations": 8, "tolerance": 0, "damping": LM}
    found = [
        pgm.filter(
            model,
            {u: commands, SIGHT.z: pgm.sightings(with_gaps[k], step[k], {m: LANDMARKS[which[k]]})},
            **asked,
        )
        for k in (np.ones(step.size, dtype=bool), kept)
    ]
    assert_same(found[0][x], found[1][x], 1e-8)
    assert_log(found[0].log_evidence, found[1].log_evidence)
    plans = [
        plan_of(
            model,
            {u: commands, SIGHT.z: pgm.sightings(with_gaps[k], step[k], {m: LANDMARKS[which[k]]})},
            10,
            rule,
        )
        for k in (np.ones(step.size, dtype=bool), kept)
    ]
    spread = np.broadcast_to(0.05 * np.eye(3), (11, 1, 3, 3))
    mean = np.broadcast_to([1.0, 1.0, 0.2], (11, 1, 3))
    at = Point(mean, spread, np.broadcast_to(0.05 * np.eye(6), (10, 1, 6, 6)))
    totals = []
    for plan in plans:
        relinearise(plan, at, None)
        totals.append(float(cost.trajectory(plan, at)[0]))
    assert totals[0] == pytest.approx(totals[1], rel=1e-10)
    if rule == pgm.Unscented():  # the group's cross terms count
        plans[0].sensors[0].cross.clear()
        assert float(cost.trajectory(plans[0], at)[0]) != pytest.approx(totals[0], rel=1e-6)


@CONTROLS
@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Cubature()], ids=str)
def test_a_smoothed_batch_equals_its_single_runs(drive, damping, rule):
    commands, step, which, many = drive
    asked = {"iterations": 12, "tolerance": 1e-3, "damping": damping, "lineariser": rule}
    model, given = network(SIGHT.cpd()), {m: LANDMARKS[which]}
    batch = pgm.smooth(model, {u: commands, SIGHT.z: pgm.sightings(many, step, given)}, **asked)
    made = [
        pgm.smooth(model, {u: commands, SIGHT.z: pgm.sightings(one, step, given)}, **asked)
        for one in many
    ]
    assert len({one.status.iterations for one in made}) > 1  # they end at different times
    for run, single in enumerate(made):
        assert_same(batch[x].run(run), single[x])
        assert_log(batch.log_evidence[run], single.log_evidence)
        assert batch.status.converged[run] == single.status.converged


@pytest.mark.parametrize("iterations", [2, 4])
def test_a_share_of_sigma_point_moments_is_kept(iterations):
    """A damped unscented smoother of two steps against one that solves their joint densely."""
    bend, kept = (lambda s: s + 0.3 * np.sin(2 * s)), 0.6
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 0.5, 0.8)],
        [pgm.NonlinearGaussianCPD(s, (s.previous,), bend, cov=0.1)],
        [pgm.NonlinearGaussianCPD(z, (s,), lambda s: s**2, cov=0.2)],
    )

    def line(function, mean, variance):
        """Cubature's: two points of one component."""
        points = mean + np.sqrt(variance) * np.array([1.0, -1.0])
        values = function(points)
        slope = (values[0] - values[1]) / (points[0] - points[1])
        return slope, values.mean() - slope * mean

    def solve(at_mean, at_cov):
        """The joint of both states given both readings, linearised at marginals."""
        F, b = line(bend, at_mean[0], at_cov[0, 0])
        sight = [line(np.square, at_mean[k], at_cov[k, k]) for k in (0, 1)]
        P = 0.8
        mean = np.array([0.5, F * 0.5 + b])
        cov = np.array([[P, P * F], [F * P, F * P * F + 0.1]])
        H = np.diag([h for h, _ in sight])
        S = H @ cov @ H.T + 0.2 * np.eye(2)
        left = np.array([1.1, 0.4]) - H @ mean - [c for _, c in sight]
        gain = cov @ H.T @ np.linalg.inv(S)
        return mean + gain @ left, cov - gain @ H @ cov

    seen = {z: pgm.sightings([[1.1], [0.4]], [0, 1])}
    first = pgm.smooth(model, seen, steps=1, lineariser=pgm.Cubature())
    joint = first.joint(s.at(0), s.at(1))
    mean, cov = at = joint.mean, joint.cov
    for _ in range(iterations - 1):
        mean, cov = solve(*at)
        at = tuple(kept * old + (1 - kept) * new for old, new in zip(at, (mean, cov), strict=True))
    asked = {"lineariser": pgm.Cubature(), "tolerance": 0.0, "iterations": iterations}
    found = pgm.smooth(model, seen, steps=1, damping=kept, **asked).joint(s.at(0), s.at(1))
    np.testing.assert_allclose(found.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(found.cov, cov, rtol=1e-8)


def test_held_means_move_hidden_controls_too():
    """One anchored step, taken apart: joints of held means are those of the marginals."""
    told = pgm.Variable("c")
    push = pgm.Variable("k")

    def grow(s, k):
        return 0.9 * s + 10 * s / (1 + s**2) + k

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 5.0, 4.0)],
        [
            pgm.LinearGaussianCPD(push, {told: 1.0}, cov=1.0),
            pgm.NonlinearGaussianCPD(s, (s.previous, push), grow, cov=0.5),
        ],
        [pgm.NonlinearGaussianCPD(z, (s,), lambda s: s**3 / 20, cov=1.0)],
    )
    commands = 8 * np.cos(1.2 * np.arange(1, 16.0)[:, None])
    seen = model.sample({told: commands}, runs=12, rng=1).evidence
    asked = {"iterations": 8, "tolerance": 0.0}
    held = pgm.smooth(model, seen, damping=LM, **asked)
    plain = pgm.smooth(model, seen, **asked)
    assert np.abs(held[push].mean - plain[push].mean).max() > 0.1
    for earlier, later in ((1, 4), (3, 15)):
        joint = held.joint(push.at(earlier), s.at(later), s.at(earlier))
        due = held[push].mean[:, earlier - 1], held[s].mean[:, later], held[s].mean[:, earlier]
        np.testing.assert_allclose(joint.mean, np.concatenate(due, axis=-1), rtol=1e-8, atol=1e-9)


def test_an_early_step_that_did_not_converge_is_not_forgotten():
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 2.0, 9.0)],
        [walk(s, 1.0)],
        [pgm.NonlinearGaussianCPD(z, (s,), np.arctan, cov=1e-3)],
    )
    seen = {z: pgm.sightings([[0.0]], [0])}
    late = {z: pgm.sightings([[0.0], [np.nan]], [0, 4])}
    for evidence in (seen, late):
        with pytest.warns(pgm.ConvergenceWarning, match="had not settled"):
            posterior = pgm.filter(model, evidence, steps=5, iterations=30)
        assert not posterior.status.converged
        assert posterior.status.residuals[-1] > 1.0


def test_where_no_try_lowers_the_cost_means_stay():
    """One try with next to no weight is a full step again, and that one raises the cost."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 2.0, 9.0)],
        [walk(s, 1.0)],
        [pgm.NonlinearGaussianCPD(z, (s,), np.arctan, cov=1e-3)],
    )
    seen = {z: pgm.sightings([[0.0]], [0])}
    timid = pgm.LevenbergMarquardt(start=1e-9, factor=1.001, tries=1)
    once = pgm.filter(model, seen, steps=0)
    with pytest.warns(pgm.ConvergenceWarning, match="had not settled"):
        stuck = pgm.filter(model, seen, steps=0, iterations=5, damping=timid)
    assert abs(once[s].mean[0, 0]) > 2.0  # the full step overshoots
    assert stuck[s].mean[0, 0] == 2.0
    assert not stuck.status.converged


def test_what_is_certain_is_not_held():
    mean, cov = np.array([[1.0, 2.0]]), np.array([[[0.0, 0.0], [0.0, 4.0]]])
    anchor = Anchor(np.zeros((1, 1, 2)), np.array([[[0.0, 2.0]]]), np.array([1.0]))
    held, spread = anchor.hold(0, mean, cov)
    np.testing.assert_allclose(held, [[1.0, 1.0]])
    np.testing.assert_allclose(spread, [[[0.0, 0.0], [0.0, 2.0]]])
    free = anchor._replace(weight=np.array([0.0])).hold(0, mean, cov)
    np.testing.assert_array_equal(free[0], mean)
    np.testing.assert_array_equal(free[1], cov)


def test_an_online_belief_tells_how_its_update_went():
    model = network(SIGHT.cpd())
    robot = pgm.OnlineFilter(model, schedule=pgm.Filtering(5, 0.0))
    belief = robot.initial()
    assert belief.status.iterations == 1
    assert belief.status.converged
    belief = robot.update(belief, {SIGHT.z: pgm.sightings([[9.0, 1.0]], given={m: LANDMARKS[:1]})})
    assert belief.status.iterations == 5
    assert belief.status.residuals.shape == (4,)
    assert not belief.status.converged
    belief = robot.predict(belief, {u: [1.0, 0.0]})
    assert belief.status.iterations == 1


BENT = np.linspace(-3.5, -4.2, 8)
h = pgm.Variable("h", components=("turn",), angles=("turn",))


def settled(found, beliefs, variance):
    """Whether runs settled at the zeros of the slope of ln p, nearest those of the readings."""

    def slope(at, reading):
        return at / variance + 3.0 * at**2 * (at**3 - reading**3)

    due = [brentq(slope, reading, reading + 0.5, args=(reading,), xtol=1e-14) for reading in BENT]
    assert found.status.converged.all()
    np.testing.assert_allclose(beliefs, due, atol=1e-9)


@pytest.mark.parametrize("variances", [(4.0, 0.01), (0.01, 4.0)], ids=["prior", "motion"])
@pytest.mark.parametrize("compiled", [None, False])
def test_an_angle_that_is_linear_in_others_is_not_wrapped(variances, compiled):
    """Beyond half a turn from its mean, towards which a Gaussian draws it all the same."""
    first, moved = variances
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(h, 0.0, first)],
        [walk(h, moved)],
        [pgm.NonlinearGaussianCPD(z, h, lambda h: h**3, cov=1.0)],
    )
    seen = {z: pgm.sightings(BENT[:, None, None] ** 3, [1])}
    start = {h: [[-3.1 if first > moved else 0.0], [-3.1]]}
    graph = pgm.compile(model, 1, compiled=compiled)
    found = pgm.infer(graph, seen, schedule=pgm.Smoothing(60, 1e-9, LM), start=start)
    settled(found, found[h.at(1)].mean[:, 0], first + moved)


def test_an_angle_of_a_network_without_time_is_not_wrapped_by_its_prior():
    read = pgm.NonlinearGaussianCPD(z, h, lambda h: h**3, cov=1.0)
    graph = pgm.compile(pgm.BayesianNetwork([pgm.GaussianCPD(h, 0.0, 4.0), read]))
    schedule = pgm.Calibration(60, 1e-9, LM)
    found = pgm.infer(graph, {z: BENT[:, None] ** 3}, schedule=schedule, start={h: [-3.1]})
    settled(found, found[h].mean[:, 0], 4.0)
