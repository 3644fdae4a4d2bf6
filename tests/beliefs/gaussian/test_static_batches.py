"""Batches of runs: every run equals its single run, whatever differs between them."""

import itertools

import numpy as np
import pytest
from gaussian.draws import regular
from numpy.testing import assert_allclose

import pgm

a, b, c, d, u, w = pgm.variables("a b c d u w")
p = pgm.Variable("p", ("p0", "p1"))


def assert_runs(graph, lead, batch, single, scope):
    """`single(run)` gives a graph and the evidence of one run."""
    together = pgm.infer(graph, batch)
    size = sum(v.dimension for v in scope)
    assert together.log_evidence.shape == lead
    assert together.status.converged.shape == lead
    joint = together.joint(*scope)
    assert joint.mean.shape == (*lead, size)
    assert joint.cov.shape == (*lead, size, size)
    for run in np.ndindex(lead):
        alone = pgm.infer(*single(run))
        assert alone.log_evidence.shape == ()
        due = alone.joint(*scope)
        assert_allclose(together.log_evidence[run], alone.log_evidence, rtol=1e-12, atol=1e-12)
        assert_allclose(joint.mean[run], due.mean, rtol=1e-12, atol=1e-12)
        assert_allclose(joint.cov[run], due.cov, rtol=1e-12, atol=1e-12)
        for v in scope:
            assert_allclose(together[v].mean[run], alone[v].mean, rtol=1e-12, atol=1e-12)
            assert_allclose(together[v].cov[run], alone[v].cov, rtol=1e-12, atol=1e-12)


LEADS = [(3,), (1,), (2, 3), (2, 1), (1, 1), (2, 1, 3)]


@pytest.mark.parametrize("lead", LEADS)
def test_evidence_with_axes_of_runs(lead):
    drawn = regular(0, 9, 2)
    rng = np.random.default_rng(0)
    evidence, hidden = drawn.observe(rng, 0.4)
    batch = {v: x + rng.normal(size=(*lead, x.size)) for v, x in evidence.items()}
    graph = pgm.compile(drawn.network())
    assert_runs(
        graph, lead, batch, lambda run: (graph, {v: x[run] for v, x in batch.items()}), hidden
    )


def test_axes_that_broadcast():
    """One variable without axes, one with an inner one, one with a length of one."""
    drawn = regular(1, 9, 2)
    rng = np.random.default_rng(1)
    evidence, hidden = drawn.observe(rng, 0.5)
    shapes = itertools.cycle([(), (3,), (2, 1), (1, 1), (2, 3)])
    batch = {v: x + rng.normal(size=(*next(shapes), x.size)) for v, x in evidence.items()}
    wide = {v: np.broadcast_to(x, (2, 3, x.shape[-1])) for v, x in batch.items()}
    graph = pgm.compile(drawn.network())
    assert_runs(
        graph, (2, 3), batch, lambda run: (graph, {v: x[run] for v, x in wide.items()}), hidden
    )


def network(mean, cov, noise=0.5):
    return pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(p, mean, cov),
            pgm.LinearGaussianCPD(a, {p: [[1.0, 0.5]]}, cov=0.3),
            pgm.LinearGaussianCPD(b, {p: [[0.0, 1.0]], a: -1.0}, offset=0.2, cov=noise),
        ]
    )


MEANS = np.random.default_rng(2).normal(size=(3, 2))
COVS = np.array([np.eye(2), [[2.0, 0.5], [0.5, 1.0]], 0.25 * np.eye(2)])


@pytest.mark.parametrize("evidence", [{}, {b: 1.5}, {b: [[1.0], [0.0], [-1.0]]}])
def test_priors_whose_means_differ(evidence):
    graph = pgm.compile(network(MEANS, np.eye(2)))
    value = {v: np.broadcast_to(np.reshape(x, (-1, 1)), (3, 1)) for v, x in evidence.items()}

    def single(run):
        return pgm.compile(network(MEANS[run], np.eye(2))), {v: x[run] for v, x in value.items()}

    assert_runs(graph, (3,), evidence, single, [p, a])


