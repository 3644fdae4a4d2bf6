"""Long chains, hubs, and probabilities that numbers do not hold."""

from itertools import pairwise

import numpy as np
import pytest
from discrete.enumeration import Enumeration
from scipy.special import logsumexp

import pgm
from pgm.beliefs.discrete import tree_passes
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT

CLOSE = {"rtol": 0.0, "atol": 1e-12}


@pytest.fixture
def kernels(monkeypatch):
    """Record which kernels calibrate."""
    used = []
    calibrate = tree_passes._calibrate

    def recorded(plan, evidence, semiring):
        used.append(semiring)
        return calibrate(plan, evidence, semiring)

    monkeypatch.setattr(tree_passes, "_calibrate", recorded)
    return used


def hidden_markov(count, size, seed):
    rng = np.random.default_rng(seed)
    step, sensor = (rng.dirichlet(np.full(size, 0.3), size) for _ in range(2))
    states = [pgm.Discrete(f"x{t}", size) for t in range(count)]
    readings = [pgm.Discrete(f"z{t}", size) for t in range(count)]
    cpds = [pgm.TableCPD(states[0], table=step[0])]
    cpds += [pgm.TableCPD(b, a, table=step) for a, b in pairwise(states)]
    cpds += [pgm.TableCPD(z, x, table=sensor) for x, z in zip(states, readings, strict=True)]
    return pgm.BayesianNetwork(cpds), states, readings, step, sensor


def forward_backward(step, sensor, seen):
    """The textbook's, in logarithms: ln p(seen) and the marginals."""
    with np.errstate(divide="ignore"):
        step, sensor = np.log(step), np.log(sensor)
    ahead = [step[0] + sensor[:, seen[0]]]
    for z in seen[1:]:
        ahead.append(logsumexp(ahead[-1][:, None] + step, axis=0) + sensor[:, z])
    behind = [np.zeros(len(step))]
    for z in seen[:0:-1]:
        behind.append(logsumexp(step + sensor[:, z] + behind[-1], axis=1))
    total = logsumexp(ahead[-1])
    return total, np.exp(np.array(ahead) + np.array(behind[::-1]) - total)


def test_a_chain_of_a_thousand(kernels):
    net, states, readings, step, sensor = hidden_markov(1000, 10, 0)
    seen = np.random.default_rng(1).integers(10, size=1000)
    graph = pgm.compile(net)
    posterior = pgm.infer(graph, dict(zip(readings, map(int, seen), strict=True)))
    total, marginals = forward_backward(step, sensor, seen)
    assert total < -2000
    assert kernels == [SUM_PRODUCT]
    assert float(posterior.log_evidence) == pytest.approx(total, rel=1e-12)
    for state, due in zip(states, marginals, strict=True):
        np.testing.assert_allclose(posterior[state].values, due, rtol=1e-9, atol=1e-12)
    ends = posterior.joint(states[0], states[-1])
    np.testing.assert_allclose(ends.values.sum(axis=0), marginals[-1], **CLOSE)
    outwards = posterior.message(0, graph.neighbours(0)[0])
    assert np.isfinite(outwards.log_scale)


def test_the_log_kernel_agrees_with_numbers(monkeypatch):
    net, states, readings, _, _ = hidden_markov(40, 4, 2)
    graph = pgm.compile(net)
    evidence = {z: k % 4 for k, z in enumerate(readings[::2])}
    evidence[readings[1]] = [0, -1, 3]
    evidence[readings[3]] = pgm.soft([0.2, 0.0, 1.0, 0.4])
    plain = pgm.infer(graph, evidence)

    def never(plan, evidence, semiring):
        if semiring.linear:
            raise FloatingPointError
        return calibrate(plan, evidence, semiring)

    calibrate = tree_passes._calibrate
    monkeypatch.setattr(tree_passes, "_calibrate", never)
    logs = pgm.infer(graph, evidence)
    np.testing.assert_allclose(logs.log_evidence, plain.log_evidence, rtol=1e-13)
    for state in states:
        np.testing.assert_allclose(logs[state].values, plain[state].values, **CLOSE)
    np.testing.assert_allclose(
        logs.joint(states[3], states[30]).values, plain.joint(states[3], states[30]).values, **CLOSE
    )


def faint(*, together):
    """Two sensors that hardly ever say no when a is no, and a part that rules a = yes out."""
    a, b, c, d, e = (pgm.Discrete(name, ("no", "yes")) for name in "abcde")
    rare = [[1e-200, 1.0 - 1e-200], [0.5, 0.5]]
    cpds = [
        pgm.TableCPD(a, table=[0.4, 0.6]),
        pgm.TableCPD(b, a, table=rare),
        pgm.TableCPD(c, a, table=[[3e-200, 1.0 - 3e-200], [0.5, 0.5]]),
        pgm.TableCPD(d, a, table=[[1.0, 0.0], [0.0, 1.0]]),
        pgm.TableCPD(e, a, table=[[0.5, 0.5], [0.2, 0.8]]),
    ]
    net = pgm.BayesianNetwork(cpds)
    clusters = [{a, b, c}] if together else [{a, b}, {a, c}]
    clusters += [{a, d}, {a, e}]
    sepsets = {(k, k + 1): {a} for k in range(len(clusters) - 1)}
    return pgm.ClusterGraph(net, clusters, sepsets), a, b, c, d


