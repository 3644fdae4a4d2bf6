"""Innovations, evidence, status and the other things that a posterior tells."""

import numpy as np
import pytest
from robots import LANDMARKS, P0, SENSORS, Q, controls, drive_along, m, moves, network, u, x
from scipy.linalg import block_diag
from scipy.stats import chi2
from textbooks import (
    assert_belief,
    assert_log,
    assert_same,
    log_normal,
    run_filter,
    run_smoother,
    taylor,
    unscented,
    wrapped,
)

import pgm
from pgm.examples import walk, z

T = 20
SIGHT, POSE = SENSORS["range_bearing"], SENSORS["pose"]
RULES = {"taylor": (pgm.Taylor(), taylor), "unscented": (pgm.Unscented(), unscented)}


@pytest.fixture(scope="module")
def drive():
    """Commands, and one sighting at most of the steps, in no order."""
    rng = np.random.default_rng(51)
    commands = controls(rng, T)
    states = drive_along(commands, rng)
    step = rng.permutation(T + 1)[:15]
    landmarks = LANDMARKS[rng.integers(0, 3, step.size)]
    return commands, step, landmarks, SIGHT.draw(states[step], landmarks, rng)


def evidence_of(commands, step, landmarks, values):
    return {u: commands, SIGHT.z: pgm.sightings(values, step=step, given={m: landmarks})}


@pytest.mark.parametrize("rule", RULES)
def test_innovations_one_a_step(drive, rule):
    commands, step, landmarks, values = drive
    lineariser, twin = RULES[rule]
    seen = [None] * (T + 1)
    for k, value, landmark in zip(step, values, landmarks, strict=True):
        seen[k] = SIGHT.seen(value, landmark)
    due = run_filter(twin, np.zeros(3), P0, moves(commands), seen)
    for infer in (pgm.filter, pgm.smooth):
        posterior = infer(network(SIGHT.cpd()), evidence_of(*drive), lineariser=lineariser)
        found = posterior.innovations[SIGHT.z]
        assert found.step.tolist() == step.tolist()
        total = 0.0
        for row, k in enumerate(step):
            residual, cov = due.innovations[k]
            np.testing.assert_allclose(found.residual[row], residual, atol=1e-9)
            np.testing.assert_allclose(found.cov[row], cov, atol=1e-9 * np.abs(cov).max())
            nis = residual @ np.linalg.solve(cov, residual)
            np.testing.assert_allclose(found.nis[k], nis, rtol=1e-8, atol=1e-9)
            total += log_normal(found.residual[row], found.cov[row])
        assert_log(posterior.log_evidence, total)
        read = np.isin(np.arange(T + 1), step)
        assert (found.dof == np.where(read, 2, 0)).all()
        assert np.isnan(found.nis[~read]).all()


def test_innovations_of_several_sightings_a_step():
    """The normalised square is that of the stacked vector, whose sightings are correlated."""
    rng = np.random.default_rng(52)
    commands = controls(rng, 3)
    step, which = np.array([2, 1, 2, 2, 1]), np.array([0, 1, 2, 1, 0])
    values = SIGHT.draw(drive_along(commands, rng)[step], LANDMARKS[which], rng)
    values[3] = np.nan
    fix = pgm.Variable("fix", components=x.components, angles=x.angles)
    fixing = pgm.NonlinearGaussianCPD(fix, x, POSE.function, POSE.cov)
    evidence = evidence_of(commands, step, LANDMARKS[which], values)
    evidence[fix] = np.array([[0.5, 0, 0.1], [1.5, 0.2, 0.3], [np.nan] * 3])
    posterior = pgm.smooth(network(SIGHT.cpd(), fixing), evidence)
    found = posterior.innovations[SIGHT.z]
    assert np.isnan(found.residual[3]).all()
    assert np.isnan(found.cov[3]).all()
    for k, rows in ((1, [1, 4]), (2, [0, 2])):
        at = posterior.predicted[x.at(k)]
        given = [LANDMARKS[which[row]] for row in rows]
        H = np.vstack([SIGHT.by_state(at.mean, landmark) for landmark in given])
        r = [
            wrapped(values[row] - SIGHT.function(at.mean, landmark), SIGHT.z.angle_mask)
            for row, landmark in zip(rows, given, strict=True)
        ]
        S = H @ at.cov @ H.T + block_diag(SIGHT.cov, SIGHT.cov)
        np.testing.assert_allclose(found.residual[rows], r, atol=1e-12)
        np.testing.assert_allclose(found.cov[rows[0]], S[:2, :2], atol=1e-12)
        np.testing.assert_allclose(found.cov[rows[1]], S[2:, 2:], atol=1e-12)
        nis = np.ravel(r) @ np.linalg.solve(S, np.ravel(r))
        np.testing.assert_allclose(found.nis[k], nis, rtol=1e-9)
        assert found.dof[k] == 4
    other = posterior.innovations[fix]
    assert other.step.tolist() == [1, 2, 3]
    assert other.dof.tolist() == [0, 3, 3, 0]
    assert np.isnan(other.nis[[0, 3]]).all()


