"""What a discrete posterior and its engine refuse, by name."""

import itertools
import resource
import time

import numpy as np
import pytest

import pgm
from models.discrete import asia, either, sprinkler, sprinkling, tuberculosis, visit, wet, xray
from pgm.inference import limits


def test_observed_and_unknown_variables():
    stranger = pgm.Discrete("stranger", 2)
    for schedule in (None, pgm.Flooding()):
        posterior = pgm.infer(pgm.compile(asia()), {xray: "yes"}, schedule=schedule)
        with pytest.raises(pgm.EvidenceError, match="xray is observed: its value is its evidence"):
            posterior[xray]
        with pytest.raises(pgm.EvidenceError, match="xray is observed") as caught:
            posterior.joint(visit, xray)
        assert caught.value.variable == xray
        with pytest.raises(pgm.EvidenceError, match=r"stranger is not in the network; .*dyspnoea"):
            posterior[stranger]
        with pytest.raises(pgm.EvidenceError, match="by variable, not by 'visit'"):
            posterior["visit"]
        with pytest.raises(pgm.EvidenceError, match="one or more variables"):
            posterior.joint()
    batch = pgm.infer(pgm.compile(asia()), {xray: ["yes", "no"]})
    with pytest.raises(pgm.EvidenceError, match="xray is observed"):
        batch[xray]
    soft = pgm.infer(pgm.compile(asia()), {xray: pgm.soft([0.1, 0.9])})
    assert soft[xray].values[1] > 0.1


def test_joints_of_loopy_graphs_are_within_a_cluster():
    posterior = pgm.infer(pgm.compile(sprinkler(), method=pgm.Bethe()), {}, schedule=pgm.Flooding())
    assert posterior.joint(sprinkling, wet).values.shape == (2, 2)
    net = asia()
    posterior = pgm.infer(pgm.compile(net, method=pgm.Bethe()), {}, schedule=pgm.Flooding())
    with pytest.raises(pgm.GraphError, match=r"no cluster holds all of \(visit, either\)"):
        posterior.joint(visit, either)


def test_clusters_that_are_not_joined():
    posterior = pgm.infer(pgm.compile(asia()), {})
    apart = next(
        (i, j)
        for i in range(len(posterior.graph))
        for j in range(len(posterior.graph))
        if i != j and j not in posterior.graph.neighbours(i)
    )
    with pytest.raises(pgm.GraphError, match=f"clusters {apart[0]} and {apart[1]} are not joined"):
        posterior.message(*apart)
    with pytest.raises(pgm.GraphError, match="no cluster 99"):
        posterior.belief(99)


def forty():
    """A network of forty binary variables, and one cluster of them all."""
    variables = [pgm.Discrete(f"b{k}", 2) for k in range(40)]
    cpds = [pgm.TableCPD(v, table=[0.5, 0.5]) for v in variables]
    net = pgm.BayesianNetwork(cpds)
    return pgm.ClusterGraph(net, [set(variables)]), variables


def test_a_cluster_that_is_too_large():
    graph, _ = forty()
    for run in (
        lambda: pgm.infer(graph, {}),
        lambda: pgm.infer(graph, {}, schedule=pgm.Flooding()),
        lambda: pgm.most_probable(graph, {}),
    ):
        with pytest.raises(pgm.GraphError) as caught:
            run()
        for part in (
            "cluster 0 over (b0, b1, b2, b3, b4, b5, b6, b7, ...), 40 variables, has 10^12.0 "
            "entries, 8.19e+03 GiB",
            "pgm.Bethe()",
            "pgm.Flooding()",
        ):
            assert part in str(caught.value)
        assert caught.value.cluster == 0


def test_a_grid_is_refused_before_anything_is_made():
    side = 40
    cell = {(i, j): pgm.Discrete(f"c{i}_{j}", 2) for i in range(side) for j in range(side)}
    cpds = []
    for (i, j), child in cell.items():
        given = tuple(cell[at] for at in ((i - 1, j), (i, j - 1)) if at in cell)
        cpds.append(pgm.TableCPD(child, given, table=np.full([2] * (len(given) + 1), 0.5)))
    net = pgm.BayesianNetwork(cpds)
    clusters = [
        {cell[i, k] for k in range(j, side)} | {cell[i + 1, k] for k in range(j + 1)}
        for i in range(side - 1)
        for j in range(side)
    ]
    graph = pgm.ClusterGraph(net, clusters, _chain(clusters))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.perf_counter()
    with pytest.raises(pgm.GraphError, match=r"too large: cluster \d+ over \(.*41 variables"):
        pgm.infer(graph, {})
    assert time.perf_counter() - start < 5.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500 * 1024


def _chain(clusters):
    pairs = enumerate(itertools.pairwise(clusters))
    return {(k, k + 1): a & b for k, (a, b) in pairs}


def test_joints_that_are_too_large(monkeypatch):
    posterior = pgm.infer(pgm.compile(asia()), {})
    monkeypatch.setattr(limits, "LIMIT", 2**4)
    with pytest.raises(pgm.GraphError, match=r"entries, where 16 are the limit; ask for fewer"):
        posterior.joint(*asia().variables)


def test_runs_that_are_too_many_for_messages_that_go_round(monkeypatch):
    graph = pgm.compile(asia(), method=pgm.Bethe())
    monkeypatch.setattr(limits, "LIMIT", 2**10)
    with pytest.raises(pgm.GraphError, match=r"for 100 runs, where 1024 are the limit; give"):
        pgm.infer(graph, {xray: np.ones(100, dtype=int)}, schedule=pgm.Flooding())
    trees = pgm.infer(pgm.compile(asia()), {xray: np.ones(100, dtype=int)})
    assert trees[tuberculosis].values.shape == (100, 2)
