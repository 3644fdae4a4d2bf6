"""Windows of a fixed lag, linearised again: against textbooks, the dense joint, fixed points."""

import numpy as np
import pytest
from carts import drawn, fix, lagged, place, push, speed
from crossed import crossed, slow_after
from numpy.testing import assert_allclose
from robots import DRIVE, P0, SENSORS, Q, m, network, sighted, u, x
from textbooks import assert_belief, assert_covs, assert_log, assert_means, wrapped
from zoo import MODELS, RULES, assert_same, of, recording
from zoo import T as STEPS

import pgm

SIGHT = SENSORS["range_bearing"]
z = SIGHT.z
ROBOT = network(SIGHT.cpd())


@pytest.mark.parametrize("lag", [1, 4])
@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Cubature()], ids=str)
def test_no_reading_counts_twice(rule, lag):
    """However often CPDs are linearised: linear functions have one linearisation alone."""
    model, evidence, steps, due = drawn(11, nonlinear=True)
    found = lagged(model, evidence, lag, steps, rule, iterations=6, tolerance=0.0)
    # Derivatives of a trace are exact, and so is the second iteration; of others it may be.
    assert 2 <= found.status.iterations <= (2 if rule == pgm.Taylor() else 6)
    assert (found.status.residuals < 1e-6).all()
    assert found.log_evidence_kind == "linearised"
    for run in range(2):
        for t in range(steps + 1):
            mean, cov, _ = due(run, min(t + lag, steps), place.at(t), speed.at(t))
            belief = found.joint(place.at(t), speed.at(t))
            assert_means(belief.mean[run], mean, cov, 1e-8)
            assert_covs(belief.cov[run], cov, 1e-8)
            mean, cov, _ = due(run, t, place.at(t))
            assert_means(found.filtered[place.at(t)].mean[run], mean, cov, 1e-8)
        assert_log(found.log_evidence[run], due(run, steps)[2], 1e-8)


@pytest.mark.parametrize("iterations", [1, 6])
def test_joints_and_clusters_know_what_their_latest_step_knows(iterations):
    lag = 2
    model, evidence, steps, due = drawn(12, nonlinear=True)
    found = lagged(model, evidence, lag, steps, iterations=iterations)
    for scope in (
        (place.at(2), speed.at(2)),
        (speed.at(5), push.at(3), place.at(1)),
        (place.at(0), place.at(steps)),
        (push.at(6), place.at(7)),
    ):
        last = min(max(v.step for v in scope) + lag, steps)
        mean, cov, _ = due(1, last, *scope)
        joint = found.joint(*scope)
        assert_means(joint.mean[1], mean, cov, 1e-7)
        assert_covs(joint.cov[1], cov, 1e-7)
    for cluster in (0, 3, steps):
        belief = found.belief(cluster)
        last = min(cluster + lag, steps)
        assert_allclose(belief.log_integral[1], due(1, last)[2], rtol=1e-7)
        mean, cov, _ = due(1, last, *belief.scope)
        assert_means(belief.gaussian().mean[1], mean, cov, 1e-6)
    assert found.message(3, 4).scope == (speed.at(3), place.at(3))
    with pytest.raises(pgm.GraphError, match=r"was not sent, since the posterior is fixed-lag \(2"):
        found.message(4, 3)
    ours = found.innovations[fix]
    theirs = pgm.filter(model, evidence, steps=steps).innovations[fix]
    assert_allclose(ours.residual, theirs.residual, atol=1e-8)
    assert_allclose(ours.nis, theirs.nis, rtol=1e-7)