def test_innovations_differ_by_run(drive):
    commands, step, landmarks, values = drive
    many = np.stack([values, values + 0.1])
    many[1, 4] = np.nan
    posterior = pgm.filter(network(SIGHT.cpd()), evidence_of(commands, step, landmarks, many))
    found = posterior.innovations[SIGHT.z]
    assert found.residual.shape == (2, 15, 2)
    assert found.cov.shape == (2, 15, 2, 2)
    assert found.nis.shape == found.dof.shape == (2, T + 1)
    alone = pgm.filter(network(SIGHT.cpd()), evidence_of(*drive)).innovations[SIGHT.z]
    np.testing.assert_allclose(found.residual[0], alone.residual, atol=1e-12)
    assert found.dof[1, step[4]] == 0
    assert np.isnan(found.nis[1, step[4]])
    assert np.isnan(found.residual[1, 4]).all()


def test_no_sightings_at_all():
    evidence = {
        u: np.ones((3, 2)),
        SIGHT.z: pgm.sightings(np.zeros((0, 2)), [], {m: np.zeros((0, 2))}),
    }
    found = pgm.smooth(network(SIGHT.cpd()), evidence).innovations[SIGHT.z]
    assert found.residual.shape == (0, 2)
    assert found.cov.shape == (0, 2, 2)
    assert found.dof.tolist() == [0, 0, 0, 0]
    assert np.isnan(found.nis).all()


def test_normalised_innovations_are_chi_square_on_a_linear_model():
    """Drawn from the model: 200 runs of 20 steps with two readings each; 1 in 10⁵ by chance."""
    rng, runs = np.random.default_rng(53), 200
    line, z = pgm.Variable("line", components=("p", "v")), pgm.Variable("z", components=("p", "q"))
    F, H = np.array([[1, 1.0], [0, 0.9]]), np.array([[1.0, 0], [1, 1]])
    G, R, start = np.diag([0.1, 0.2]), np.array([[0.3, 0.1], [0.1, 0.2]]), np.diag([1.0, 2.0])
    state = rng.multivariate_normal([0, 0], start, runs)
    rows = []
    for _ in range(T):
        state = state @ F.T + rng.multivariate_normal([0, 0], G, runs)
        rows += [state @ H.T + rng.multivariate_normal([0, 0], R, runs) for _ in range(2)]
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(line, [0, 0], start)],
        [pgm.LinearGaussianCPD(line, {line.previous: F}, cov=G)],
        [pgm.LinearGaussianCPD(z, {line: H}, cov=R)],
    )
    seen = pgm.sightings(np.stack(rows, axis=1), step=np.repeat(np.arange(1, T + 1), 2))
    found = pgm.filter(model, {z: seen}, steps=T).innovations[z]
    total, dof = np.nansum(found.nis), found.dof.sum()
    assert dof == runs * T * 4
    assert chi2.ppf(5e-6, dof) < total < chi2.ppf(1 - 5e-6, dof)
    each = np.nansum(found.nis, axis=1)
    outside = (each < chi2.ppf(0.025, 4 * T)) | (each > chi2.ppf(0.975, 4 * T))
    assert outside.mean() < 0.12


