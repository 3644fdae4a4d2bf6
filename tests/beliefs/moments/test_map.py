"""Iterated smoothing with Taylor against least squares on the stacked residuals: the MAP."""

import numpy as np
import pytest
from robots import (
    DRIVE,
    LANDMARKS,
    P0,
    SENSORS,
    Q,
    controls,
    drive_along,
    drive_cpd,
    m,
    network,
    u,
    x,
)
from scipy.optimize import least_squares
from textbooks import assert_covs, assert_log, assert_means, assert_same, wrap, wrapped

import pgm
from models import sensors

T = 25
SIGHT = SENSORS["range_bearing"]
GAUSS_NEWTON = {"iterations": 60, "tolerance": 1e-12}


class Map:
    """The minimum of ½ |r|² from a start, its covariance (JᵀJ)⁻¹, and the Laplace evidence.

    `terms(unknowns)` lists (residual rows (k, d), covariance (d, d)).
    """

    def __init__(self, terms, start):
        def whitened(flat):
            rows = [
                np.linalg.solve(np.linalg.cholesky(cov), residual.T).T.ravel()
                for residual, cov in terms(flat)
            ]
            return np.concatenate(rows)

        exact = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-14}
        found = least_squares(whitened, start, jac="3-point", method="lm", **exact)
        information = found.jac.T @ found.jac
        self.mean, self.cov = found.x, np.linalg.inv(information)
        log_scales = sum(
            len(residual) * np.linalg.slogdet(2 * np.pi * cov)[1]
            for residual, cov in terms(found.x)
        )
        log_det = np.linalg.slogdet(information / (2 * np.pi))[1]
        self.log_evidence = -found.cost - 0.5 * log_scales - 0.5 * log_det


def assert_is_map(posterior, variable, due, first, tolerance=1e-6):
    """The marginals of a variable, whose rows start at `first` in the vector of unknowns."""
    steps, size = posterior[variable].mean.shape
    places = first + np.arange(steps * size).reshape(steps, size)
    cov = due.cov[places[:, :, None], places[:, None, :]]
    assert_means(posterior[variable].mean, due.mean[places], cov, tolerance)
    assert_covs(posterior[variable].cov, cov, tolerance)


def poses(flat):
    return flat[: 3 * (T + 1)].reshape(T + 1, 3)


def pose_terms(states, commands):
    yield states[:1], P0
    yield states[1:] - DRIVE(states[:-1], commands), Q


def sight_terms(states, landmarks, values, step):
    seen = sensors.range_bearing(states[step], np.broadcast_to(landmarks, (step.size, 2)))
    yield wrapped(values - seen, SIGHT.z.angle_mask), SIGHT.cov


@pytest.fixture(scope="module")
def drive():
    """Commands, true poses, and sightings of three landmarks, up to two a step."""
    rng = np.random.default_rng(21)
    commands = controls(rng, T)
    states = drive_along(commands, rng)
    step = np.sort(rng.integers(0, T + 1, 45))
    which = rng.integers(0, 3, step.size)
    values = SIGHT.draw(states[step], LANDMARKS[which], rng)
    return commands, states, step, which, values


@pytest.fixture(scope="module")
def known_map(drive):
    """The model, its evidence, and the MAP that least squares finds from the true poses."""
    commands, states, step, which, values = drive
    landmarks = LANDMARKS[which]

    def terms(flat):
        yield from pose_terms(poses(flat), commands)
        yield from sight_terms(poses(flat), landmarks, values, step)

    evidence = {u: commands, SIGHT.z: pgm.sightings(values, step=step, given={m: landmarks})}
    return network(SIGHT.cpd()), evidence, Map(terms, states.ravel())


def test_bearings_cross_the_seam(drive):
    bearings = drive[-1][:, 1]
    assert bearings.min() < -0.9 * np.pi
    assert bearings.max() > 0.9 * np.pi


def test_a_known_map(known_map):
    model, evidence, due = known_map
    posterior = pgm.smooth(model, evidence, **GAUSS_NEWTON)
    assert posterior.status.converged.all()
    assert_is_map(posterior, x, due, 0)
    assert posterior.log_evidence_kind == "laplace"
    assert_log(posterior.log_evidence, due.log_evidence, 1e-6)


