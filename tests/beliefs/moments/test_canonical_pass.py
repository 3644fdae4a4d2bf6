"""Messages and beliefs against a plain pass of canonical forms, (5.10) and (5.14) as written."""

import numpy as np
import pytest
from plain import (
    TINY,
    affine,
    assert_form,
    assert_plain,
    evidence_of,
    linear_cpd,
    linear_network,
    plain_pass,
    plain_potentials,
)
from robots import DRIVE, LANDMARKS, P0, SENSORS, controls, drive_along, drive_cpd, m, u, x
from scipy.linalg import block_diag
from textbooks import assert_log, assert_means

import pgm
from models import sensors

SIGHT = SENSORS["range_bearing"]


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
    sent, _ = plain_pass(potentials, posterior.graph)
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
    sent, beliefs = plain_pass(potentials, posterior.graph)
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


@pytest.mark.parametrize("method", [None, pgm.Balanced()])
def test_a_network_linearised_by_the_last_smoothing_but_one(nonlinear, method):
    model, steps, inputs, readings = nonlinear
    evidence = evidence_of(inputs, readings)
    graph = pgm.compile(model, steps, method)
    before, posterior = (
        pgm.infer(graph, evidence, schedule=pgm.Smoothing(iterations=k, tolerance=0.0))
        for k in (2, 3)
    )

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
    sent, beliefs = plain_pass(potentials, pgm.compile(model, 3))
    assert all(abs(form.log_integral) < 1e-12 for form in beliefs)
    assert abs(sent[0, 1].log_integral) < 1e-12
