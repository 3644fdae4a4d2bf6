"""Networks with CPDs without noise, against conditioning in rational numbers."""

from itertools import pairwise

import numpy as np
import pytest
from crossed import crossed
from gaussian.draws import (
    Conditioned,
    assert_moments,
    regular,
    singular,
    turned,
    turned_back,
)
from numpy.testing import assert_allclose
from textbooks import assert_log

import pgm

I2, O2 = np.eye(2), np.zeros((2, 2))
a, b, c, d, e = pgm.variables("a b c d e")
p, q = (pgm.Variable(name, (f"{name}0", f"{name}1")) for name in "pq")
ORDERS = [
    None,
    pgm.JunctionTree(order=lambda net: net.variables),
    pgm.JunctionTree(order=lambda net: net.variables[::-1]),
    lambda net: pgm.ClusterGraph(net, [set(net.variables)]),
]


def prior(v, mean=0.0, cov=1.0):
    return pgm.GaussianCPD(v, mean, cov)


def linear(v, given, cov=0.0, offset=0.0):
    return pgm.LinearGaussianCPD(v, given, cov=cov, offset=offset)


def solve(cpds, evidence, method=None):
    return pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds), method=method), evidence)


# ---- random networks


def check(drawn, evidence, hidden, posterior, turns=None):
    """The joint of everything hidden, in the fractions' coordinates; True if it has a density."""
    due = Conditioned(drawn, evidence)
    if hidden:
        joint = posterior.joint(*hidden)
        mean, cov = (joint.mean, joint.cov) if turns is None else turned_back(joint, turns)
        assert_moments(mean, cov, *due[hidden])
        # A determined direction has no variance left, not a little of either sign.
        assert np.linalg.eigvalsh(joint.cov).min() >= -1e-12 * np.abs(joint.cov).max()
    if due.certain:
        return False
    units = 0.0
    if turns is not None:
        units = sum(np.linalg.slogdet(turns[v][0])[1] for v in evidence)
    assert_log(posterior.log_evidence + units, due.log_evidence)
    return True


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_random_ranks_in_fractions(share):
    kinds = set()
    for seed in range(45):
        rng = np.random.default_rng(seed)
        drawn = singular(seed, int(rng.integers(2, 10)), share=share)
        evidence, hidden = drawn.observe(rng, 0.35)
        graph = pgm.compile(drawn.network(rng), method=ORDERS[seed % 4])
        kinds.add(check(drawn, evidence, hidden, pgm.infer(graph, evidence)))
    assert kinds == {True, False}


@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_random_ranks_in_coordinates_that_round(shift):
    for seed in range(100, 145):
        rng = np.random.default_rng(seed)
        drawn = singular(seed, int(rng.integers(2, 10)), share=0.8)
        evidence, hidden = drawn.observe(rng, 0.35)
        other, turns = turned(drawn, seed, shift, units=0.3)
        graph = pgm.compile(other.network(rng), method=ORDERS[seed % 4])
        posterior = pgm.infer(graph, {v: other.values[v] for v in evidence})
        check(drawn, evidence, hidden, posterior, turns)


@crossed(("seed", "method"), [10361, 10814, 11083], ORDERS)
def test_ranks_and_sepsets_that_are_hard_to_tell_from_rounding(seed, method):
    """A noise of rank 1 with a small component; sepsets that are certain but for rounding."""
    rng = np.random.default_rng(seed)
    drawn = singular(seed, int(rng.integers(2, 11)), share=0.8)
    evidence, hidden = drawn.observe(rng, 0.35)
    other, turns = turned(drawn, seed, 1.0, units=0.3)
    for _ in range(3):
        graph = pgm.compile(other.network(rng), method=method)
        posterior = pgm.infer(graph, {v: other.values[v] for v in evidence})
        check(drawn, evidence, hidden, posterior, turns)


def test_larger_networks_in_fractions():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        drawn = singular(seed, 16, most=2, parents=2)
        evidence, hidden = drawn.observe(rng, 0.35)
        check(drawn, evidence, hidden, pgm.infer(pgm.compile(drawn.network(rng)), evidence))