def test_numerical_jacobians_reach_the_same(known_map):
    _, evidence, due = known_map
    model = network(SIGHT.cpd(jacobian=None), transition=drive_cpd(jacobian=None))
    posterior = pgm.smooth(model, evidence, **GAUSS_NEWTON)
    assert_is_map(posterior, x, due, 0)


def test_the_plain_smoother_is_not_there_yet(known_map):
    """Else the other tests would say nothing."""
    model, evidence, due = known_map
    once = pgm.smooth(model, evidence)
    gap = np.abs(once[x].mean - poses(due.mean)) / once[x].std
    assert gap.max() > 1e-2
    assert not once.status.converged
    assert once.log_evidence_kind == "linearised"


def dead_reckoning(commands):
    states = [np.zeros(3)]
    for command in commands:
        states.append(DRIVE(states[-1], command))
    return np.array(states)


def test_a_dead_reckoned_start_reaches_the_same(known_map):
    model, evidence, due = known_map
    start = {x: dead_reckoning(evidence[u])}
    posterior = pgm.smooth(model, evidence, start=start, **GAUSS_NEWTON)
    assert_is_map(posterior, x, due, 0)
    graph = pgm.compile(model, steps=T)
    schedule = pgm.Smoothing(**GAUSS_NEWTON)
    inferred = pgm.infer(graph, evidence, schedule=schedule, start=start)
    assert_same(inferred[x], posterior[x])


def test_the_first_linearisation_is_at_the_start(known_map):
    """From the MAP itself one linearisation stays there; from elsewhere it does not."""
    model, evidence, due = known_map
    once = pgm.smooth(model, evidence, start={x: poses(due.mean)})
    assert_is_map(once, x, due, 0)
    away = pgm.smooth(model, evidence, start={x: dead_reckoning(evidence[u])})
    assert (np.abs(away[x].mean - poses(due.mean)) / once[x].std).max() > 1e-2


def test_a_start_on_another_branch_of_the_heading(known_map):
    """Every heading of the start a turn away: beliefs stay on their chart, or go a turn with it."""
    model, evidence, due = known_map
    start = dead_reckoning(evidence[u])
    start[:, 2] = wrap(start[:, 2])
    posterior = pgm.smooth(model, evidence, start={x: start}, **GAUSS_NEWTON)
    found = posterior[x].mean.copy()
    found[:, 2] -= 2 * np.pi * np.round((found[:, 2] - poses(due.mean)[:, 2]) / (2 * np.pi))
    assert_means(found, poses(due.mean), posterior[x].cov, 1e-6)


def test_a_static_unknown_landmark(drive):
    """Two landmarks known, the third a state that never moves."""
    commands, states, step, which, values = drive
    where, spread = LANDMARKS[2] + [0.4, -0.3], np.diag([1.0, 1.0])
    unknown = which == 2
    lost = pgm.Variable("lost", components=("east", "north"))
    bearing = pgm.Variable("found", components=SIGHT.z.components, angles=SIGHT.z.angles)
    cpd = pgm.NonlinearGaussianCPD(
        bearing,
        (x, lost),
        sensors.range_bearing,
        SIGHT.cov,
        jacobian={
            x: sensors.range_bearing_by_state,
            lost: sensors.range_bearing_by_landmark,
        },
    )
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0, 0, 0], P0), pgm.GaussianCPD(lost, where, spread)],
        transition=[
            drive_cpd(),
            pgm.LinearGaussianCPD(lost, {lost.previous: 1.0}, cov=np.zeros((2, 2))),
        ],
        observation=[SIGHT.cpd(), cpd],
    )
    evidence = {
        u: commands,
        SIGHT.z: pgm.sightings(
            values[~unknown], step=step[~unknown], given={m: LANDMARKS[which[~unknown]]}
        ),
        bearing: pgm.sightings(values[unknown], step=step[unknown]),
    }

    def terms(flat):
        states, landmark = poses(flat), flat[-2:]
        yield from pose_terms(states, commands)
        yield landmark[None] - where, spread
        landmarks = np.where(unknown[:, None], landmark, LANDMARKS[which])
        yield from sight_terms(states, landmarks, values, step)

    due = Map(terms, np.concatenate([states.ravel(), where]))
    posterior = pgm.smooth(model, evidence, **GAUSS_NEWTON)
    assert_is_map(posterior, x, due, 0)
    cov = np.tile(due.cov[-2:, -2:], (T + 1, 1, 1))
    assert_means(posterior[lost].mean, np.tile(due.mean[-2:], (T + 1, 1)), cov, 1e-6)
    assert_covs(posterior[lost].cov, cov, 1e-6)
    assert_log(posterior.log_evidence, due.log_evidence, 1e-6)


