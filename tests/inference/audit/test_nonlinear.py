"""Audits of nonlinear models against quadrature and against particle filters."""

import numpy as np
import pytest
from crossed import slow_after
from robots import LANDMARKS, SENSORS, controls, drive_along, drive_cpd, m, network, u, x
from textbooks import wrap

import pgm
from models.motion import Velocity
from pgm.inference.audit.chain import ChainDraws

SIGHT = SENSORS["range_bearing"]
a, w, z, fix, k = pgm.variables("a w z fix k")


def normal(value, mean, variance):
    return np.exp(-0.5 * (value - mean) ** 2 / variance) / np.sqrt(2 * np.pi * variance)


def near(found, due, due_error=0.0, errors=4.0):
    """Within some joint standard errors of what is due, which is no triviality."""
    allowed = errors * np.hypot(found.standard_error, due_error)
    assert (np.abs(found.log_evidence - due) <= allowed).all(), (found.correction, due, allowed)
    assert (found.pareto_k < 0.7).all()


# ---- scalars, against a dense grid

GRID = np.linspace(-15.0, 25.0, 1601)
SPACING = GRID[1] - GRID[0]


def shift(x, k):
    return 0.9 * x + 0.5 * np.sin(x) + k


def square(x):
    return x**2 / 20


def curved(sensor=square):
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 6.0, 1.0)],
        transition=[pgm.NonlinearGaussianCPD(a, (a.previous, k), shift, 0.5)],
        observation=[pgm.NonlinearGaussianCPD(z, a, sensor, 0.2)],
    )


def on_grid(values, inputs):
    """The evidence of readings at steps 1..T; NaN where one is missing."""
    density, total = normal(GRID, 6.0, 1.0), 0.0
    for value, known in zip(values, inputs, strict=True):
        density = normal(GRID[:, None], shift(GRID, known), 0.5) @ density * SPACING
        if not np.isnan(value):
            density = density * normal(value, square(GRID), 0.2)
        share = density.sum() * SPACING
        total, density = total + np.log(share), density / share
    return total


@pytest.mark.parametrize("lineariser", [pgm.Taylor(), pgm.Cubature()], ids=repr)
def test_a_scalar_chain(lineariser):
    rng, steps = np.random.default_rng(1), 5
    inputs = rng.uniform(0.5, 1.5, (steps, 1))
    evidence = dict(curved().sample({k: inputs}, runs=4, rng=rng).evidence)
    evidence[z] = evidence[z].copy()
    evidence[z][1, 2] = np.nan
    due = np.array([on_grid(run[:, 0], inputs[:, 0]) for run in evidence[z]])
    posterior = pgm.smooth(curved(), evidence, lineariser=lineariser, iterations=20)
    found = pgm.audit(posterior, samples=20_000, rng=rng)
    near(found, due)
    assert found.standard_error.max() < 0.02
    wrong = np.abs(posterior.log_evidence - due)
    assert (wrong > 4 * found.standard_error).all()
    assert (np.abs(found.log_evidence - due) < wrong).all()


def test_after_filtering_the_proposal_is_the_smoothed_joint():
    inputs, values = np.ones((3, 1)), np.array([[2.5], [3.5], [3.0]])
    evidence = {k: inputs, z: values}
    posterior = pgm.filter(curved(), evidence)
    found = pgm.audit(posterior, samples=20_000, rng=0)
    near(found, on_grid(values[:, 0], inputs[:, 0]))
    np.testing.assert_array_equal(found.gaussian_log_evidence, posterior.log_evidence)
    smoothed = pgm.audit(pgm.smooth(curved(), evidence), samples=20_000, rng=0)
    np.testing.assert_allclose(found.log_weights, smoothed.log_weights)


def test_the_divergence_is_that_of_the_posteriors():
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 2.0, 0.3)],
        transition=[pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=1.0)],
        observation=[pgm.NonlinearGaussianCPD(z, a, lambda x: x**2, 0.8)],
    )
    posterior = pgm.smooth(model, {z: pgm.sightings([[3.0]], step=[0])}, steps=0)
    joint = normal(GRID, 2.0, 0.3) * normal(3.0, GRID**2, 0.8)
    exact = joint / (joint.sum() * SPACING)
    belief = posterior[a.at(0)]
    # Beyond five deviations, where the other root of the sensor lies, no draw comes.
    inside = np.abs(GRID - belief.mean[0]) < 5 * belief.std[0]
    q, exact = normal(GRID[inside], belief.mean[0], belief.cov[0, 0]), exact[inside]
    divergence = (q * np.log(q / exact)).sum() * SPACING
    found = pgm.audit(posterior, samples=100_000, rng=0)
    assert divergence > 0.02
    np.testing.assert_allclose(found.divergence, divergence, rtol=0.05)
    near(found, np.log(joint.sum() * SPACING))
    size = found.samples / ((exact**2 / q).sum() * SPACING)
    np.testing.assert_allclose(found.effective_sample_size, size, rtol=0.05)


