"""Relinearised updates against a textbook iterated filter, and against the mode of each step."""

import numpy as np
import pytest
from crossed import crossed
from robots import DRIVE, LANDMARKS, P0, SENSORS, controls, drive_along, m, network, u, x
from robots import Q as NOISE
from scipy.optimize import minimize
from textbooks import assert_belief, assert_log, assert_same, log_normal, stacked, wrapped

import pgm

SIGHT = SENSORS["range_bearing"]
T = 12


@pytest.fixture(scope="module")
def drive():
    """Commands, and sightings of up to three landmarks a step, sorted."""
    rng = np.random.default_rng(4)
    commands = controls(rng, T)
    states = drive_along(commands, rng)
    step = np.sort(rng.integers(0, T + 1, 22))
    which = rng.integers(0, 3, step.size)
    return commands, step, which, SIGHT.draw(states[step], LANDMARKS[which], rng)


def evidence(drive):
    commands, step, which, values = drive
    return {u: commands, SIGHT.z: pgm.sightings(values, step, {m: LANDMARKS[which]})}


def taylor(function, jacobian, mean, cov):
    slope = jacobian(mean)
    return slope, function(mean) - slope @ mean, np.zeros((slope.shape[0],) * 2)


def cubature(function, jacobian, mean, cov):
    """F, b and the error of a regression on 2n points, angles of the values about the first."""
    n = mean.size
    arms = np.sqrt(n) * np.linalg.cholesky(cov).T
    points = mean + np.vstack([arms, -arms])
    centre = function(mean)
    values = centre + wrapped(function(points) - centre, np.array([False, True]))
    deviation = values - values.mean(0)
    slope = np.linalg.solve(cov, (points - mean).T @ deviation / (2 * n)).T
    left = deviation - (points - mean) @ slope.T
    return slope, values.mean(0) - slope @ mean, left.T @ left / (2 * n)