def test_a_static_bias_of_the_bearings(drive):
    commands, states, step, which, values = drive
    b = pgm.Variable("b", angles=("b",))
    shifted = values + np.array([0.0, 0.3])
    landmarks = LANDMARKS[which]

    def biased(state, landmark, bias):
        seen = sensors.range_bearing(state, landmark)
        return np.stack([seen[..., 0], wrap(seen[..., 1] + bias[..., 0])], axis=-1)

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0, 0, 0], P0), pgm.GaussianCPD(b, 0.0, 0.25)],
        transition=[drive_cpd(), pgm.LinearGaussianCPD(b, {b.previous: 1.0}, cov=0.0)],
        observation=[pgm.NonlinearGaussianCPD(SIGHT.z, (x, m, b), biased, SIGHT.cov)],
    )

    def terms(flat):
        states = poses(flat)
        yield from pose_terms(states, commands)
        yield flat[None, -1:], np.array([[0.25]])
        yield from sight_terms(states, landmarks, shifted - [0.0, flat[-1]], step)

    due = Map(terms, np.append(states.ravel(), 0.3))
    evidence = {u: commands, SIGHT.z: pgm.sightings(shifted, step=step, given={m: landmarks})}
    posterior = pgm.smooth(model, evidence, **GAUSS_NEWTON)
    assert_is_map(posterior, x, due, 0)
    assert_means(posterior[b].mean[:1], due.mean[None, -1:], due.cov[None, -1:, -1:], 1e-6)


def test_hidden_controls_and_an_exact_motion(drive):
    """All freedom is in the start and the controls: the poses follow without noise."""
    _, _, step, which, _ = drive
    rng = np.random.default_rng(22)
    commands, M = controls(rng, T), np.array([[0.02, 0.003], [0.003, 0.01]])
    true = commands + rng.multivariate_normal([0, 0], M, T)
    states = drive_along(true, rng, 0 * Q)
    landmarks = LANDMARKS[which]
    values = SIGHT.draw(states[step], landmarks, rng)
    command = pgm.Variable("command", components=u.components)
    by = {x.previous: DRIVE.by_state, u: DRIVE.by_control}
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0, 0, 0], P0)],
        transition=[
            pgm.LinearGaussianCPD(u, {command: 1.0}, cov=M),
            drive_cpd(cov=0 * Q, jacobian=by),
        ],
        observation=[SIGHT.cpd()],
    )

    def path(flat):
        states = [flat[:3]]
        for control in flat[3:].reshape(T, 2):
            states.append(DRIVE(states[-1], control))
        return np.array(states)

    def terms(flat):
        yield flat[None, :3], P0
        yield flat[3:].reshape(T, 2) - commands, M
        yield from sight_terms(path(flat), landmarks, values, step)

    due = Map(terms, np.concatenate([states[0], true.ravel()]))
    evidence = {command: commands, SIGHT.z: pgm.sightings(values, step=step, given={m: landmarks})}
    for start in (None, {x: dead_reckoning(commands), u: commands}):
        posterior = pgm.smooth(model, evidence, start=start, **GAUSS_NEWTON)
        assert_is_map(posterior, u, due, 3)
        assert_means(posterior[x].mean[0], due.mean[:3], due.cov[:3, :3], 1e-6)
        assert_means(posterior[x].mean, path(due.mean), posterior[x].cov, 1e-6)
        assert_log(posterior.log_evidence, due.log_evidence, 1e-6)


