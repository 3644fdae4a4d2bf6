"""Edges: nothing or everything observed, inputs that are left out, values that stay as they are."""

import pickle
from contextlib import suppress

import numpy as np
import pytest
from gaussian.draws import regular
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

import pgm
from pgm import EvidenceError
from pgm.schedules import limits

a, b, c, d, u, w = pgm.variables("a b c d u w")


def prior(v, mean=0.0, cov=1.0):
    return pgm.GaussianCPD(v, mean, cov)


def linear(v, given, cov=1.0):
    return pgm.LinearGaussianCPD(v, given, cov=cov)


def graph(*cpds):
    return pgm.compile(pgm.BayesianNetwork(cpds))


def test_one_variable():
    alone = graph(prior(a, 1.0, 2.0))
    assert_allclose(pgm.infer(alone, {})[a].mean, [1.0])
    assert_allclose(pgm.infer(alone, {})[a].cov, [[2.0]])
    assert pgm.infer(alone, {}).log_evidence == pytest.approx(0.0, abs=1e-15)
    due = multivariate_normal(1.0, 2.0).logpdf(0.5)
    assert_allclose(pgm.infer(alone, {a: 0.5}).log_evidence, due, rtol=1e-15)


def test_nothing_observed():
    drawn = regular(0, 8, 2)
    posterior = pgm.infer(pgm.compile(drawn.network()), {})
    dense = drawn.dense()
    for v in drawn.variables:
        assert_allclose(posterior[v].mean, dense.marginal(v)[0], atol=1e-12)
        assert_allclose(posterior[v].cov, dense.marginal(v)[1], atol=1e-12)
    assert posterior.log_evidence == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("lead", [(), (3,), (2, 1)])
def test_everything_observed(lead):
    drawn = regular(1, 8, 2)
    rng = np.random.default_rng(1)
    evidence = {v: drawn.values[v] + rng.normal(size=(*lead, v.dimension)) for v in drawn.variables}
    posterior = pgm.infer(pgm.compile(drawn.network()), evidence)
    mean, cov = drawn.dense().marginal(*drawn.variables)
    values = np.concatenate([evidence[v] for v in drawn.variables], axis=-1)
    due = multivariate_normal(mean, cov).logpdf(values).reshape(lead)
    assert posterior.log_evidence.shape == lead
    assert_allclose(posterior.log_evidence, due, rtol=1e-10)
    assert posterior.belief(0).scope == ()
    assert posterior.status.converged.all()
    with pytest.raises(EvidenceError, match="is observed"):
        posterior[drawn.variables[0]]


def test_the_shape_of_a_scalar_s_evidence():
    """A number, or an array with the component axis."""
    net = graph(prior(a), linear(b, {a: 1.0}))
    for value in (2, 2.0, np.float32(2), np.array(2.0), [2.0], np.array([2.0])):
        assert_allclose(pgm.infer(net, {b: value})[a].mean, [1.0])
    assert_allclose(pgm.infer(net, {b: pgm.constant(2.0)})[a].mean, [1.0])
    assert pgm.infer(net, {b: [[2.0]]})[a].mean.shape == (1, 1)


# ---- inputs


def test_a_leaf_whose_input_has_no_evidence_is_left_out():
    net = graph(prior(a), linear(b, {a: 1.0, u: 1.0}), linear(c, {a: 1.0}))
    posterior = pgm.infer(net, {c: 1.0})
    assert_allclose(posterior[a].mean, [0.5])
    for lost in (b, u):
        with pytest.raises(EvidenceError, match=r"left out.*give them values") as caught:
            posterior[lost]
        assert caught.value.variable == lost
    with pytest.raises(EvidenceError, match="left out"):
        posterior.joint(a, b)
    assert_allclose(pgm.infer(net, {c: 1.0, u: 3.0})[b].mean, [3.5])


def test_a_leaf_whose_noise_lacks_its_input_is_left_out():
    spread = pgm.noise(lambda u: 1.0 + u[..., None] ** 2, given=(u,))
    net = graph(prior(a), linear(b, {a: 1.0}, spread), linear(c, {a: 1.0}))
    posterior = pgm.infer(net, {c: 1.0})
    assert_allclose(posterior[a].mean, [0.5])
    with pytest.raises(EvidenceError, match="left out"):
        posterior[b]
    assert_allclose(pgm.infer(net, {c: 1.0, u: 2.0})[b].cov, [[5.5]])


@pytest.mark.parametrize("evidence", [{b: 1.0}, {d: 1.0}, {}])
def test_an_input_that_is_needed(evidence):
    """Of an observed child, and of one that something depends on, observed or not."""
    net = graph(prior(a), linear(b, {a: 1.0, u: 1.0}), linear(d, {b: 1.0}))
    with pytest.raises(
        EvidenceError, match=r"no evidence for u in LinearGaussianCPD\(b \| a, u\)"
    ) as caught:
        pgm.infer(net, evidence)
    assert caught.value.variable == u
    assert caught.value.cpd.child == b


