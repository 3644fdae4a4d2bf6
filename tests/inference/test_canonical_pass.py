"""Messages and beliefs against a plain pass of canonical forms, (5.10) and (5.14) as written."""

from functools import reduce
from operator import mul

import numpy as np
import pytest
from robots import DRIVE, LANDMARKS, P0, SENSORS, controls, drive_along, drive_cpd, m, u, x
from scipy.linalg import block_diag
from textbooks import assert_belief, assert_log, assert_means

import pgm
from models import sensors

SIGHT = SENSORS["range_bearing"]
TINY = 1e-4  # the noise of a static unknown, so that its CPD has a canonical form


def plain_pass(potentials, sepsets):
    """Messages both ways along a chain, {(i, j): form}, and the beliefs."""
    last, sent = len(potentials) - 1, {}
    for i in range(last):
        inside = potentials[i] * sent[i - 1, i] if i else potentials[i]
        sent[i, i + 1] = inside.marginal(*sepsets[i, i + 1])
    for i in range(last, 0, -1):
        inside = potentials[i] * sent[i + 1, i] if i < last else potentials[i]
        sent[i, i - 1] = inside.marginal(*sepsets[i - 1, i])
    beliefs = []
    for i, potential in enumerate(potentials):
        for j in (i - 1, i + 1):
            if (j, i) in sent:
                potential = potential * sent[j, i]
        beliefs.append(potential)
    return sent, beliefs


def affine(cpd, known):
    """F over the stacked hidden parents, b and noise of a linear CPD, and those parents."""
    hidden = [p for p in cpd.given if p not in known]
    size = cpd.child.dimension
    F = np.concatenate([np.zeros((size, 0)), *(cpd.matrices[p] for p in hidden)], axis=1)
    b = cpd.offset + sum(cpd.matrices[p] @ known[p] for p in cpd.given if p in known)
    noise = cpd.cov
    if hasattr(noise, "function"):
        noise = noise.function(*(known[p] for p in noise.given))
    return pgm.AffineGaussian(F, b, noise), hidden


def linear_cpd(cpd, step, known):
    return affine(cpd, known)


def plain_potentials(model, steps, inputs, readings, linearise):
    """The product of each cluster's CPDs, reduced by evidence.

    `linearise(cpd, step, known)` gives an affine Gaussian and its hidden parents; `near` of the
    former, where it has angles, moves a reading to the branch nearest the value linearised at.
    """
    potentials = []
    for step in range(steps + 1):
        row = {v: np.asarray(rows)[step - 1] for v, rows in inputs.items()} if step else {}
        factors = []
        for cpd in model.transition if step else model.prior:
            form, hidden = linearise(cpd, step, row)
            factors.append(form.canonical(cpd.child.at(step), [p.at(step) for p in hidden]))
        for sensor, when, value, given in readings:
            if when == step:
                cpd = next(c for c in model.observation if c.child == sensor)
                form, hidden = linearise(cpd, step, row | given)
                factor = form.canonical(sensor, [p.at(step) for p in hidden])
                value = form.near(value) if hasattr(form, "near") else value
                factors.append(factor.reduce({sensor: value}))
        potentials.append(reduce(mul, factors))
    return potentials


def assert_form(found, due, tolerance=1e-9, scale=1.0):
    """Equal K, h and g, in the units of `scale`: the deviations of a belief over the scope."""
    assert set(found.scope) == set(due.scope)
    due = due.rearrange(found.scope)
    K, h = due.K * np.multiply.outer(scale, scale), due.h * scale
    bound_K = tolerance * max(1.0, np.abs(K).max())
    bound_h = tolerance * (1.0 + np.abs(h).max())
    bound_g = tolerance * (1.0 + np.abs(due.g) + np.abs(h).max() ** 2)
    assert np.abs(found.K * np.multiply.outer(scale, scale) - K).max() <= bound_K
    assert np.abs(found.h * scale - h).max() <= bound_h
    assert np.abs(found.g - due.g) <= bound_g