def textbook(evidence, lag, iterations, steps):
    """The windows of one run, their normal equations written down: newest and lagged beliefs.

    A window is solved for all its states at once, about the points where its CPDs are linearised.
    """
    prior, newest, oldest, at = (np.zeros(3), P0), [(np.zeros(3), P0)], {}, {}
    commands, seen = evidence[u], evidence[z]

    def linearised(k):
        """Move k's slope and offset at x[k−1], and the readings of step k at x[k]."""
        before, here = at[k]
        slope = DRIVE.by_state(before, commands[k - 1])
        parts = [(slope, DRIVE(before, commands[k - 1]) - slope @ before)]
        for row in np.flatnonzero(seen.step == k):
            mark = seen.given[m][row]
            slope = SIGHT.by_state(here, mark)
            off = wrapped(seen.values[row] - SIGHT.function(here, mark), z.angle_mask)
            parts.append((slope, off + slope @ here))
        return parts

    def solve(first, last, prior):
        size = 3 * (last - first + 1)
        K, h = np.zeros((size, size)), np.zeros(size)
        inverse = np.linalg.inv(prior[1])
        K[:3, :3], h[:3] = inverse, inverse @ prior[0]
        for k in range(first + 1, last + 1):
            (slope, offset), *readings = linearised(k)
            two = slice(3 * (k - first - 1), 3 * (k - first + 1))
            row, weight = np.hstack([-slope, np.eye(3)]), np.linalg.inv(Q)
            K[two, two] += row.T @ weight @ row
            h[two] += row.T @ weight @ offset
            one = slice(3 * (k - first), 3 * (k - first + 1))
            for slope, value in readings:
                weight = np.linalg.inv(SIGHT.cov)
                K[one, one] += slope.T @ weight @ slope
                h[one] += slope.T @ weight @ value
        cov = np.linalg.inv(K)
        return (cov @ h).reshape(-1, 3), cov

    first = 0
    for s in range(1, steps + 1):
        if s - lag > first:
            # The step after the first is left behind, as it was linearised last.
            mean, cov = solve(first, first + 1, prior)
            prior, first = (mean[1], cov[3:, 3:]), first + 1
        before = newest[-1][0]
        at[s] = before, DRIVE(before, commands[s - 1])
        for _ in range(iterations):
            mean, cov = solve(first, s, prior)
            found = {k: (mean[k - first - 1], mean[k - first]) for k in range(first + 1, s + 1)}
            previous, at = at, at | found
        at = previous  # where the last solution was linearised
        newest.append((mean[-1], cov[-3:, -3:]))
        for k in range(first, s + 1):
            own = slice(3 * (k - first), 3 * (k - first + 1))
            oldest[k] = mean[k - first], cov[own, own]
    return newest, [oldest[k] for k in range(steps + 1)]


@crossed(("lag", "iterations"), [1, 3, 12], [2, 5])
def test_windows_are_the_textbook_s(lag, iterations):
    """With a lag of one, the dynamically iterated extended Kalman filter."""
    evidence = sighted()
    found = lagged(ROBOT, evidence, lag, iterations=iterations, tolerance=0.0)
    newest, oldest = textbook(evidence, lag, iterations, 12)
    for belief, due in ((found.filtered[x], newest), (found[x], oldest)):
        mean, cov = (np.array([each[k] for each in due]) for k in (0, 1))
        assert_belief(belief, mean, cov, 1e-8)


def test_the_dynamically_iterated_filter_linearises_the_motion_where_the_reading_says():
    """Kullberg, Skog & Hendeby, 2023, algorithm 1, written down for a cube that is hardly known."""
    position, reading = pgm.variables("position reading")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(position, 1.0, 0.5)],
        [pgm.NonlinearGaussianCPD(position, (position.previous,), lambda x: 0.3 * x**3, cov=0.01)],
        [pgm.LinearGaussianCPD(reading, {position: 1.0}, cov=0.02)],
    )
    values = np.array([[0.7], [0.2], [0.05], [0.3]])
    found = pgm.smooth(model, {reading: values}, lag=1, iterations=8, tolerance=0.0)
    mean, cov, due = 1.0, 0.5, []
    for value in values[:, 0]:
        before = mean
        for _ in range(8):
            slope = 0.9 * before**2
            ahead, spread = 0.3 * before**3 + slope * (mean - before), slope**2 * cov + 0.01
            gain = spread / (spread + 0.02)
            new, new_cov = ahead + gain * (value - ahead), (1 - gain) * spread
            back = cov * slope / spread
            before = mean + back * (new - ahead)
        mean, cov = new, new_cov
        due.append((mean, cov))
    assert_allclose(found.filtered[position].mean[1:, 0], [mean for mean, _ in due], rtol=1e-9)
    assert_allclose(found.filtered[position].cov[1:, 0, 0], [cov for _, cov in due], rtol=1e-9)
    filtered = pgm.filter(model, {reading: values}, iterations=8)
    assert abs(filtered[position.at(1)].mean - due[0][0]) > 0.01