def test_a_nonlinear_prior(drive):
    """The start lies on a circle about a known point: distance and direction are states too."""
    commands, states, step, which, values = drive
    polar = pgm.Variable("polar", components=("distance", "direction"), angles=("direction",))
    spread, landmarks = np.diag([0.2, 0.3]), LANDMARKS[which]

    def around(p):
        east, north = p[..., 0] * np.cos(p[..., 1]), p[..., 0] * np.sin(p[..., 1])
        return np.stack([east - 2.0, north, p[..., 1]], axis=-1)

    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.NonlinearGaussianCPD(x, polar, around, P0),
            pgm.GaussianCPD(polar, [2.0, 0.1], spread),
        ],
        transition=[
            drive_cpd(),
            pgm.LinearGaussianCPD(polar, {polar.previous: 1.0}, cov=np.zeros((2, 2))),
        ],
        observation=[SIGHT.cpd()],
    )

    def terms(flat):
        states, start = poses(flat), flat[-2:]
        yield start[None] - [2.0, 0.1], spread
        yield states[:1] - around(start), P0
        yield states[1:] - DRIVE(states[:-1], commands), Q
        yield from sight_terms(states, landmarks, values, step)

    due = Map(terms, np.concatenate([states.ravel(), [2.0, 0.1]]))
    evidence = {u: commands, SIGHT.z: pgm.sightings(values, step=step, given={m: landmarks})}
    posterior = pgm.smooth(model, evidence, **GAUSS_NEWTON)
    assert_is_map(posterior, x, due, 0)
    assert_means(posterior[polar].mean[0], due.mean[-2:], due.cov[-2:, -2:], 1e-6)
    assert_log(posterior.log_evidence, due.log_evidence, 1e-6)


def test_one_landmark_and_a_start_at_the_truth(drive):
    """Iterating from a start settles at the stationary point that is near it."""
    commands, states, _, _, _ = drive
    step = np.arange(1, T + 1)
    landmarks = np.tile(LANDMARKS[1], (T, 1))
    values = SIGHT.draw(states[step], landmarks, np.random.default_rng(24))

    def terms(flat):
        yield from pose_terms(poses(flat), commands)
        yield from sight_terms(poses(flat), landmarks, values, step)

    due = Map(terms, states.ravel())
    evidence = {u: commands, SIGHT.z: values, m: landmarks}
    posterior = pgm.smooth(network(SIGHT.cpd()), evidence, start={x: states}, **GAUSS_NEWTON)
    assert_is_map(posterior, x, due, 0)


def test_iterating_changes_nothing_on_a_linear_problem():
    """As linear CPDs nothing is relinearised; as functions it comes to the same."""
    sensor, rng = SENSORS["pose"], np.random.default_rng(23)
    commands = np.column_stack([rng.normal(size=(T, 2)), 0.1 * rng.normal(size=T)])
    move = pgm.Variable("move", components=x.components)
    values = rng.normal(size=(T, 3)) * [2, 2, 0.3]
    linear = network(
        pgm.LinearGaussianCPD(sensor.z, {x: 1.0}, cov=sensor.cov),
        transition=pgm.LinearGaussianCPD(x, {x.previous: 1.0, move: 1.0}, cov=Q),
    )
    functions = network(
        sensor.cpd(),
        transition=pgm.NonlinearGaussianCPD(x, (x.previous, move), lambda a, b: a + b, Q),
    )
    evidence = {move: commands, sensor.z: values}
    once = pgm.smooth(linear, evidence)
    again = pgm.smooth(linear, evidence, iterations=5)
    assert again.status.iterations == 1
    assert again.status.converged
    assert_same(again[x], once[x], 0.0)
    for lineariser in (pgm.Taylor(), pgm.Unscented()):
        iterated = pgm.smooth(functions, evidence, lineariser=lineariser, iterations=5)
        assert_same(iterated[x], once[x])
        assert_log(iterated.log_evidence, once.log_evidence)
        assert iterated.status.converged


def test_a_run_stops_when_it_has_converged(known_map):
    model, evidence, due = known_map
    posterior = pgm.smooth(model, evidence, iterations=100)
    assert posterior.status.iterations < 30
    assert posterior.status.residuals.shape == (posterior.status.iterations - 1,)
    assert posterior.status.residuals[-1] <= 1e-6
    assert_is_map(posterior, x, due, 0)