def assert_plain(posterior, potentials, tolerance=1e-9):
    """Each message and belief of a smoothing, the marginals, and the log-evidence."""
    graph = posterior.graph
    sent, beliefs = plain_pass(potentials, graph.sepsets)
    for (i, j), due in sent.items():
        found = posterior.message(i, j)
        assert_form(found, due, tolerance, posterior.joint(*found.scope).std)
    for i, due in enumerate(beliefs):
        found = posterior.belief(i)
        scale = posterior.joint(*found.scope).std
        assert_form(found, due, tolerance, scale)
        for variable in due.scope:
            one = due.marginal(variable)
            assert_belief(posterior[variable], one.gaussian().mean, one.gaussian().cov, tolerance)
        assert_log(posterior.log_evidence, due.log_integral, tolerance)
        # (5.14) with the engine's own messages: the potential times all that come in.
        product = potentials[i]
        for j in graph.neighbours(i):
            product = product * posterior.message(j, i)
        assert_form(found, product, tolerance, scale)


def linear_network():
    """Two states, a hidden control, an unknown; a fixed reading and several sightings."""
    p = pgm.Variable("p", components=("place", "speed"))
    s, b, c, command, z, gyro = pgm.variables("s b c command z gyro")
    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.LinearGaussianCPD(p, {s: [[1.0], [0.5]]}, offset=[0.5, 0], cov=0.1 * np.eye(2)),
            pgm.GaussianCPD(s, 1.0, 0.5),
            pgm.GaussianCPD(b, 0.25, 2.0),
        ],
        transition=[
            pgm.LinearGaussianCPD(
                p,
                {p.previous: [[1, 0.5], [0, 1]], c: [[0], [1.0]], s: [[0.5], [0]]},
                cov=[[0.1, 0.02], [0.02, 0.2]],
            ),
            pgm.LinearGaussianCPD(b, {b.previous: 1.0}, cov=TINY),
            pgm.LinearGaussianCPD(s, {s.previous: 0.75, c: 0.25}, offset=0.125, cov=0.05),
            pgm.LinearGaussianCPD(
                c, {command: 2.0}, cov=pgm.noise(lambda k: 0.1 + k[..., None] ** 2, given=command)
            ),
        ],
        observation=[
            pgm.LinearGaussianCPD(z, {p: [[1.0, 0]], b: 0.5}, offset=0.125, cov=0.1),
            pgm.LinearGaussianCPD(gyro, {c: 1.0, b: 1.0}, cov=0.2),
        ],
    )
    inputs = {command: np.array([[0.5], [0.25], [1.0], [-0.5], [2.0]])}
    readings = [
        (z, 0, [1.0], {}),
        (gyro, 2, [0.5], {}),
        (z, 2, [0.5], {}),
        (z, 2, [1.5], {}),
        (gyro, 5, [1.5], {}),
        (z, 4, [2.0], {}),
    ]
    return model, 5, inputs, readings


def evidence_of(inputs, readings):
    evidence = dict(inputs)
    for sensor in dict.fromkeys(row[0] for row in readings):
        rows = [row for row in readings if row[0] == sensor]
        evidence[sensor] = pgm.sightings(
            [row[2] for row in rows],
            step=[row[1] for row in rows],
            given={p: [row[3][p] for row in rows] for p in rows[0][3]},
        )
    return evidence


@pytest.fixture(scope="module")
def linear():
    network = linear_network()
    model, _, inputs, readings = network
    return model, evidence_of(inputs, readings), plain_potentials(*network, linear_cpd)


def test_a_linear_network(linear):
    model, evidence, potentials = linear
    assert_plain(pgm.smooth(model, evidence), potentials)