def test_a_batch_with_exact_relations_equals_its_runs():
    drawn = singular(11, 8, share=1.0)
    rng = np.random.default_rng(11)
    evidence, hidden = drawn.observe(rng, 0.3)
    # Readings of another draw of the exact network: multiples of the deviations from the means.
    dense = drawn.dense()
    means = {v: dense.marginal(v)[0] for v in evidence}
    shares = np.array([0.0, 0.25, 0.5, 1.0])[:, None]
    batch = {v: means[v] + shares * (evidence[v] - means[v]) for v in evidence}
    graph = pgm.compile(drawn.network())
    together = pgm.infer(graph, batch)
    for run in range(4):
        alone = pgm.infer(graph, {v: batch[v][run] for v in batch})
        assert_allclose(together.log_evidence[run], alone.log_evidence, rtol=1e-12)
        for v in hidden:
            assert_allclose(together[v].mean[run], alone[v].mean, rtol=1e-12, atol=1e-12)
            assert_allclose(together[v].cov[run], alone[v].cov, rtol=1e-12, atol=1e-14)


# ---- cases by hand


@pytest.mark.parametrize("method", ORDERS)
def test_a_copy(method):
    """b = 2 a exactly: its value is half known from a noisy one of c = b + noise."""
    cpds = [prior(a), linear(b, {a: 2.0}), linear(c, {b: 1.0}, cov=4.0)]
    posterior = solve(cpds, {c: 2.0}, method)
    assert_allclose(posterior.joint(a, b).mean, [0.5, 1.0], rtol=1e-14)
    assert_allclose(posterior.joint(a, b).cov, [[0.5, 1.0], [1.0, 2.0]], rtol=1e-14)
    assert_allclose(posterior.log_evidence, -0.5 * (np.log(16 * np.pi) + 4.0 / 8.0), rtol=1e-14)


@pytest.mark.parametrize("method", ORDERS)
def test_a_copy_that_is_observed(method):
    """Then a is known, and ln p(b) is that of N(0, 4)."""
    cpds = [prior(a), linear(b, {a: 2.0}), linear(c, {a: 1.0}, cov=1.0)]
    posterior = solve(cpds, {b: 3.0}, method)
    assert_allclose(posterior[a].mean, [1.5], rtol=1e-15)
    assert posterior[a].cov == 0.0
    assert_allclose(posterior[c].mean, [1.5], rtol=1e-15)
    assert_allclose(posterior[c].cov, [[1.0]], rtol=1e-15)
    assert_allclose(posterior.log_evidence, -0.5 * (np.log(8 * np.pi) + 9.0 / 4.0), rtol=1e-14)


@pytest.mark.parametrize("method", ORDERS)
def test_an_observed_sum(method):
    cpds = [prior(a), prior(b, 1.0, 3.0), linear(c, {a: 1.0, b: 1.0})]
    posterior = solve(cpds, {c: 3.0}, method)
    joint = posterior.joint(a, b)
    assert_allclose(joint.mean, [0.5, 2.5], rtol=1e-14)
    assert_allclose(joint.cov, 0.75 * np.array([[1, -1], [-1, 1]]), rtol=1e-14)
    assert_allclose(posterior.log_evidence, -0.5 * (np.log(8 * np.pi) + 1.0), rtol=1e-14)


@pytest.mark.parametrize("method", ORDERS)
def test_a_long_deterministic_chain(method):
    v = pgm.variables(" ".join(f"v{k}" for k in range(60)))
    cpds = [prior(v[0], 1.0, 4.0)]
    cpds += [linear(y, {x: -1.0}, offset=0.5) for x, y in pairwise(v)]
    posterior = solve(cpds, {v[30]: 2.0}, method)
    for k in (0, 29, 31, 58):
        assert_allclose(posterior[v[k]].mean, [-1.5 if k % 2 else 2.0], rtol=1e-13)
        assert posterior[v[k]].cov == 0.0
    assert_allclose(posterior.log_evidence, -0.5 * (np.log(8 * np.pi) + 0.25), rtol=1e-12)
    unread = solve(cpds, {}, method)
    assert_allclose(unread.joint(v[59], v[0]).cov, [[4.0, -4.0], [-4.0, 4.0]], rtol=1e-13)
    assert_allclose(unread.log_evidence, 0.0, atol=1e-13)


@pytest.mark.parametrize("method", ORDERS)
def test_readings_that_agree(method):
    """Three exact ones of one number, and one that two others imply."""
    cpds = [prior(p, [0, 0], I2)]
    rows = {a: [1, 0], b: [1, 0], c: [0.3, 0.7], d: [1, 1]}
    cpds += [linear(v, {p: [row]}) for v, row in rows.items()]
    seen = {a: 0.1, b: 0.1, c: 0.3 * 0.1 + 0.7 * 0.2, d: 0.1 + 0.2}
    posterior = solve([*cpds, linear(e, {p: [[1.0, -1.0]]}, cov=0.25)], seen, method)
    assert_allclose(posterior[p].mean, [0.1, 0.2], rtol=1e-13)
    assert_allclose(posterior[p].cov, O2, atol=0)
    assert_allclose(posterior[e].mean, [-0.1], rtol=1e-12)
    assert_allclose(posterior[e].cov, [[0.25]], rtol=1e-13)


