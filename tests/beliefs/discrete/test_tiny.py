"""Tiny networks are summed from their joint, larger ones by messages: both find the same."""

from itertools import pairwise

import numpy as np
import pytest
from discrete.enumeration import Enumeration, network

import pgm
from models.discrete import asia, cancer, dyspnoea, either, smoking, xray
from pgm.beliefs.discrete import tree_plan
from pgm.beliefs.discrete.tree_plan import plan_for


def summed(graph):
    return plan_for(graph, 1, 2**22).enumeration is not None


@pytest.fixture
def by_messages(monkeypatch):
    """Compile so that no joint is made."""

    def compiled(net):
        graph = pgm.compile(net)
        with monkeypatch.context() as patched:
            patched.setattr(tree_plan, "TINY", 0)
            assert not summed(graph)
        return graph

    return compiled


@pytest.mark.parametrize("seed", range(12))
def test_both_find_the_same(seed, by_messages):
    net = network(seed, count=5)
    rng = np.random.default_rng(seed)
    drawn = net.sample(rng=rng)
    evidence = {v: int(drawn[v]) for v in net.variables if rng.random() < 0.4}
    graph, other = pgm.compile(net), by_messages(net)
    plan = plan_for(graph, 1, 2**22)
    cells = np.prod([v.size for v in net.variables])
    tiny = cells * (plan.storage.entries + plan.columns) <= tree_plan.TINY
    assert summed(graph) == (tiny and len(graph.sepsets) == len(graph) - 1)
    one, two = pgm.infer(graph, evidence), pgm.infer(other, evidence)
    truth = Enumeration(net, evidence)
    np.testing.assert_allclose(one.log_evidence, np.log(truth.evidence), rtol=1e-13, atol=1e-13)
    hidden = [v for v in net.variables if v not in evidence]
    for variable in hidden:
        np.testing.assert_allclose(one[variable].values, truth.marginal(variable), atol=1e-14)
    if hidden:
        np.testing.assert_allclose(
            one.joint(*hidden).values, two.joint(*hidden).values, rtol=0.0, atol=1e-14
        )
    for k in range(len(graph)):
        mine, due = one.belief(k), two.belief(k)
        np.testing.assert_allclose(mine.log_total, due.log_total, rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(mine.probabilities, due.probabilities, atol=1e-14)


def test_several_trees_and_larger_networks_are_left_to_messages():
    a, b, c = (pgm.Discrete(name, 2) for name in "abc")
    apart = [pgm.TableCPD(a, table=[0.3, 0.7]), pgm.TableCPD(b, table=[0.1, 0.9])]
    assert not summed(pgm.compile(pgm.BayesianNetwork(apart)))
    joined = [*apart, pgm.TableCPD(c, (a, b), table=np.full((2, 2, 2), 0.5))]
    assert summed(pgm.compile(pgm.BayesianNetwork(joined)))
    assert summed(pgm.compile(asia()))
    assert not summed(pgm.compile(network(0, count=12)))


def test_products_that_are_too_small_for_a_number_are_left_to_messages():
    names = [pgm.Discrete(f"v{k}", 2) for k in range(4)]
    rare = [[1.0, 1e-150], [1.0, 1e-150]]
    cpds = [pgm.TableCPD(names[0], table=[1.0, 1e-150])]
    cpds += [pgm.TableCPD(v, before, table=rare) for before, v in pairwise(names)]
    graph = pgm.compile(pgm.BayesianNetwork(cpds))
    assert not summed(graph)
    posterior = pgm.infer(graph, dict.fromkeys(names[1:], 1))
    np.testing.assert_allclose(posterior.log_evidence, 3 * np.log(1e-150), rtol=1e-14)


def test_evidence_of_one_run_with_an_axis_and_weights():
    graph = pgm.compile(asia())
    plain = pgm.infer(graph, {xray: "yes"})
    weighed = pgm.infer(graph, {xray: pgm.soft([0.0, 1.0])})
    lone = pgm.infer(graph, {xray: [1], dyspnoea: [-1]})
    np.testing.assert_allclose(weighed[smoking].values, plain[smoking].values, atol=1e-15)
    np.testing.assert_allclose(lone[smoking].values[0], plain[smoking].values, atol=1e-15)
    assert lone.log_evidence.shape == (1,)


def test_impossible_evidence_is_named():
    with pytest.raises(pgm.EvidenceError, match=r"probability zero.*\(cancer, either\)"):
        pgm.infer(pgm.compile(asia()), {cancer: "yes", either: "no"})