def iterated(rule, drive, iterations, damping=0.0):
    """An iterated filter: each update starts again from the predicted belief."""
    commands, step, which, values = drive
    mean, cov, log, beliefs = np.zeros(3), P0, 0.0, []
    for t in range(T + 1):
        if t:
            slope = DRIVE.by_state(mean, commands[t - 1])
            if rule is taylor:
                mean, cov = DRIVE(mean, commands[t - 1]), slope @ cov @ slope.T + NOISE
            else:
                arms = np.sqrt(3) * np.linalg.cholesky(cov).T
                moved = DRIVE(mean + np.vstack([arms, -arms]), np.tile(commands[t - 1], (6, 1)))
                mean = moved.mean(0)
                cov = (moved - mean).T @ (moved - mean) / 6 + NOISE
        seen = [SIGHT.seen(values[k], LANDMARKS[which[k]]) for k in np.flatnonzero(step == t)]
        predicted, at = (mean, cov), (mean, cov)
        for _ in range(iterations if seen else 0):
            parts = [rule(r.function, r.jacobian, *at) for r in seen]
            slope = np.concatenate([part[0] for part in parts])
            whole = stacked(seen)
            value = np.concatenate([F @ at[0] + b for F, b, _ in parts])
            noise = whole.cov.copy()
            for k, part in enumerate(parts):
                noise[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += part[2]
            residual = wrapped(whole.value - value, whole.angles) + slope @ (at[0] - predicted[0])
            predictive = slope @ predicted[1] @ slope.T + noise
            gain = predicted[1] @ slope.T @ np.linalg.inv(predictive)
            mean = predicted[0] + gain @ residual
            cov = predicted[1] - gain @ slope @ predicted[1]
            old, new = at, (mean, cov)
            at = tuple(damping * a + (1 - damping) * b for a, b in zip(old, new, strict=True))
        if seen:
            log += log_normal(residual, predictive)
        beliefs.append((mean, cov))
    return np.array([b[0] for b in beliefs]), np.array([b[1] for b in beliefs]), log


@pytest.mark.parametrize("iterations", [1, 2, 5])
@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize("rule", [taylor, cubature])
def test_the_textbook(drive, rule, iterations, damping):
    mean, cov, log = iterated(rule, drive, iterations, damping)
    posterior = pgm.filter(
        network(SIGHT.cpd()),
        evidence(drive),
        lineariser={taylor: pgm.Taylor(), cubature: pgm.Cubature()}[rule],
        iterations=iterations,
        tolerance=0.0,
        damping=damping,
    )
    assert_belief(posterior[x], mean, cov, 1e-8)
    assert_log(posterior.log_evidence, log, 1e-8)
    assert posterior.status.iterations == iterations
    assert posterior.status.residuals.shape == (iterations - 1,)


def test_iterating_matters_here(drive):
    """Else the test above would say nothing."""
    once, often = (iterated(taylor, drive, k)[0] for k in (1, 5))
    assert np.abs(once - often).max() > 1e-3


def one_step(value, cov=0.02, landmark=(1.0, 2.0)):
    """A wide prior and one sharp sighting of a near landmark."""
    prior = pgm.GaussianCPD(x, mean=[0, 0, 0], cov=np.diag([0.4, 0.4, 0.2]))
    given = {m: np.array([landmark])}
    return network(SIGHT.cpd(cov=cov * np.eye(2)), prior=prior), {
        u: np.zeros((0, 2)),
        SIGHT.z: pgm.sightings([value], [0], given),
    }


@pytest.mark.parametrize("damping", [0.0, 0.5, pgm.LevenbergMarquardt()], ids=str)
def test_with_taylor_a_step_ends_at_its_mode(damping):
    value, landmark = np.array([1.2, 1.4]), np.array([1.0, 2.0])
    model, seen = one_step(value)

    def cost(state):
        left = wrapped(value - SIGHT.function(state, landmark), np.array([False, True]))
        return state @ (state / [0.4, 0.4, 0.2]) + left @ left / 0.02

    due = minimize(cost, np.zeros(3), method="BFGS", options={"gtol": 1e-9}).x
    posterior = pgm.filter(model, seen, iterations=200, tolerance=1e-10, damping=damping)
    assert posterior.status.converged
    np.testing.assert_allclose(posterior[x].mean[0], due, atol=1e-6)
    plain = pgm.filter(model, seen)
    assert np.abs(plain[x].mean[0] - due).max() > 1e-3


def test_readings_of_a_linear_sensor_need_no_second_look():
    model = network(SENSORS["pose"].cpd())
    linear = pgm.LinearGaussianCPD(SENSORS["pose"].z, {x: 1.0}, cov=0.1 * np.eye(3))
    model = model.replace(observation=[linear])
    seen = {u: np.tile([1.0, 0.1], (3, 1)), linear.child: np.zeros((3, 3))}
    posterior = pgm.filter(model, seen, iterations=9)
    assert posterior.status.iterations == 1
    assert posterior.status.converged
    assert_same(posterior[x], pgm.filter(model, seen)[x], 0.0)


@pytest.mark.parametrize("damping", [0.0, 0.5, pgm.LevenbergMarquardt()], ids=str)
def test_a_batch_equals_its_single_runs(drive, damping):
    commands, step, which, values = drive
    rng = np.random.default_rng(0)
    many = values + rng.normal(0.0, 0.1, (5, *values.shape))
    many[1, :9] = np.nan
    many[2] = np.nan
    asked = {"iterations": 30, "tolerance": 1e-4, "damping": damping}
    model, given = network(SIGHT.cpd()), {m: LANDMARKS[which]}
    batch = pgm.filter(model, {u: commands, SIGHT.z: pgm.sightings(many, step, given)}, **asked)
    for run in range(5):
        seen = {u: commands, SIGHT.z: pgm.sightings(many[run], step, given)}
        single = pgm.filter(model, seen, **asked)
        assert_same(batch[x].run(run), single[x])
        assert_log(batch.log_evidence[run], single.log_evidence)
        assert batch.status.converged[run] == single.status.converged
        last = batch.status.residuals[: len(single.status.residuals), run]
        np.testing.assert_allclose(last, single.status.residuals, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("damping", [0.0, pgm.LevenbergMarquardt()], ids=str)
@pytest.mark.parametrize("grouped", [False, True])
def test_the_order_of_sightings_is_nothing(drive, grouped, damping):
    commands, step, which, values = drive
    model = network(SIGHT.cpd(grouped=grouped))
    asked = {"lineariser": pgm.Unscented(), "iterations": 4, "tolerance": 0, "damping": damping}
    mixed = np.random.default_rng(1).permutation(step.size)
    found = [
        pgm.filter(
            model,
            {u: commands, SIGHT.z: pgm.sightings(values[k], step[k], {m: LANDMARKS[which[k]]})},
            **asked,
        )
        for k in (np.arange(step.size), mixed)
    ]
    assert_same(found[0][x], found[1][x])


@crossed(("damping", "grouped"), [0.2, 0.0, pgm.LevenbergMarquardt()], [True, False])
def test_online_is_the_same(drive, damping, grouped):
    commands, step, which, values = drive
    model, schedule = network(SIGHT.cpd(grouped=grouped)), pgm.Filtering(5, 0, damping)
    recorded = pgm.infer(
        pgm.compile(model, steps=T), evidence(drive), schedule=schedule, lineariser=pgm.Cubature()
    )
    robot = pgm.OnlineFilter(model, pgm.Cubature(), schedule)
    belief = robot.initial()
    for t in range(T + 1):
        if t:
            belief = robot.predict(belief, {u: commands[t - 1]})
        now = step == t
        seen = pgm.sightings(values[now], given={m: LANDMARKS[which[now]]})
        belief = robot.update(belief, {SIGHT.z: seen})
        assert_same(belief[x], recorded[x.at(t)])
    assert_log(belief.log_evidence, recorded.log_evidence)


def test_an_online_filter_does_not_smooth():
    with pytest.raises(pgm.ModelError, match=r"takes pgm.Filtering\(...\) or .*, not Smoothing"):
        pgm.OnlineFilter(network(), pgm.Taylor(), pgm.Smoothing())