def test_the_sum_of_log_densities_after_iterating(drive):
    """Of the last linearisation."""
    posterior = pgm.smooth(network(SIGHT.cpd()), evidence_of(*drive), iterations=4, tolerance=0)
    found = posterior.innovations[SIGHT.z]
    total = sum(log_normal(r, S) for r, S in zip(found.residual, found.cov, strict=True))
    assert_log(posterior.log_evidence, total)


def test_kinds_of_log_evidence(drive):
    evidence, model = evidence_of(*drive), network(SIGHT.cpd())
    assert pgm.filter(model, evidence).log_evidence_kind == "linearised"
    assert pgm.smooth(model, evidence).log_evidence_kind == "linearised"
    twice = pgm.smooth(model, evidence, iterations=2, tolerance=0)
    assert twice.log_evidence_kind == "linearised"
    assert pgm.smooth(model, evidence, iterations=50).log_evidence_kind == "laplace"
    for rule in (pgm.Unscented(), pgm.Cubature()):
        posterior = pgm.smooth(model, evidence, iterations=50, lineariser=rule)
        assert posterior.status.converged
        assert posterior.log_evidence_kind == "linearised"
    mixed = network(SIGHT.cpd(lineariser=pgm.Unscented()))
    assert pgm.smooth(mixed, evidence, iterations=50).log_evidence_kind == "linearised"
    line = pgm.Variable("line")
    linear = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(line, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(line, {line.previous: 1.0}, cov=1.0)],
    )
    for infer in (pgm.filter, pgm.smooth):
        assert infer(linear, {}, steps=3).log_evidence_kind == "exact"


def test_status(drive):
    evidence, model = evidence_of(*drive), network(SIGHT.cpd())
    filtered = pgm.filter(model, evidence).status
    assert filtered.iterations == 1
    assert filtered.residuals.shape == (0,)
    once = pgm.smooth(model, evidence).status
    assert (once.iterations, bool(once.converged)) == (1, False)
    several = [pgm.smooth(model, evidence, iterations=k, tolerance=0.0) for k in (1, 2, 3)]
    assert [posterior.status.iterations for posterior in several] == [1, 2, 3]
    for k in (1, 2):
        before, after = several[k - 1][x], several[k][x]
        move = (np.abs(after.mean - before.mean) / after.std).max()
        np.testing.assert_allclose(several[2].status.residuals[k - 1], move, rtol=1e-6)
    done = pgm.smooth(model, evidence, iterations=50, tolerance=1e-3).status
    assert done.converged
    assert (done.residuals[:-1] > 1e-3).all()
    assert done.residuals[-1] <= 1e-3


def test_a_lineariser_of_a_cpd_wins(drive):
    evidence = evidence_of(*drive)
    mixed = network(SIGHT.cpd(lineariser=pgm.Unscented()))
    posterior = pgm.filter(mixed, evidence, lineariser=pgm.Taylor())
    commands, step, landmarks, values = drive
    mean, cov = np.zeros(3), P0
    for k in range(T + 1):
        if k:
            mean, cov = (
                run_filter(taylor, mean, cov, moves(commands[k - 1 : k]), [None] * 2)
            ).filtered[1]
        for row in np.flatnonzero(step == k):
            seen = [SIGHT.seen(values[row], landmarks[row])]
            mean, cov = run_filter(unscented, mean, cov, [], seen).filtered[0]
        assert_belief(posterior[x.at(k)], mean, cov)