@pytest.mark.parametrize(
    ("name", "rule"),
    slow_after(
        2,
        [
            ("plain", "taylor"),
            ("wrapping drive", "cubature"),
            ("grouped", "cubature"),
            ("everything", "taylor"),
        ],
    ),
)
def test_windows_that_cover_the_record_end_where_the_iterated_smoother_does(name, rule):
    evidence = recording(name)
    options = {"iterations": 60, "tolerance": 1e-11}
    found = lagged(MODELS[name], evidence, STEPS + 1, rule=RULES[rule], **options)
    due = pgm.smooth(MODELS[name], evidence, lineariser=RULES[rule], **options)
    assert found.status.converged.all()
    assert due.status.converged.all()
    kinds = "smoothed", "predicted"
    assert_same(of(found, kinds=kinds), of(due, kinds=kinds), 1e-8)


@pytest.mark.parametrize("damping", [0.0, 0.4, pgm.LevenbergMarquardt()], ids=repr)
def test_each_run_of_a_batch_is_that_run_alone(damping):
    """Runs settle after iterations of their own, and those that have do not move."""
    evidence = sighted(runs=3)
    options = {"lag": 2, "iterations": 20, "tolerance": 1e-3, "damping": damping}
    batch = pgm.smooth(ROBOT, evidence, **options)
    for run in range(3):
        seen = evidence[z]
        own = {u: evidence[u], z: pgm.sightings(seen.values[run], seen.step, seen.given)}
        alone = pgm.smooth(ROBOT, own, **options)
        for ours, theirs in ((batch[x], alone[x]), (batch.filtered[x], alone.filtered[x])):
            assert_means(ours.mean[run], theirs.mean, theirs.cov, 1e-9)
            assert_covs(ours.cov[run], theirs.cov, 1e-9)
        assert_log(batch.log_evidence[run], alone.log_evidence, 1e-9)
        assert batch.status.converged[run] == alone.status.converged
    assert batch.status.iterations == len(batch.status.residuals) + 1 < 20


def test_dampings_end_at_the_same_points():
    evidence, options = sighted(seed=4), {"lag": 3, "iterations": 80, "tolerance": 1e-10}
    due = pgm.smooth(ROBOT, evidence, **options)
    for damping in (0.4, pgm.LevenbergMarquardt()):
        found = pgm.smooth(ROBOT, evidence, damping=damping, **options)
        assert found.status.converged
        assert_belief(found[x], due[x].mean, due[x].cov, 1e-7)
        assert_belief(found.filtered[x], due.filtered[x].mean, due.filtered[x].cov, 1e-7)


def test_step_control_finds_the_least_cost_of_a_window_where_plain_iterations_swing():
    """The second window begins at a belief, whose share of the cost counts."""
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, 2.0, 2.0)],
        [pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.3)],
        [pgm.NonlinearGaussianCPD(b, (a,), lambda a: np.arctan(a), cov=0.001)],
    )
    evidence = {b: np.array([[-0.2], [-0.4]])}
    options = {"lag": 1, "iterations": 60, "tolerance": 1e-10}
    with pytest.warns(pgm.ConvergenceWarning, match="had not settled"):
        swung = pgm.smooth(model, evidence, **options)
    assert not swung.status.converged
    found = pgm.smooth(model, evidence, damping=pgm.LevenbergMarquardt(), **options)
    assert found.status.converged
    prior, due = (2.0, 2.3), []
    for value in (-0.2, -0.4):
        grid = np.linspace(-3.0, 3.0, 600_001)
        cost = (grid - prior[0]) ** 2 / prior[1] + (value - np.arctan(grid)) ** 2 / 0.001
        mean = grid[np.argmin(cost)]
        cov = 1.0 / (1.0 / prior[1] + (1.0 / (1.0 + mean**2)) ** 2 / 0.001)
        due.append((mean, cov))
        prior = mean, cov + 0.3
    assert_allclose(found.filtered[a].mean[1:, 0], [mean for mean, _ in due], atol=2e-5)
    assert_allclose(found.filtered[a].cov[1:, 0, 0], [cov for _, cov in due], rtol=1e-3)


def test_a_status_tells_of_all_windows():
    with pytest.warns(pgm.ConvergenceWarning, match="after 2 linearisations"):
        found = pgm.smooth(ROBOT, sighted(), lag=3, iterations=2, tolerance=1e-12)
    assert not found.status.converged
    assert found.status.residuals.shape == (1,)
    assert repr(found.status).startswith("Status(2 iterations, 0 of 1 runs converged, last resid")
    settled = pgm.smooth(ROBOT, sighted(), lag=3, iterations=60, tolerance=1e-6)
    assert settled.status.converged
    assert settled.status.residuals[-1] <= 1e-6
    once = pgm.smooth(ROBOT, sighted(), lag=3)
    assert repr(once.status) == "Status(linearised once, not iterated)"