def test_forward_messages_and_beliefs_of_a_filter(linear):
    """A filtered belief is the potential times the message that has come so far."""
    model, evidence, potentials = linear
    posterior = pgm.filter(model, evidence)
    sent, _ = plain_pass(potentials, posterior.graph.sepsets)
    for i, potential in enumerate(potentials):
        due = potential * sent[i - 1, i] if i else potential
        assert_form(posterior.belief(i), due)
        if (i, i + 1) in sent:
            assert_form(posterior.message(i, i + 1), sent[i, i + 1])


def test_runs_of_a_batch(linear):
    model, evidence, potentials = linear
    batch = {v: value for v, value in evidence.items() if not hasattr(value, "step")}
    (command,) = batch
    batch = {**evidence, command: np.stack([evidence[command], evidence[command]])}
    posterior = pgm.smooth(model, batch)
    sent, beliefs = plain_pass(potentials, posterior.graph.sepsets)
    for found, due in [
        (posterior.message(2, 3), sent[2, 3]),
        (posterior.message(3, 2), sent[3, 2]),
        (posterior.belief(3), beliefs[3]),
    ]:
        assert found.g.shape == (2,)
        for run in range(2):
            one = pgm.CanonicalForm(found.scope, found.K[run], found.h[run], found.g[run])
            assert_form(one, due)


class Linearised(pgm.AffineGaussian):
    """An affine Gaussian that knows the CPD's value at the point of linearisation."""

    __slots__ = ("angles", "value")

    def near(self, reading):
        away = np.asarray(self.value - reading)
        return reading + np.where(self.angles, 2 * np.pi * np.round(away / (2 * np.pi)), 0.0)


def nonlinear_network():
    """A robot with noisy controls, a landmark it does not know, and one that it does."""
    command = pgm.Variable("command", components=u.components)
    lost = pgm.Variable("lost", components=m.components)
    seen = pgm.Variable("seen", components=SIGHT.z.components, angles=SIGHT.z.angles)
    by = {x.previous: DRIVE.by_state, u: DRIVE.by_control}
    both = {x: sensors.range_bearing_by_state, lost: sensors.range_bearing_by_landmark}
    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(x, [0, 0, 0], P0),
            pgm.GaussianCPD(lost, LANDMARKS[2], 0.3 * np.eye(2)),
        ],
        transition=[
            pgm.LinearGaussianCPD(u, {command: 1.0}, cov=0.01 * np.eye(2)),
            drive_cpd(jacobian=by),
            pgm.LinearGaussianCPD(lost, {lost.previous: 1.0}, cov=TINY * np.eye(2)),
        ],
        observation=[
            SIGHT.cpd(),
            pgm.NonlinearGaussianCPD(seen, (x, lost), SIGHT.function, SIGHT.cov, jacobian=both),
        ],
    )
    rng, steps = np.random.default_rng(41), 8
    commands = controls(rng, steps)
    commands[:, 1] += 0.4
    states = drive_along(commands, rng)
    readings = []
    for k in rng.integers(0, steps + 1, 8):
        landmark = LANDMARKS[rng.integers(0, 2)]
        readings.append((SIGHT.z, int(k), SIGHT.draw(states[k], landmark, rng), {m: landmark}))
    for k in (2, 5, 5, 7):
        readings.append((seen, k, SIGHT.draw(states[k], LANDMARKS[2], rng), {}))
    return model, steps, {command: commands}, readings


def linearised_at(transition_at, sensor_at):
    """Linearise each CPD at the means that a function of (parent, step) gives."""

    def linearise(cpd, step, known):
        if hasattr(cpd, "matrices"):
            return affine(cpd, known)
        at = transition_at if cpd.child == x else sensor_at
        values = [known[p] if p in known else at(p, step) for p in cpd.given]
        hidden = [p for p in cpd.given if p not in known]
        F = np.concatenate([cpd.jacobian[p](*values) for p in hidden], axis=-1)
        value = cpd.function(*values)
        stacked = np.concatenate([at(p, step) for p in hidden])
        form = Linearised(F, value - F @ stacked, cpd.cov)
        object.__setattr__(form, "value", value)
        object.__setattr__(form, "angles", cpd.child.angle_mask)
        return form, hidden

    return linearise


