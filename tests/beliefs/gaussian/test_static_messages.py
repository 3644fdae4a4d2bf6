"""Messages and beliefs of trees against a plain pass of canonical forms, (5.10) and (5.14)."""

from functools import reduce
from operator import mul

import numpy as np
import pytest
from crossed import slow_after
from gaussian.draws import regular
from numpy.testing import assert_allclose
from textbooks import assert_log

import pgm
from pgm import CanonicalForm

a, b, c, d, e = pgm.variables("a b c d e")
one = CanonicalForm.vacuous(())


def potentials(graph, evidence):
    """The product of each cluster's CPDs, reduced by evidence, over its hidden variables."""
    found = []
    for cluster in graph:
        factors = [CanonicalForm.vacuous([v for v in cluster.scope if v not in evidence])]
        for cpd in cluster.cpds:
            F = np.concatenate([np.zeros((cpd.child.dimension, 0)), *cpd.matrices.values()], axis=1)
            form = pgm.AffineGaussian(F, cpd.offset, cpd.cov).canonical(cpd.child, cpd.given)
            factors.append(form.reduce({v: evidence[v] for v in cpd.scope if v in evidence}))
        found.append(reduce(mul, factors))
    return found


def plain_pass(graph, evidence):
    """All messages {(i, j): form}, and the beliefs."""
    own, sent = potentials(graph, evidence), {}

    def send(i, j):
        if (i, j) not in sent:
            inside = reduce(mul, [send(k, i) for k in graph.neighbours(i) if k != j], own[i])
            edge = min(i, j), max(i, j)
            keep = [v for v in graph.sepsets[edge] if v not in evidence]
            sent[i, j] = inside.marginal(*keep)
        return sent[i, j]

    beliefs = [
        reduce(mul, [send(k, i) for k in graph.neighbours(i)], own[i]) for i in range(len(graph))
    ]
    for i, j in graph.sepsets:
        send(i, j)
        send(j, i)
    return sent, beliefs


def component(graph, start):
    """The clusters of the tree that holds one."""
    found, waiting = {start}, [start]
    while waiting:
        new = set(graph.neighbours(waiting.pop())) - found
        found |= new
        waiting += new
    return found


def assert_form(found, due, std, tolerance=1e-9):
    """Equal K, h and g in units of the posterior's deviations."""
    assert found.scope == due.scope
    assert found.K.shape == due.K.shape
    spread = std[:, None] * std
    bound = tolerance * (1.0 + np.abs(due.K * spread).max(initial=0.0))
    assert np.all(np.abs(found.K - due.K) * spread <= bound)
    bound = tolerance * (1.0 + np.abs(due.h * std).max(initial=0.0))
    assert np.all(np.abs(found.h - due.h) * std <= bound)
    assert np.abs(found.g - due.g) <= tolerance * (
        1.0 + np.abs(due.g) + (due.h * std) @ (due.h * std)
    )


def deviations(posterior, scope):
    return posterior.joint(*scope).std if scope else np.zeros(0)


def check(graph, evidence):
    posterior = pgm.infer(graph, evidence)
    sent, beliefs = plain_pass(graph, evidence)
    for (i, j), due in sent.items():
        assert_form(posterior.message(i, j), due, deviations(posterior, due.scope))
    total = 0.0
    for i, due in enumerate(beliefs):
        found = posterior.belief(i)
        assert_form(found, due, deviations(posterior, due.scope))
        assert_log(found.log_integral, due.log_integral)
        if due.scope:
            assert_allclose(found.gaussian().mean, posterior.joint(*due.scope).mean, atol=1e-9)
        if i == min(component(graph, i)):
            total = total + found.log_integral
        assert_log(found.log_integral, posterior.belief(min(component(graph, i))).log_integral)
    assert_log(posterior.log_evidence, total)
    for (i, j), sepset in graph.sepsets.items():
        scope = [v for v in sepset if v not in evidence]
        product = posterior.message(i, j) * posterior.message(j, i)
        for k in (i, j):
            marginal = posterior.belief(k).marginal(*scope)
            assert_form(product.rearrange(scope), marginal, deviations(posterior, scope))
    return posterior


@pytest.mark.parametrize("share", slow_after(2, [0.0, 0.3, 0.8, 1.0]))
def test_random_trees(share):
    for seed in range(8):
        drawn = regular(seed, 10, 2)
        evidence, _ = drawn.observe(np.random.default_rng(seed), share)
        check(pgm.compile(drawn.network()), evidence)


def test_several_components():
    drawn = regular(0, 30, 2, parents=1, reach=2)
    graph = pgm.compile(drawn.network())
    assert len(graph.sepsets) < len(graph) - 2
    evidence, _ = drawn.observe(np.random.default_rng(0), 0.4)
    check(graph, evidence)


def test_a_tree_by_hand_with_clusters_that_have_no_cpds():
    drawn = regular(1, 7, 2)
    clusters = [set(cluster.scope) for cluster in pgm.compile(drawn.network())]
    graph = pgm.ClusterGraph(drawn.network(), [*clusters, *clusters, {drawn.variables[0]}])
    assert any(not cluster.cpds for cluster in graph)
    evidence, _ = drawn.observe(np.random.default_rng(1), 0.3)
    check(graph, evidence)


