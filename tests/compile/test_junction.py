"""Junction trees of networks of every shape: proven by their check, and by networkx."""

import itertools

import networkx as nx
import numpy as np
import pytest
from dags import chain, continuous, discrete, grid, networks, random_parents, star
from hypothesis import given, settings

import pgm
from pgm.compile import StochasticMinFill

METHODS = {
    "min-fill": pgm.JunctionTree(),
    "weighted min-fill": pgm.JunctionTree(pgm.WeightedMinFill()),
    "nested dissection": pgm.JunctionTree(pgm.NestedDissection(small=1)),
    "as declared": pgm.JunctionTree(lambda network: network.variables),
}
methods = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)


def moral(network):
    """The moral graph, by networkx."""
    directed = nx.DiGraph()
    directed.add_nodes_from(network.variables)
    directed.add_edges_from((p, cpd.child) for cpd in network.cpds for p in cpd.parents)
    return nx.moral_graph(directed)


@methods
@settings(max_examples=80)
@given(networks())
def test_random_networks(method, network):
    graph = pgm.compile(network, method=method)
    graph.check()
    assert graph.network is network
    assert graph.is_tree
    assert nx.is_forest(graph.to_networkx())
    trees = nx.number_connected_components(graph.to_networkx())
    assert trees == nx.number_connected_components(moral(network))
    scopes = [set(cluster.scope) for cluster in graph]
    assert not any(a <= b for a, b in itertools.permutations(scopes, 2))
    filled = nx.Graph()
    filled.add_nodes_from(network.variables)
    for scope in scopes:
        filled.add_edges_from(itertools.combinations(scope, 2))
    assert nx.is_chordal(filled)
    assert set(nx.chordal_graph_cliques(filled)) == set(map(frozenset, scopes))
    assert all(filled.has_edge(*edge) for edge in moral(network).edges)
    for (i, j), sepset in graph.sepsets.items():
        assert set(sepset) == scopes[i] & scopes[j]
    assert sorted(repr(c) for cluster in graph for c in cluster.cpds) == sorted(
        map(repr, network.cpds)
    )


@pytest.mark.parametrize("seed", range(3))
def test_larger_networks(seed):
    parents = random_parents(np.random.default_rng(seed), 200, most=2)
    graph = pgm.compile(continuous(parents))
    graph.check()
    filled = nx.Graph()
    for cluster in graph:
        filled.add_edges_from(itertools.combinations(cluster.scope, 2))
    assert nx.is_chordal(filled)
    assert graph.width == nx.chordal_graph_treewidth(filled)
    heuristic, _ = nx.approximation.treewidth_min_fill_in(moral(graph.network))
    assert graph.width <= heuristic + 5


@given(networks(most=8))
def test_a_moral_graph_that_is_chordal_gets_no_fill(network):
    graph = moral(network)
    if nx.is_chordal(graph):
        found = {frozenset(cluster.scope) for cluster in pgm.compile(network)}
        assert found == set(nx.chordal_graph_cliques(graph))


def test_unconnected_parts_are_trees_of_their_own():
    graph = pgm.compile(discrete([[], [], [1], [], [3], [4]]))
    graph.check()
    assert [len(c) for c in nx.connected_components(graph.to_networkx())] == [1, 1, 2]


@methods
def test_a_variable_with_a_thousand_neighbours(method):
    features = discrete(star(1000))
    # a thousand children, each with another parent of its own
    pairs = continuous([[]] + [[] for _ in range(1000)] + [[0, 1 + k] for k in range(1000)])
    if method is METHODS["as declared"]:
        features = continuous(star(100))
        pairs = continuous([[]] + [[] for _ in range(50)] + [[0, 1 + k] for k in range(50)])
    for network, width in ((features, 1), (pairs, 2)):
        graph = pgm.compile(network, method=method)
        graph.check()
        assert graph.is_tree
        if method is not METHODS["as declared"]:
            assert graph.width == width
            assert len(graph) == 1000


def test_parents_of_the_noise_share_a_cluster_with_the_child():
    a, b, c = pgm.variables("a b c")
    noise = pgm.noise(lambda c: c[..., None] ** 2, given=c)
    network = pgm.BayesianNetwork(
        [pgm.GaussianCPD(a, 0.0, 1.0), pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=noise)]
    )
    assert [set(cluster.scope) for cluster in pgm.compile(network)] == [{a, b, c}]


def test_inputs_are_in_the_clusters_too():
    network = continuous([[], [0], [0, 1], [2]], inputs={0})
    assert network.inputs
    graph = pgm.compile(network)
    graph.check()
    assert {v for cluster in graph for v in cluster.scope} == set(network.variables)


def test_clusters_and_sepsets_do_not_depend_on_the_run():
    for parents in (grid(6), chain(30), star(20)):
        first, second = (pgm.compile(continuous(parents)) for _ in range(2))
        assert [cluster.scope for cluster in first] == [cluster.scope for cluster in second]
        assert first.sepsets == second.sepsets


def test_the_method_says_what_it_does():
    searched = "StochasticMinFill(tries=200, seed=0)"
    assert repr(pgm.JunctionTree()) == f"JunctionTree(order={searched})"
    assert pgm.JunctionTree() == pgm.JunctionTree(order=StochasticMinFill())