@pytest.fixture(scope="module")
def nonlinear():
    return nonlinear_network()


def test_bearings_of_the_nonlinear_network_cross_the_seam(nonlinear):
    bearings = [row[2][1] for row in nonlinear[3]]
    assert min(bearings) < -2.0
    assert max(bearings) > 2.0


def test_a_network_linearised_by_the_filter(nonlinear):
    """Transitions at the filtered means of the step before, sensors at the predicted ones."""
    model, steps, inputs, readings = nonlinear
    posterior = pgm.smooth(model, evidence_of(inputs, readings))

    def transition_at(parent, step):
        before = posterior.filtered if parent.lag else posterior.predicted
        return before[parent.at(step)].mean

    def sensor_at(parent, step):
        return posterior.predicted[parent.at(step)].mean

    linearise = linearised_at(transition_at, sensor_at)
    assert_plain(posterior, plain_potentials(model, steps, inputs, readings, linearise), 1e-8)


def test_a_network_linearised_by_the_last_smoothing_but_one(nonlinear):
    model, steps, inputs, readings = nonlinear
    evidence = evidence_of(inputs, readings)
    before = pgm.smooth(model, evidence, iterations=2, tolerance=0.0)
    posterior = pgm.smooth(model, evidence, iterations=3, tolerance=0.0)

    def at(parent, step):
        return before[parent.at(step)].mean

    linearise = linearised_at(at, at)
    assert_plain(posterior, plain_potentials(model, steps, inputs, readings, linearise), 1e-8)


# ---- where forms exist, and where they do not

line = pgm.Variable("line", components=("place", "speed"))
fix = pgm.Variable("fix")
ROLL = np.array([[1.0, 0.5], [0.0, 1.0]])
PUSH = np.array([[0.25, 0.5], [0.5, 1.0]])


def rolling(prior, cov, noise, motion=ROLL):
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(line, [0, 0.5], prior)],
        transition=[pgm.LinearGaussianCPD(line, {line.previous: motion}, cov=cov)],
        observation=[pgm.LinearGaussianCPD(fix, {line: [[1.0, 0]]}, cov=noise)],
    )


SEEN = {fix: pgm.sightings([[0.5], [1.0], [1.75]], step=[1, 3, 4])}


def as_steps(scope):
    return [v.step for v in scope]


@pytest.mark.parametrize(
    "model",
    [
        rolling(np.eye(2), 0.1 * np.eye(2), 0.2),
        rolling(np.eye(2), PUSH, 0.2),
        rolling(np.eye(2), 0 * PUSH, 0.2),
        rolling(np.eye(2), 0.1 * np.eye(2), 0.0),
    ],
    ids=["regular", "noise of rank 1", "no noise", "exact sensor"],
)
def test_two_messages_over_a_sepset_make_its_marginal(model):
    """Singular noise and exact sensors leave messages of noisy directions as they are."""
    posterior = pgm.smooth(model, SEEN, steps=5)
    for step in range(5):
        back = posterior.message(step + 1, step)
        try:
            ahead = posterior.message(step, step + 1)
        except pgm.NumericalError:
            # An exact reading has made the filtered belief singular: the product of moments.
            due = posterior.filtered[line.at(step)]
            assert np.linalg.matrix_rank(due.cov) == 1
            cov = np.linalg.solve(np.eye(2) + due.cov @ back.K, due.cov)
            mean = due.mean + cov @ (back.h - back.K @ due.mean)
        else:
            product = ahead * back
            assert_log(product.log_integral, posterior.log_evidence)
            mean, cov = product.gaussian().mean, product.gaussian().cov
        smoothed = posterior[line.at(step)]
        assert_means(smoothed.mean, mean, cov)
        np.testing.assert_allclose(smoothed.cov, cov, atol=1e-9)