@pytest.mark.parametrize("method", ORDERS)
def test_a_prior_that_is_certain(method):
    """What is known beforehand takes part in everything, and adds nothing to the log-evidence."""
    cpds = [prior(a, 0.7, 0.0), linear(b, {a: 1 / 3}, offset=0.1), prior(c)]
    cpds += [linear(d, {b: 2.0, c: 1.0}, cov=1.0)]
    known = 0.7 / 3 + 0.1
    posterior = solve(cpds, {d: 2 * known + 1.0, b: known}, method)
    assert_allclose(posterior[a].mean, [0.7], rtol=1e-15)
    assert posterior[a].cov == 0.0
    assert_allclose(posterior[c].mean, [0.5], rtol=1e-14)
    assert_allclose(posterior.log_evidence, -0.5 * (np.log(4 * np.pi) + 0.5), rtol=1e-13)


def test_everything_certain():
    cpds = [prior(a, 1e10 / 3, 0.0), linear(b, {a: 1 / 7}), linear(c, {a: 1.0, b: 1.3})]
    value = 1e10 / 3
    posterior = solve(cpds, {c: value + 1.3 * (value / 7)})
    assert posterior.log_evidence == 0.0
    assert posterior.joint(a, b).cov.tolist() == O2.tolist()
    assert_allclose(posterior.joint(b, a).mean, [value / 7, value], rtol=1e-15)


def test_vectors_of_which_a_part_is_exact():
    """Noise of rank 1 in two components: their difference is exact."""
    cov = [[1.0, 1.0], [1.0, 1.0]]
    posterior = solve([prior(p, [0, 0], I2), linear(q, {p: 1.0}, cov=cov)], {q: [1.0, 0.5]})
    # p₀ − p₁ = 1/2, and the sum is seen with variance 4 about 3/2, a prior one of 2.
    mean, cov = 1.5 / 3.0, 4.0 / 3.0
    assert_allclose(posterior[p].mean, [0.5 * mean + 0.25, 0.5 * mean - 0.25], atol=1e-15)
    assert_allclose(posterior[p].cov, 0.25 * cov * np.ones((2, 2)), rtol=1e-14)


def test_noise_of_rank_2_whose_first_components_are_nearly_one():
    """The rounding behind a small pivot is no noise of the third component."""
    x = pgm.Variable("x", ("x0", "x1", "x2"))
    rng = np.random.default_rng(0)
    for _ in range(30):
        root = rng.normal(size=(3, 2)) + np.array([[4.0, 0.0], [5.0, 0.0], [4.0, -1.0]])
        root[:2, 1] = 0.0, 0.01 * rng.normal()
        given = rng.normal(size=(3, 1))
        posterior = solve([prior(a), linear(x, {a: given}, cov=root @ root.T)], {})
        due = root @ root.T + given @ given.T
        assert_allclose(posterior[x].cov, due, rtol=1e-11)
        normal = np.cross(*root.T) / np.linalg.norm(np.cross(*root.T))
        assert_allclose(normal @ posterior.joint(x, a).cov[:3, 3], normal @ given[:, 0], atol=1e-11)
        # Two readings of one a and the same two noises: what they share is exact.
        seen = solve([prior(a), linear(x, {a: given}, cov=root @ root.T)], {x: given[:, 0]})
        assert_allclose(seen[a].mean, [1.0], rtol=1e-9)
        assert seen[a].cov < 1e-20


def test_coefficients_that_only_rounding_leaves_are_no_relations():
    """Readings of (m p + n): their differences say nothing of p, however they are rounded."""
    x = pgm.Variable("x", ("x0", "x1", "x2"))
    rng = np.random.default_rng(1)
    for _ in range(20):
        parts, m = rng.normal(size=(3, 1)), rng.normal(size=(1, 2))
        cpds = [prior(p, [0, 0], I2), linear(x, {p: parts @ m}, cov=parts @ parts.T)]
        posterior = solve(cpds, {x: 1.7 * parts[:, 0]})
        gain = m[0] / (1.0 + m[0] @ m[0])
        assert_allclose(posterior[p].mean, 1.7 * gain, rtol=1e-12)
        assert_allclose(posterior[p].cov, I2 - np.outer(gain, m[0]), rtol=1e-12)


