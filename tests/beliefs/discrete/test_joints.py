"""Joints of variables that are far apart in a tree."""

import numpy as np
import pytest
from discrete.enumeration import Enumeration

import pgm
from pgm.inference.query import question
from pgm.schedules import limits


def table(rng, child, *given):
    shape = tuple(v.size for v in given)
    return pgm.TableCPD(child, given, table=rng.dirichlet(np.ones(child.size), size=shape))


def test_what_no_cluster_further_on_has_is_summed_out_first(monkeypatch):
    rng = np.random.default_rng(0)
    x = [pgm.Discrete(f"x{k}", 2) for k in range(5)]
    cpds = [table(rng, x[0])]
    for k in range(4):
        beside = [pgm.Discrete(f"{name}{k}", 3) for name in "ab"]
        cpds += [*(table(rng, v) for v in beside), table(rng, x[k + 1], x[k], *beside)]
    net = pgm.BayesianNetwork(cpds)
    evidence = {pgm.Discrete("a1", 3): 2, pgm.Discrete("b3", 3): 0}
    posterior = pgm.infer(pgm.compile(net), evidence)
    assert min(posterior.graph.sizes) == 36
    posterior.belief(0)  # the tables are there
    with monkeypatch.context() as patched:
        patched.setattr(limits, "LIMIT", 8)  # of two variables joined and one asked for
        found = posterior.joint(x[0], x[4]).values
    due = Enumeration(net, evidence).marginal(x[0], x[4])
    np.testing.assert_allclose(found, due, rtol=0.0, atol=1e-14)


def test_a_query_sums_out_where_the_tree_needs_too_large_tables(monkeypatch):
    """Without c, which is barren, a and b have nothing to do with each other."""
    rng = np.random.default_rng(1)
    a, b, p, q, c = (pgm.Discrete(n, k) for n, k in zip("abpqc", (50, 50, 10, 10, 2), strict=True))
    cpds = [table(rng, a), table(rng, p, a), table(rng, b), table(rng, q, b), table(rng, c, p, q)]
    graph = pgm.compile(pgm.BayesianNetwork(cpds))
    monkeypatch.setattr(question, "VARIABLE", 10**6)  # the tree is taken to be the cheaper way
    due = np.outer(cpds[0].table, cpds[2].table)
    np.testing.assert_allclose(pgm.query(graph, (a, b)).values, due, rtol=0.0, atol=1e-15)
    monkeypatch.setattr(limits, "LIMIT", 2_700)
    with pytest.raises(pgm.GraphError, match=r"runs, or by pgm\.query, which may need less"):
        pgm.infer(graph, {}).joint(a, b)
    np.testing.assert_allclose(pgm.query(graph, (a, b)).values, due, rtol=0.0, atol=1e-15)