def chain(noise=1.0, prior=1.0):
    return pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 1.0, prior),
            pgm.LinearGaussianCPD(b, {a: 2.0}, cov=noise),
            pgm.LinearGaussianCPD(c, {b: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(d, {c: 1.0}, cov=2.0),
        ]
    )


def path(net):
    return pgm.ClusterGraph(net, [{a, b}, {b, c}, {c, d}])


def test_messages_of_a_chain_by_hand():
    posterior = pgm.infer(path(chain()), {d: 3.0})
    ahead, back = posterior.message(0, 1), posterior.message(2, 1)
    assert ahead.scope == (b,)
    assert_allclose([ahead.K.item(), ahead.h.item()], [0.2, 0.4], rtol=1e-14)
    assert_allclose(ahead.log_integral, 0.0, atol=1e-14)
    assert back.scope == (c,)
    assert_allclose([back.K.item(), back.h.item()], [0.5, 1.5], rtol=1e-14)
    assert_allclose(back.g, -0.5 * (np.log(4 * np.pi) + 4.5), rtol=1e-14)


def test_a_message_that_says_nothing():
    """Children not observed integrate to one."""
    posterior = pgm.infer(path(chain()), {})
    for i, j in ((2, 1), (1, 0)):
        assert_form(
            posterior.message(i, j),
            CanonicalForm.vacuous(posterior.graph.sepsets[j, i]),
            np.ones(1),
        )
    assert posterior.log_evidence == pytest.approx(0.0, abs=1e-14)


def test_a_message_over_observed_variables_is_a_number():
    posterior = check(path(chain()), {b: 1.0, c: 0.5})
    message = posterior.message(0, 1)
    assert message.scope == ()
    assert message.K.shape == (0, 0)
    assert_allclose(message.g, -0.5 * (np.log(2 * np.pi * 5.0) + 1.0 / 5.0), rtol=1e-14)


def test_clusters_by_value():
    graph = path(chain())
    posterior = pgm.infer(graph, {d: 3.0})
    by_value = posterior.message(graph.clusters[0], graph.clusters[1])
    assert by_value.K == posterior.message(0, 1).K
    assert posterior.belief(graph.clusters[2]).K.tolist() == posterior.belief(2).K.tolist()


def test_runs():
    graph = path(chain())
    values = np.array([[3.0], [-1.0], [0.0]])
    together = pgm.infer(graph, {d: values})
    assert together.belief(1).K.shape == (3, 2, 2)
    assert together.message(2, 1).g.shape == (3,)
    for run in range(3):
        alone = pgm.infer(graph, {d: values[run]})
        for found, due in (
            (together.message(2, 1), alone.message(2, 1)),
            (together.message(0, 1), alone.message(0, 1)),
            (together.belief(0), alone.belief(0)),
        ):
            assert_allclose(found.K[run], due.K, rtol=1e-12)
            assert_allclose(found.h[run], due.h, rtol=1e-12, atol=1e-14)
            assert_allclose(found.g[run], due.g, rtol=1e-12)


def refused(call, *words, cluster):
    with pytest.raises(pgm.NumericalError, match="has no canonical form") as caught:
        call()
    for word in words:
        assert word in str(caught.value)
    assert caught.value.cluster == cluster


def test_messages_that_cpds_without_noise_determine():
    """b = 2 a, and a is certain: no canonical form; moments, and other messages, exist."""
    posterior = pgm.infer(path(chain(noise=0.0, prior=0.0)), {d: 3.0})
    refused(lambda: posterior.message(0, 1), "from cluster 0 to 1", "(b)", "joint", cluster=0)
    refused(lambda: posterior.belief(0), "belief of cluster 0", "(a, b)", cluster=0)
    refused(lambda: posterior.belief(1), "belief of cluster 1", cluster=1)
    assert_allclose([posterior[a].mean.item(), posterior[b].mean.item()], [1.0, 2.0])
    assert_allclose(posterior[c].mean, [2.0 + 1.0 / 3.0], rtol=1e-14)
    assert_allclose(posterior.message(2, 1).K, [[0.5]], rtol=1e-14)
    back = posterior.message(1, 0)
    assert_allclose([back.K.item(), back.h.item()], [1 / 3, 1.0], rtol=1e-14)
    assert_allclose(posterior.belief(2).K, [[1.0 + 0.5]], rtol=1e-14)


def test_a_relation_that_is_integrated_out_leaves_a_message():
    """b = 2 a with a uncertain is a density over b."""
    posterior = pgm.infer(path(chain(noise=0.0)), {d: 3.0})
    ahead = posterior.message(0, 1)
    assert_allclose([ahead.K.item(), ahead.h.item()], [0.25, 0.5], rtol=1e-14)
    refused(lambda: posterior.belief(0), "belief of cluster 0", cluster=0)
    assert_log(posterior.belief(1).log_integral, posterior.log_evidence)


def test_an_exact_reading_determines_a_message():
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(e, {b: 2.0}, cov=0.0),
        ]
    )
    posterior = pgm.infer(pgm.ClusterGraph(net, [{a, b}, {b, e}]), {e: 3.0})
    refused(lambda: posterior.message(1, 0), "from cluster 1 to 0", "(b)", cluster=1)
    assert_allclose(posterior[b].mean, [1.5], rtol=1e-15)
    assert posterior[b].cov == 0.0
    assert_allclose(posterior[a].mean, [0.75], rtol=1e-14)
    assert_allclose(posterior.message(0, 1).K, [[0.5]], rtol=1e-14)