@pytest.mark.parametrize("together", [False, True])
def test_what_underflows_is_not_lost(together, kernels):
    graph, a, b, c, d = faint(together=together)
    posterior = pgm.infer(graph, {b: "no", c: "no", d: "no"})
    assert kernels == [SUM_PRODUCT, LOG_SUM_PRODUCT]
    due = np.log(0.4) + np.log(1e-200) + np.log(3e-200)
    assert float(posterior.log_evidence) == pytest.approx(due, rel=1e-14)
    assert posterior[a].values.tolist() == [1.0, 0.0]
    best = pgm.most_probable(graph, {b: 0, c: 0, d: 0})
    assert float(best.log_probability) == pytest.approx(due + np.log(0.5), rel=1e-14)
    for cluster in graph:
        assert float(posterior.belief(cluster).log_total) == pytest.approx(due, rel=1e-14)
    # On its way it is made of 3e-400 and 0.25, of which d leaves the former.
    last = len(graph) - 1
    assert float(posterior.message(last - 1, last).log_total) == pytest.approx(due, rel=1e-14)
    loopy = pgm.infer(graph, {b: "no", c: "no", d: "no"}, schedule=pgm.Flooding())
    assert float(loopy.log_evidence) == pytest.approx(due, rel=1e-14)


def test_one_run_that_underflows_among_others():
    graph, a, b, c, d = faint(together=False)
    posterior = pgm.infer(graph, {b: [0, 1, 0], c: [0, 0, -1], d: [0, 1, -1]})
    singles = [pgm.infer(graph, e) for e in ({b: 0, c: 0, d: 0}, {b: 1, c: 0, d: 1}, {b: 0})]
    due = [float(single.log_evidence) for single in singles]
    np.testing.assert_allclose(posterior.log_evidence, due, rtol=1e-14)
    np.testing.assert_allclose(posterior[a].values, [s[a].values for s in singles], **CLOSE)


def test_denormal_numbers_are_not_rounded():
    """1e-310 times 0.3 is a number, but one of few digits."""
    a, b = pgm.Discrete("a", 2), pgm.Discrete("b", 2)
    cpds = [
        pgm.TableCPD(a, table=[1e-310, 1.0]),
        pgm.TableCPD(b, a, table=[[0.3, 0.7], [0.0, 1.0]]),
    ]
    graph = pgm.ClusterGraph(pgm.BayesianNetwork(cpds), [{a, b}])
    posterior = pgm.infer(graph, {b: 0})
    assert float(posterior.log_evidence) == pytest.approx(np.log(1e-310) + np.log(0.3), rel=1e-15)


def test_weights_of_any_size():
    graph, a, b, _, _ = faint(together=False)
    posterior = pgm.infer(graph, {a: pgm.soft([1e300, 1e300]), b: pgm.soft([1e-300, 0.0])})
    due = np.log(0.4 * 1e-200 + 0.6 * 0.5)
    assert float(posterior.log_evidence) == pytest.approx(due, rel=1e-12)


@pytest.fixture(scope="module")
def hub():
    rng = np.random.default_rng(3)
    centre = pgm.Discrete("centre", 3)
    leaves = [pgm.Discrete(f"leaf{k}", 2) for k in range(1000)]
    # They contradict each other, so that no state of the centre stays likely.
    tables = rng.dirichlet([0.05, 0.05], (1000, 3)).clip(1e-12)
    tables /= tables.sum(axis=-1, keepdims=True)
    prior = [0.2, 0.3, 0.5]
    cpds = [pgm.TableCPD(centre, table=prior)]
    cpds += [pgm.TableCPD(leaf, centre, table=t) for leaf, t in zip(leaves, tables, strict=True)]
    seen = rng.integers(2, size=1000)
    logs = np.log(prior) + np.log(tables[np.arange(1000), :, seen]).sum(axis=0)
    evidence = dict(zip(leaves, map(int, seen), strict=True))
    return pgm.BayesianNetwork(cpds), centre, leaves, evidence, logs, tables


def test_a_hub_of_a_thousand(hub):
    net, centre, leaves, evidence, logs, tables = hub
    graph = pgm.compile(net)
    posterior = pgm.infer(graph, evidence)
    assert logsumexp(logs) < -3000
    assert float(posterior.log_evidence) == pytest.approx(logsumexp(logs), rel=1e-13)
    due = np.exp(logs - logsumexp(logs))
    np.testing.assert_allclose(posterior[centre].values, due, atol=1e-10)
    without = pgm.infer(graph, {leaf: evidence[leaf] for leaf in leaves[1:]})
    np.testing.assert_allclose(
        without[leaves[0]].values, without[centre].values @ tables[0], rtol=1e-12
    )