def test_an_input_with_a_needed_child_and_another():
    """It is kept for the one, and the other, which could be left out, still needs its own."""
    net = graph(prior(a), linear(b, {a: 1.0, u: 1.0}), linear(c, {u: 1.0, w: 1.0}))
    posterior = pgm.infer(net, {b: 1.0, u: 1.0})
    assert_allclose(posterior[a].mean, [0.0])
    with pytest.raises(EvidenceError, match="left out"):
        posterior[c]
    with pytest.raises(EvidenceError, match="no evidence for u"):
        pgm.infer(net, {b: 1.0, w: 1.0})


def test_noise_of_a_hidden_variable():
    spread = pgm.noise(lambda a: 1.0 + a[..., None] ** 2, given=(a,))
    net = graph(prior(a), linear(b, {a: 1.0}, spread), linear(c, {b: 1.0}))
    with pytest.raises(
        EvidenceError, match=r"no evidence for a.*a noise can depend on known"
    ) as caught:
        pgm.infer(net, {b: 1.0})
    assert caught.value.variable == a
    assert_allclose(pgm.infer(net, {a: 2.0})[b].cov, [[5.0]])


def test_everything_left_out():
    net = graph(linear(a, {u: 1.0}), linear(b, {u: 1.0}))
    posterior = pgm.infer(net, {})
    assert posterior.log_evidence == 0.0
    with pytest.raises(EvidenceError, match="left out"):
        posterior[a]


# ---- values


def posterior_of(drawn, share=0.4, lead=()):
    evidence, hidden = drawn.observe(np.random.default_rng(2), share)
    batch = {v: x + np.zeros((*lead, x.size)) for v, x in evidence.items()}
    return pgm.infer(pgm.compile(drawn.network()), batch), hidden


def test_results_cannot_be_changed():
    for lead in ((), (2,)):
        posterior, hidden = posterior_of(regular(2, 8, 2), lead=lead)
        with pytest.raises(AttributeError):
            posterior.graph = None
        arrays = [posterior[hidden[0]].mean, posterior[hidden[0]].cov, posterior.joint(*hidden).cov]
        arrays += [posterior.belief(0).K, posterior.belief(0).h, posterior.status.converged]
        for array in arrays:
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.0
        before = np.array(posterior.log_evidence)
        with suppress(ValueError, TypeError):
            posterior.log_evidence[...] = 0.0
        assert_array_equal(posterior.log_evidence, before)


def test_the_evidence_is_copied():
    drawn = regular(3, 6, 2)
    graph = pgm.compile(drawn.network())
    value = np.array(drawn.values[drawn.variables[-1]])
    posterior = pgm.infer(graph, {drawn.variables[-1]: value})
    before = np.array(posterior[drawn.variables[0]].mean), float(posterior.log_evidence)
    kept = posterior.belief(0).h.copy()
    value += 100.0
    assert_array_equal(posterior[drawn.variables[0]].mean, before[0])
    assert float(posterior.log_evidence) == before[1]
    assert_array_equal(posterior.belief(0).h, kept)


def test_pickling():
    posterior, hidden = posterior_of(regular(4, 8, 2), lead=(2,))
    copy = pickle.loads(pickle.dumps(posterior))
    for v in hidden:
        assert_array_equal(copy[v].mean, posterior[v].mean)
        assert_array_equal(copy[v].cov, posterior[v].cov)
    assert_array_equal(copy.joint(*hidden[::-1]).cov, posterior.joint(*hidden[::-1]).cov)
    assert_array_equal(copy.log_evidence, posterior.log_evidence)
    i, j = next(iter(posterior.graph.sepsets))
    assert_array_equal(copy.message(i, j).K, posterior.message(i, j).K)
    graph = pickle.loads(pickle.dumps(posterior.graph))
    evidence = {v: np.zeros(v.dimension) for v in graph.network.variables if v not in hidden}
    again, before = pgm.infer(graph, evidence), pgm.infer(posterior.graph, evidence)
    assert_array_equal(again[hidden[0]].mean, before[hidden[0]].mean)


def test_a_repr_of_a_posterior():
    posterior, _ = posterior_of(regular(5, 4, 1), lead=(2, 1))
    assert repr(posterior).startswith("Posterior(ClusterGraph(")
    assert "runs (2, 1)" in repr(posterior)


def test_covariances_too_large_are_refused(monkeypatch):
    x, y = pgm.Variable("x", components=("p", "q", "r")), pgm.Variable("y")
    bent = pgm.NonlinearGaussianCPD(y, x, lambda x: x[..., :1] ** 2, cov=1.0)
    graph = pgm.compile(pgm.BayesianNetwork([pgm.GaussianCPD(x, [1, 2, 3], np.eye(3)), bent]))
    monkeypatch.setattr(limits, "LIMIT", 8)
    with pytest.raises(pgm.GraphError, match=r"covariances.*too large.*cluster 0 over \(x, y\)"):
        pgm.infer(graph, {y: 1.0})
    monkeypatch.setattr(limits, "LIMIT", 30)
    assert pgm.infer(graph, {y: np.ones((3, 1))})[x].mean.shape == (3, 3)
    with pytest.raises(pgm.GraphError, match=r"for 4 runs.*fewer runs at once, 3 at the most"):
        pgm.infer(graph, {y: np.ones((4, 1))})