def test_a_nonlinear_child_without_noise():
    """The proposal is of a alone: w = a² follows, on a curve that no Gaussian draw meets."""
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 1.0, 0.2),
            pgm.NonlinearGaussianCPD(w, a, lambda x: x**2, 0.0),
            pgm.NonlinearGaussianCPD(z, (a, w), lambda a, w: np.sin(w) + a, 0.3),
        ]
    )
    due = (normal(GRID, 1.0, 0.2) * normal(2.5, np.sin(GRID**2) + GRID, 0.3)).sum() * SPACING
    for lineariser in (pgm.Taylor(), pgm.Unscented()):
        posterior = pgm.infer(pgm.compile(net), {z: 2.5}, lineariser=lineariser)
        near(pgm.audit(posterior, samples=20_000, rng=0), np.log(due))


@pytest.mark.parametrize("grouped", [False, True])
def test_an_exact_sensor_beside_a_nonlinear_one(grouped):
    """One reading fixes the first component; what is left is an integral over the second."""
    pair = pgm.Variable("pair", components=("p", "q"))
    cov = np.array([[1.0, 0.6], [0.6, 0.8]])
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pair, [0.5, 1.0], cov)],
        transition=[pgm.LinearGaussianCPD(pair, {pair.previous: 1.0}, cov=0.0 * cov)],
        observation=[
            pgm.LinearGaussianCPD(fix, {pair: [[1.0, 0.0]]}, cov=0.0),
            pgm.NonlinearGaussianCPD(
                z, pair, lambda x: x[..., :1] + x[..., 1:] ** 2, 0.4, grouped=grouped
            ),
        ],
    )
    evidence = {
        fix: pgm.sightings([[0.9]], step=[0]),
        z: pgm.sightings([[2.4], [3.0]], step=[0, 1]),
    }
    mean, variance = 1.0 + 0.6 * 0.4, 0.8 - 0.36
    likelihood = normal(2.4, 0.9 + GRID**2, 0.4) * normal(3.0, 0.9 + GRID**2, 0.4)
    due = (normal(GRID, mean, variance) * likelihood).sum() * SPACING * normal(0.9, 0.5, 1.0)
    posterior = pgm.smooth(model, evidence, steps=1)
    assert ChainDraws.make(posterior._outcome).relative
    near(pgm.audit(posterior, samples=20_000, rng=0), np.log(due))


# ---- robots, against particle filters


def particle_filter(rng, start, move, weigh, steps, count=100_000, repeats=8):
    """The log-evidence by a bootstrap filter, and its standard error over repeats."""
    found = np.zeros(repeats)
    for repeat in range(repeats):
        states = start(rng, count)
        for step in range(steps + 1):
            if step:
                states = move(rng, states, step)
            log = weigh(states, step)
            if log is None:
                continue
            likelihood = np.exp(log - log.max())
            found[repeat] += log.max() + np.log(likelihood.mean())
            cumulative = np.cumsum(likelihood / likelihood.sum())
            places = (np.arange(count) + rng.random()) / count
            states = states[np.minimum(np.searchsorted(cumulative, places), count - 1)]
    return found.mean(), found.std(ddof=1) / np.sqrt(repeats)


def log_reading(states, value, landmark, cov):
    expected = SIGHT.function(states, np.broadcast_to(landmark, (*states.shape[:-1], 2)))
    residual = value - expected
    residual[..., 1] = wrap(residual[..., 1])
    white = np.linalg.solve(np.linalg.cholesky(cov), residual.T)
    return -0.5 * (white**2).sum(0) - 0.5 * np.linalg.slogdet(2 * np.pi * np.asarray(cov))[1]


P0, Q = np.diag([0.3, 0.3, 0.5]), np.diag([0.02, 0.01, 0.05])


def range_bearing(heading):
    """A short drive with two sightings at some steps and none at others."""
    rng = np.random.default_rng(11)
    when, which = np.array([1, 2, 2, 4, 5]), np.array([0, 1, 2, 1, 0])
    model = network(
        SIGHT.cpd(),
        transition=drive_cpd(cov=Q),
        prior=pgm.GaussianCPD(x, [0, 0, heading], P0),
    )
    seen = pgm.sightings(step=when, given={m: LANDMARKS[which]})
    drawn = model.sample({u: controls(rng, 5), SIGHT.z: seen}, rng=rng)
    return model, drawn.evidence, when, which


@pytest.mark.parametrize("heading", slow_after(1, [3.0, 0.0]))
def test_range_and_bearing(heading):
    """At a heading of 3 rad the angles cross ±π."""
    model, evidence, when, which = range_bearing(heading)
    commands, values = evidence[u], evidence[SIGHT.z].values
    drive = Velocity(dt=1.0)

    def start(rng, count):
        return rng.multivariate_normal([0, 0, heading], P0, count)

    def move(rng, states, step):
        wide = np.broadcast_to(commands[step - 1], (len(states), 2))
        return drive(states, wide) + rng.multivariate_normal(np.zeros(3), Q, len(states))

    def weigh(states, step):
        due = [
            log_reading(states, values[i], LANDMARKS[which[i]], SIGHT.cov)
            for i in np.flatnonzero(when == step)
        ]
        return sum(due) if due else None

    reference = particle_filter(np.random.default_rng(5), start, move, weigh, 5)
    posterior = pgm.smooth(model, evidence, lineariser=pgm.Cubature())
    found = pgm.audit(posterior, samples=20_000, rng=1)
    near(found, *reference)
    error = np.abs(posterior.log_evidence - reference[0])
    assert error > 4 * np.hypot(found.standard_error, reference[1])
    assert np.abs(found.log_evidence - reference[0]) < error