def test_noise_that_vanishes_when_a_cpd_is_linearised_anew():
    """An exact reading of max(x, 0): bent at the prior, straight at the posterior."""
    rectified = pgm.NonlinearGaussianCPD(b, a, lambda a: np.maximum(a, 0.0), 0.0)
    graph = pgm.compile(pgm.BayesianNetwork([prior(a), linear(c, {a: 1.0}, cov=0.01), rectified]))
    schedule = pgm.Calibration(iterations=5)
    posterior = pgm.infer(graph, {b: 3.05, c: 3.0}, schedule=schedule, lineariser=pgm.Unscented())
    assert posterior.status.converged
    assert_allclose(posterior[a].mean, [3.05], rtol=1e-15)
    assert posterior[a].cov == 0.0
    due = -0.5 * (np.log(2 * np.pi) + 3.05**2 + np.log(0.02 * np.pi) + 0.05**2 / 0.01)
    assert_allclose(posterior.log_evidence, due, rtol=1e-13)


# ---- contradictions


def refused(call, cluster, *words):
    with pytest.raises(pgm.NumericalError, match="contradicts an exact model") as caught:
        call()
    assert caught.value.cluster == cluster
    for word in (f"cluster {cluster}", *words):
        assert word in str(caught.value)


def test_readings_that_disagree():
    cpds = [prior(a), linear(b, {a: 1.0}), linear(c, {a: 1.0})]
    graph = pgm.compile(pgm.BayesianNetwork(cpds))
    assert len(graph) == 2
    with pytest.raises(pgm.NumericalError, match="contradicts an exact model at cluster") as caught:
        pgm.infer(graph, {b: 1.0, c: 1.001})
    assert caught.value.cluster in (0, 1)
    assert "some noise" in str(caught.value)
    assert "run" not in str(caught.value)


def test_a_reading_that_a_certain_prior_excludes():
    graph = pgm.compile(pgm.BayesianNetwork([prior(a, 1.0, 0.0), linear(b, {a: 2.0})]))
    refused(lambda: pgm.infer(graph, {b: 2.1}), 0, "(a, b)")
    refused(lambda: pgm.infer(graph, {a: 1.1}), 0)


def test_the_run_that_contradicts_is_named():
    graph = pgm.compile(pgm.BayesianNetwork([prior(a, 1.0, 0.0), linear(b, {a: 2.0})]))
    refused(lambda: pgm.infer(graph, {b: [[2.0], [2.0], [2.5], [2.0]]}), 0, "run 2")


def test_a_contradiction_of_one_run_is_not_hidden_by_the_size_of_another():
    graph = pgm.compile(
        pgm.BayesianNetwork([pgm.GaussianCPD(a, [[1e9], [1.0]], 0.0), linear(b, {a: 2.0})])
    )
    pgm.infer(graph, {b: [[2e9], [2.0]]})
    refused(lambda: pgm.infer(graph, {b: [[2e9], [2.01]]}), 0, "run 1")


def test_noise_and_exactness_may_differ_by_run():
    """A prior that is certain in some runs, where readings must agree with it."""
    cov = np.array([0.0, 1.0, 4.0])[:, None, None]
    cpds = [pgm.GaussianCPD(a, 1.0, cov), linear(b, {a: 2.0}), linear(c, {a: 1.0}, cov=1.0)]
    graph = pgm.compile(pgm.BayesianNetwork(cpds))
    posterior = pgm.infer(graph, {c: 2.0})
    gain = cov[:, 0] / (cov[:, 0] + 1.0)
    assert_allclose(posterior[a].mean, 1.0 + gain, rtol=1e-14)
    assert_allclose(posterior[b].cov[:, 0], 4.0 * gain, rtol=1e-13)
    due = -0.5 * (np.log(2 * np.pi * (1 + cov[:, 0, 0])) + 1.0 / (1 + cov[:, 0, 0]))
    assert_allclose(posterior.log_evidence, due, rtol=1e-14)
    posterior = pgm.infer(graph, {b: [[2.0], [3.0], [3.0]]})
    assert_allclose(posterior[a].mean[:, 0], [1.0, 1.5, 1.5], rtol=1e-14)
    refused(lambda: pgm.infer(graph, {b: 3.0}), 0, "run 0")


def test_proper_networks_have_no_exact_relations():
    """No singular value is computed where no CPD lacks noise."""
    drawn = regular(0, 5)
    evidence, _ = drawn.observe(np.random.default_rng(0), 0.4)
    posterior = pgm.infer(pgm.compile(drawn.network()), evidence)
    assert posterior._outcome._messages.buffer.exact is None