@pytest.mark.parametrize("schedule", [pgm.Flooding(), pgm.Sequential()])
def test_messages_round_a_hub_of_a_thousand(hub, schedule):
    net, centre, _leaves, evidence, _logs, _ = hub
    posterior = pgm.infer(pgm.compile(net, method=pgm.Bethe()), evidence, schedule=schedule)
    exact = pgm.infer(pgm.compile(net), evidence)
    assert posterior.status.converged
    np.testing.assert_allclose(posterior.log_evidence, exact.log_evidence, rtol=1e-12)
    np.testing.assert_allclose(posterior[centre].values, exact[centre].values, **CLOSE)


def test_a_hub_that_rescales_its_table(kernels):
    """Products of 1,000 messages about 1e-3 underflow unless rescaled on the way."""
    centre = pgm.Discrete("centre", 2)
    leaves = [pgm.Discrete(f"leaf{k}", 2) for k in range(1000)]
    tables = [[[0.001, 0.999], [0.999, 0.001]][:: 1 if k % 2 else -1] for k in range(1000)]
    cpds = [pgm.TableCPD(centre, table=[0.25, 0.75])]
    cpds += [pgm.TableCPD(leaf, centre, table=t) for leaf, t in zip(leaves, tables, strict=True)]
    posterior = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), dict.fromkeys(leaves, 0))
    assert kernels == [SUM_PRODUCT]
    np.testing.assert_allclose(posterior[centre].values, [0.25, 0.75], rtol=1e-10)
    due = 500 * (np.log(0.001) + np.log(0.999))
    assert float(posterior.log_evidence) == pytest.approx(due, rel=1e-13)


def test_impossible_evidence_names_what_contradicts_itself():
    """Two states far from one another, and evidence elsewhere that agrees with all."""
    count = 9
    chain = [pgm.Discrete(f"x{t}", 3) for t in range(count)]
    aside = [pgm.Discrete(f"y{t}", 2) for t in range(count)]
    cpds = [pgm.TableCPD(chain[0], table=[0.2, 0.3, 0.5])]
    cpds += [pgm.TableCPD(b, a, table=np.eye(3)) for a, b in pairwise(chain)]
    cpds += [
        pgm.TableCPD(y, x, table=np.full((3, 2), 0.5)) for x, y in zip(chain, aside, strict=True)
    ]
    graph = pgm.compile(pgm.BayesianNetwork(cpds))
    for first, last in ((0, 3), (2, 8), (1, 7)):
        given = {chain[first]: [0, 0], chain[last]: [0, 1]} | dict.fromkeys(aside, 0)
        given[aside[first]] = pgm.soft([0.3, 0.4])
        for run in (pgm.infer, pgm.most_probable):
            with pytest.raises(
                pgm.EvidenceError, match=r"in run 1\): that for .* contra"
            ) as caught:
                run(graph, given)
            named = str(caught.value).split("contradicts")[0]
            assert f"x{first}" in named
            assert f"x{last}" in named
            assert caught.value.variable in given
            assert caught.value.cluster in range(len(graph))
    found = pgm.infer(graph, {chain[0]: 0, aside[0]: 1, aside[8]: pgm.soft([0.0, 1.0])})
    assert found[chain[8]]["0"] == 1.0


def test_impossible_evidence_says_so():
    graph, a, _b, _c, d = faint(together=False)
    both = {a: "no", d: "yes"}
    assert Enumeration(graph.network, {a: 0, d: 1}).evidence == 0.0
    with pytest.raises(pgm.EvidenceError, match=r"probability zero: .*\(a, d\)") as caught:
        pgm.infer(graph, both)
    assert caught.value.variable == a
    assert a in graph.clusters[caught.value.cluster].scope
    assert f"cluster {caught.value.cluster} over (a, " in str(caught.value)
    with pytest.raises(
        pgm.EvidenceError, match=r"zero: all states of cluster \d over \(a.* impossible given it"
    ) as caught:
        pgm.infer(graph, both, schedule=pgm.Flooding())
    assert a in graph.clusters[caught.value.cluster].scope
    with pytest.raises(pgm.EvidenceError, match=r"probability zero \(first in run 2\)"):
        pgm.infer(graph, {a: [0, 1, 0], d: [0, 1, 1]})
    with pytest.raises(pgm.EvidenceError, match=r"probability zero \(first in run \(1, 0\)\)"):
        pgm.infer(graph, {a: [[0], [0]], d: [[0], [1]]})
    with pytest.raises(pgm.EvidenceError, match=r"probability zero \(first in run 2\)"):
        pgm.infer(graph, {a: [0, 1, 0], d: [0, 1, 1]}, schedule=pgm.Flooding())
    with pytest.raises(pgm.EvidenceError, match=r"probability zero \(first in run 1\)"):
        pgm.most_probable(graph, {a: [0, 1], d: [0, 0]})
    with pytest.raises(pgm.EvidenceError, match="probability zero"):
        pgm.infer(graph, {a: "no", d: pgm.soft([0.0, 1.0])})