def test_a_function_that_wraps_its_heading_gives_the_same():
    model, evidence, *_ = range_bearing(3.0)
    drive = Velocity(dt=1.0)

    def wrapping(state, command):
        moved = drive(state, command)
        moved[..., 2] = wrap(moved[..., 2])
        return moved

    wrapped = model.replace(transition=[drive_cpd(function=wrapping, cov=Q)])
    one, other = (
        pgm.audit(pgm.smooth(each, evidence), samples=300, rng=2) for each in (model, wrapped)
    )
    np.testing.assert_allclose(one.log_weights, other.log_weights, atol=1e-9)


@pytest.mark.parametrize("wraps", [False, True])
def test_a_heading_with_noise_of_many_turns(wraps):
    """Linear functions, declared as any: the chart has no ends, so all weights are equal."""
    heading = pgm.Variable("heading", angles=("heading",))

    def turn(angle, rate):
        return wrap(angle + rate) if wraps else angle + rate

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(heading, 3.0, 0.3)],
        transition=[pgm.NonlinearGaussianCPD(heading, (heading.previous, k), turn, 9.0)],
        observation=[pgm.LinearGaussianCPD(z, {heading: 1.0}, cov=25.0)],
    )
    evidence = {k: np.ones((6, 1)), z: np.array([4.0, 5.0, 2.0, 9.0, 8.0, 8.0])[:, None]}
    found = pgm.audit(pgm.smooth(model, evidence), rng=0)
    np.testing.assert_allclose(found.log_weights, found.gaussian_log_evidence, atol=1e-9)


@pytest.mark.parametrize("known_start", slow_after(1, [False, True]))
def test_a_pose_without_noise_driven_by_a_hidden_control(known_start):
    """The pose's process noise is that of the controls: rank 2 of 3, on a curved surface."""
    command = pgm.Variable("command", components=u.components)
    spread, prior = np.diag([0.05, 0.1]), np.zeros((3, 3)) if known_start else P0
    drive = Velocity(dt=1.0)
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, np.zeros(3), prior)],
        transition=[
            pgm.LinearGaussianCPD(u, {command: 1.0}, cov=spread),
            drive_cpd(cov=np.zeros((3, 3))),
        ],
        observation=[SIGHT.cpd()],
    )
    rng = np.random.default_rng(3)
    commands = controls(rng, 5)
    when, which = np.array([2, 3, 5]), np.array([0, 1, 2])
    states = drive_along(commands, rng, np.zeros((3, 3)))
    values = SIGHT.draw(states[when], LANDMARKS[which], rng)
    evidence = {command: commands, SIGHT.z: pgm.sightings(values, when, {m: LANDMARKS[which]})}

    def start(rng, count):
        return rng.multivariate_normal(np.zeros(3), prior, count)

    def move(rng, states, step):
        noise = rng.multivariate_normal(np.zeros(2), spread, len(states))
        return drive(states, commands[step - 1] + noise)

    def weigh(states, step):
        for i in np.flatnonzero(when == step):
            return log_reading(states, values[i], LANDMARKS[which[i]], SIGHT.cov)
        return None

    reference = particle_filter(np.random.default_rng(6), start, move, weigh, 5)
    for lineariser in (pgm.Taylor(), pgm.Cubature()):
        posterior = pgm.smooth(model, evidence, lineariser=lineariser, iterations=20)
        found = pgm.audit(posterior, samples=20_000, rng=1)
        assert found.effective_sample_size > 1000
        near(found, *reference)


def test_an_unrolled_robot_and_its_chain():
    model, evidence, *_ = range_bearing(0.0)
    when, commands, values = np.arange(3), evidence[u], evidence[SIGHT.z].values[:3]
    chain = pgm.smooth(
        model,
        {u: commands[:2], SIGHT.z: pgm.sightings(values, when, {m: LANDMARKS})},
        iterations=20,
    )
    known = {SIGHT.z.at(t): values[t] for t in when} | {m.at(t): LANDMARKS[t] for t in when}
    known |= {u.at(t + 1): commands[t] for t in range(2)}
    tree = pgm.infer(pgm.compile(model.unroll(2)), known, schedule=pgm.Calibration(iterations=20))
    one, other = (pgm.audit(each, samples=10_000, rng=i) for i, each in enumerate((chain, tree)))
    near(one, other.log_evidence, other.standard_error)
    np.testing.assert_allclose(one.divergence, other.divergence, rtol=0.1)
