"""What a discrete posterior and its engine refuse, by name."""

import itertools
import resource
import time

import numpy as np
import pytest

import pgm
from models.discrete import asia, either, sprinkler, sprinkling, tuberculosis, visit, wet, xray
from pgm.schedules import limits


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
            "together they take 8.19e+03 GiB, where 1 GiB is the limit, and inference takes about "
            "five times as much memory",
            "cluster 0 over (b0, b1, b2, b3, b4, b5, b6, b7, ...), 40 variables, takes 8.19e+03 "
            "GiB, 10^12.0 entries",
            "pgm.JunctionTree(pgm.StochasticMinFill(tries=2000))",
            "pgm.LTRIP()",
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
    with pytest.raises(pgm.GraphError, match=r"cluster \d+ over \(.*41 variables, takes"):
        pgm.infer(graph, {})
    assert time.perf_counter() - start < 5.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500 * 1024


def _chain(clusters):
    pairs = enumerate(itertools.pairwise(clusters))
    return {(k, k + 1): a & b for k, (a, b) in pairs}


def test_joints_that_are_too_large(monkeypatch):
    posterior = pgm.infer(pgm.compile(asia()), {})
    posterior.belief(0)  # the tables are there
    monkeypatch.setattr(limits, "LIMIT", 2**4)
    with pytest.raises(
        pgm.GraphError, match=r"a table that is too large: over \(.*\. Ask for fewer"
    ):
        posterior.joint(*asia().variables)


def test_many_clusters_that_are_too_large_together(monkeypatch):
    monkeypatch.setattr(limits, "LIMIT", 20)
    with pytest.raises(pgm.GraphError, match=r"6 clusters are too large: together they take"):
        pgm.infer(pgm.compile(asia()), {})
    graph = pgm.compile(asia(), method=pgm.Bethe())
    with pytest.raises(pgm.GraphError, match=r"takes .* 24 entries\. Give it smaller clusters$"):
        pgm.infer(graph, {}, schedule=pgm.Flooding())


def test_runs_that_are_too_many_for_messages_that_go_round(monkeypatch):
    graph = pgm.compile(asia(), method=pgm.Bethe())
    monkeypatch.setattr(limits, "LIMIT", 2**10)
    with pytest.raises(
        pgm.GraphError, match=r"messages round the graph would take .* ask with fewer runs at once"
    ):
        pgm.infer(graph, {xray: np.ones(100, dtype=int)}, schedule=pgm.Flooding())
    trees = pgm.infer(pgm.compile(asia()), {xray: np.ones(100, dtype=int)})
    assert trees[tuberculosis].values.shape == (100, 2)


@pytest.mark.parametrize("kept", [0, 2**24])
def test_answers_over_all_runs_that_are_too_large(kept, monkeypatch):
    graph, runs = pgm.compile(asia()), np.ones(100, dtype=int)
    monkeypatch.setattr(limits, "KEPT", kept)
    posterior = pgm.infer(graph, {xray: runs})
    monkeypatch.setattr(limits, "LIMIT", 350)
    ask = r" would take .* for 100 runs, where .* is the limit; ask with fewer runs at once, {} at"
    edge = next(edge for edge, sepset in graph.sepsets.items() if len(sepset) == 2)
    for call, what in (
        (lambda: posterior.joint(visit, tuberculosis), r"the joint over \(visit, tuberculosis\)"),
        (lambda: posterior.message(*edge), r"the message over \(.*\)"),
        (lambda: posterior.belief(edge[0]), r"the belief over \(.*\)"),
    ):
        with pytest.raises(pgm.GraphError, match=what + ask.format(r"\d+")):
            call()
    assert posterior.joint(visit).values.shape == (100, 2)
    with pytest.raises(pgm.GraphError, match="the states of all variables" + ask.format(43)):
        pgm.most_probable(graph, {xray: runs})
    if not kept:
        different = pgm.soft(np.linspace(0.1, 1.0, 200).reshape(100, 2))
        with pytest.raises(pgm.GraphError, match="the marginals of all var.*" + ask.format(21)):
            pgm.infer(graph, {xray: different})


def test_clusters_of_more_variables_than_arrays_have_axes():
    single = [pgm.Discrete(f"s{k}", 1) for k in range(70)]
    a = pgm.Discrete("a", 2)
    cpds = [pgm.TableCPD(v, table=[1.0]) for v in single] + [pgm.TableCPD(a, table=[0.3, 0.7])]
    graph = pgm.ClusterGraph(pgm.BayesianNetwork(cpds), [{a, *single}])
    for run in (
        lambda: pgm.infer(graph, {}),
        lambda: pgm.infer(graph, {}, schedule=pgm.Flooding()),
        lambda: pgm.most_probable(graph, {}),
    ):
        with pytest.raises(pgm.GraphError, match=r"71 in all\)\) is a table of too many") as caught:
            run()
        assert caught.value.cluster == 0
        assert "for 60 variables; leave variables of one state, (s0, " in str(caught.value)
    narrow = pgm.compile(pgm.BayesianNetwork(cpds))
    posterior = pgm.infer(narrow, {})
    assert posterior[a].values.tolist() == [0.3, 0.7]
    with pytest.raises(pgm.GraphError) as caught:
        posterior.joint(*single[:61])
    assert str(caught.value) == (
        "the joint over (s0, s1, s2, s3, s4, s5, s6, s7, ... (61 in all)) is a table of too many "
        "axes: NumPy's arrays have them for 60 variables; ask for fewer at once, or leave "
        "variables of one state, (s0, s1, s2, s3, s4, s5, s6, s7, ... (61 in all)), out of the "
        "network"
    )
