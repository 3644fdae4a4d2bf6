"""A plain pass of canonical forms, (5.10) and (5.14) as written, for the engine's to be held to."""

from functools import reduce
from operator import mul

import numpy as np
from textbooks import assert_belief, assert_log

import pgm

TINY = 1e-4  # the noise of a static unknown, so that its CPD has a canonical form


def vacuous(scope):
    """The form that is one everywhere."""
    size = sum(variable.dimension for variable in scope)
    return pgm.CanonicalForm(scope, np.zeros((size, size)), np.zeros(size), 0.0)


def plain_pass(potentials, graph):
    """Messages both ways along each edge of a tree, {(i, j): form}, and the beliefs.

    Clusters beyond the potentials have none.
    """
    sent = {}

    def product(i, but=None):
        inside = [potentials[i]] if i < len(potentials) else []
        inside += [send(k, i) for k in graph.neighbours(i) if k != but]
        return reduce(mul, inside)

    def send(i, j):
        if (i, j) not in sent:
            scope = graph.sepsets[i, j]
            # What nothing is said of has to be in the scope too.
            sent[i, j] = (product(i, j) * vacuous(scope)).marginal(*scope)
        return sent[i, j]

    for i, j in graph.sepsets:
        send(i, j), send(j, i)
    return sent, [product(i) for i in range(len(graph))]


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
    sent, beliefs = plain_pass(potentials, graph)
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
        incoming = [posterior.message(j, i) for j in graph.neighbours(i)]
        product = reduce(mul, [*potentials[i : i + 1], *incoming])
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