@pytest.mark.parametrize("evidence", [{}, {b: 1.5}, {b: [[1.0], [0.0], [-1.0]]}])
def test_priors_whose_covariances_differ(evidence):
    graph = pgm.compile(network(MEANS[0], COVS))
    value = {v: np.broadcast_to(np.reshape(x, (-1, 1)), (3, 1)) for v, x in evidence.items()}

    def single(run):
        return pgm.compile(network(MEANS[0], COVS[run])), {v: x[run] for v, x in value.items()}

    assert_runs(graph, (3,), evidence, single, [p, a])


def test_priors_and_evidence_with_other_axes():
    """Means along one axis, covariances along another, evidence along both."""
    values = np.random.default_rng(3).normal(size=(2, 3, 1))
    graph = pgm.compile(network(MEANS, COVS[:2, None]))

    def single(run):
        return pgm.compile(network(MEANS[run[1]], COVS[run[0]])), {b: values[run]}

    assert_runs(graph, (2, 3), {b: values}, single, [a, p])


def test_a_prior_that_is_observed():
    """Its density differs by run, and so the log-evidence."""
    graph = pgm.compile(network(MEANS, COVS))

    def single(run):
        return pgm.compile(network(MEANS[run], COVS[run])), {p: [0.5, 0.0]}

    assert_runs(graph, (3,), {p: [0.5, 0.0]}, single, [a, b])


def noisy():
    spread = pgm.noise(lambda u: 0.1 + u[..., None] ** 2, given=(u,))
    return pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 1.0, 2.0),
            pgm.LinearGaussianCPD(b, {a: 1.0, w: 2.0}, cov=spread),
            pgm.LinearGaussianCPD(c, {b: 1.0}, cov=0.5),
            pgm.LinearGaussianCPD(d, {a: -1.0, w: 1.0}, cov=1.0),
        ]
    )


def test_inputs_that_differ():
    graph = pgm.compile(noisy())
    inputs = np.random.default_rng(4).normal(size=(4, 1))
    batch = {w: inputs, u: 0.3, c: 1.0}
    assert_runs(graph, (4,), batch, lambda run: (graph, {**batch, w: inputs[run]}), [a, b, d])


def test_noise_that_differs():
    graph = pgm.compile(noisy())
    level = np.array([[0.0], [0.5], [3.0]])
    batch = {w: 0.5, u: level, c: [[1.0], [2.0], [3.0]]}

    def single(run):
        return graph, {w: 0.5, u: level[run], c: [1.0 + run[0]]}

    assert_runs(graph, (3,), batch, single, [d, b, a])


def test_noise_and_an_input_along_different_axes():
    graph = pgm.compile(noisy())
    level, inputs = np.array([[[0.2]], [[2.0]]]), np.array([[0.0], [1.0], [-2.0]])
    batch = {w: inputs, u: level, d: 0.3}

    def single(run):
        return graph, {w: inputs[run[1]], u: level[run[0], 0], d: 0.3}

    assert_runs(graph, (2, 3), batch, single, [a, c, b])


def test_a_thousand_runs_are_one_pass():
    """Far more runs than numbers in a cluster."""
    drawn = regular(5, 12, 2, reach=4)
    rng = np.random.default_rng(5)
    evidence, hidden = drawn.observe(rng, 0.4)
    batch = {v: x + rng.normal(size=(1000, x.size)) for v, x in evidence.items()}
    posterior = pgm.infer(pgm.compile(drawn.network()), batch)
    dense = drawn.dense()
    for run in (0, 500, 999):
        due, log_evidence = dense.given({v: x[run] for v, x in batch.items()})
        assert_allclose(posterior.log_evidence[run], log_evidence, rtol=1e-9)
        assert_allclose(posterior.joint(*hidden).mean[run], due.marginal(*hidden)[0], atol=1e-9)