@pytest.mark.parametrize(
    ("model", "asked", "cluster"),
    [
        (rolling(0 * PUSH, 0.1 * np.eye(2), 0.2), lambda p: p.message(0, 1), 0),
        (rolling(0 * PUSH, 0.1 * np.eye(2), 0.2), lambda p: p.belief(0), 0),
        (rolling(np.eye(2), PUSH, 0.2), lambda p: p.belief(3), 3),
        (rolling(np.eye(2), 0.1 * np.eye(2), 0.0), lambda p: p.message(3, 4), 3),
        (rolling(np.eye(2), 0 * PUSH, 0.0, np.eye(2)), lambda p: p.message(4, 3), 4),
    ],
    ids=["known start", "its belief", "noise of rank 1", "exact reading", "static and exact"],
)
def test_forms_that_do_not_exist(model, asked, cluster):
    seen = {fix: pgm.sightings([[0.5], [0.5]], step=[3, 4])}
    posterior = pgm.smooth(model, seen, steps=5)
    with pytest.raises(pgm.NumericalError, match=rf"cluster {cluster}\b.*canonical") as caught:
        asked(posterior)
    assert caught.value.cluster == cluster
    assert np.isfinite(posterior[line].mean).all()
    assert np.isfinite(posterior.joint(line.at(0), line.at(4)).cov).all()
    assert np.isfinite(posterior.log_evidence)


def test_a_known_start_leaves_the_later_messages():
    """Only what is singular is refused."""
    posterior = pgm.smooth(rolling(0 * PUSH, 0.1 * np.eye(2), 0.2), SEEN, steps=5)
    for i, j in ((1, 2), (2, 1), (1, 0), (4, 5), (5, 4)):
        assert as_steps(posterior.message(i, j).scope) == [min(i, j)]
    assert as_steps(posterior.belief(3).scope) == [2, 3]
    with pytest.raises(pgm.NumericalError):
        posterior.belief(1)


def test_backward_messages_are_not_sent_by_a_filter():
    posterior = pgm.filter(rolling(np.eye(2), np.eye(2), 0.2), SEEN, steps=5)
    assert posterior.message(2, 3).scope == (line.at(2),)
    with pytest.raises(pgm.GraphError, match="not sent") as caught:
        posterior.message(3, 2)
    assert caught.value.cluster == 3


def test_the_last_cluster_sends_back_what_it_has_read():
    """Nothing read after a step: the message says nothing, K = 0, h = 0, g = 0."""
    posterior = pgm.smooth(rolling(np.eye(2), PUSH, 0.2), SEEN, steps=5)
    message = posterior.message(5, 4)
    assert (np.abs(message.K) < 1e-15).all()
    assert (np.abs(message.h) < 1e-15).all()
    assert abs(message.g) < 1e-12


def test_clusters_by_index_or_by_value():
    posterior = pgm.smooth(rolling(np.eye(2), np.eye(2), 0.2), SEEN, steps=5)
    clusters = posterior.graph.clusters
    assert_form(posterior.belief(clusters[2]), posterior.belief(2), 0.0)
    assert_form(posterior.message(clusters[2], clusters[3]), posterior.message(2, 3), 0.0)


def test_an_affine_gaussian_as_a_potential_integrates_to_one():
    """A guard of the pass itself: potentials of a chain without readings hold probability one."""
    model = rolling(np.eye(2), block_diag(0.1, 0.2), 0.2)
    potentials = plain_potentials(model, 3, {}, [], linear_cpd)
    sent, beliefs = plain_pass(potentials, pgm.compile(model, 3).sepsets)
    assert all(abs(form.log_integral) < 1e-12 for form in beliefs)
    assert abs(sent[0, 1].log_integral) < 1e-12