def test_joints_of_neighbours_and_of_distant_steps(drive):
    """The covariance of steps s < t is the product of the smoother's gains and the later one."""
    commands, step, landmarks, values = drive
    seen = [None] * (T + 1)
    for k, value, landmark in zip(step, values, landmarks, strict=True):
        seen[k] = SIGHT.seen(value, landmark)
    ahead = run_filter(taylor, np.zeros(3), P0, moves(commands), seen)
    back = run_smoother(ahead)
    posterior = pgm.smooth(network(SIGHT.cpd()), evidence_of(*drive))
    for s, t in ((3, 4), (0, T), (5, 12), (7, 7)):
        gain = np.eye(3)
        for k in range(s, t):
            gain = gain @ ahead.cross[k] @ np.linalg.inv(ahead.predicted[k + 1][1])
        cross = gain @ back[t][1]
        if s == t:
            assert_belief(posterior.joint(x.at(t)), *back[t])
            continue
        mean = np.concatenate([back[s][0], back[t][0]])
        cov = np.block([[back[s][1], cross], [cross.T, back[t][1]]])
        joint = posterior.joint(x.at(s), x.at(t))
        assert joint.scope == (x.at(s), x.at(t))
        assert_belief(joint, mean, cov)
        turned = posterior.joint(x.at(t), x.at(s))
        assert_same(turned.marginal(x.at(s), x.at(t)), joint, 1e-12)


def test_marginals_by_step_and_stacked(drive):
    posterior = pgm.smooth(network(SIGHT.cpd()), evidence_of(*drive))
    for marginals in (posterior, posterior.filtered, posterior.predicted):
        stacked = marginals[x]
        assert stacked.steps.tolist() == list(range(T + 1))
        assert stacked.mean.shape == stacked.std.shape == (T + 1, 3)
        for step in (0, 7, T):
            one = marginals[x.at(step)]
            assert one.scope == (x.at(step),)
            assert_belief(one, stacked.mean[step], stacked.cov[step], 0.0)
    assert_belief(posterior.predicted[x.at(0)], np.zeros(3), P0, 0.0)
    filtered = pgm.filter(network(SIGHT.cpd()), evidence_of(*drive))
    assert_same(filtered[x], posterior.filtered[x], 0.0)
    assert_same(filtered.filtered[x], filtered[x], 0.0)
    last = posterior[x.at(T)]
    assert_same(last, posterior.filtered[x.at(T)], 1e-12)


def test_covariances_are_symmetric_and_proper(drive):
    posterior = pgm.smooth(network(SIGHT.cpd()), evidence_of(*drive), iterations=3, tolerance=0)
    for gaussian in (posterior[x], posterior.filtered[x], posterior.predicted[x]):
        assert (gaussian.cov == gaussian.cov.swapaxes(-1, -2)).all()
        assert (np.linalg.eigvalsh(gaussian.cov) > 0).all()
    smaller = posterior.filtered[x].cov - posterior[x].cov
    assert (np.linalg.eigvalsh(smaller) > -1e-10).all()


def test_results_are_read_only(drive):
    posterior = pgm.smooth(network(SIGHT.cpd()), evidence_of(*drive))
    with pytest.raises(ValueError, match="read-only"):
        posterior[x].mean[0] = 0.0
    with pytest.raises(AttributeError):
        posterior.graph = None


def test_evidence_is_left_as_it_was(drive):
    """Neither written into nor kept: a change of the arrays afterwards changes no result."""
    commands, step, landmarks, values = (np.array(part) for part in drive)
    values[2] = np.nan
    kept = [part.copy() for part in (commands, step, landmarks, values)]
    posterior = pgm.smooth(network(SIGHT.cpd()), evidence_of(commands, step, landmarks, values))
    for part, before in zip((commands, step, landmarks, values), kept, strict=True):
        np.testing.assert_array_equal(part, before)
    before = posterior[x].mean.copy(), posterior.message(4, 3).h.copy()
    residual = posterior.innovations[SIGHT.z].residual.copy()
    for part in (commands, landmarks, values):
        part += 1.0
    np.testing.assert_array_equal(posterior[x].mean, before[0])
    np.testing.assert_array_equal(posterior.message(4, 3).h, before[1])
    np.testing.assert_array_equal(posterior.innovations[SIGHT.z].residual, residual)
    assert (np.diag([0.02, 0.01, 0.005]) == Q).all()


def test_results_of_one_step_are_rows_of_their_sensor():
    found = pgm.smooth(walk, {z: [[1.0], [2.0]]})
    for results in (found.innovations, found.left_out):
        with pytest.raises(pgm.EvidenceError, match=r"not at one, z\[1\]: ask for z, and take the"):
            results[z.at(1)]
