"""Bethe graphs: families, and the variables between them."""

import networkx as nx
import pytest
from dags import chain, continuous, discrete, grid, networks, star
from hypothesis import given, settings

import pgm


@settings(max_examples=120)
@given(networks())
def test_random_networks(network):
    graph = pgm.compile(network, method=pgm.Bethe())
    graph.check()
    families = {frozenset(cpd.scope) for cpd in network.cpds}
    largest = {f for f in families if not any(f < other for other in families)}
    scopes = [frozenset(cluster.scope) for cluster in graph]
    count = len(largest)
    assert set(scopes[:count]) == largest
    shared = [v for v in network.variables if sum(v in family for family in largest) > 1]
    assert scopes[count:] == [frozenset({v}) for v in shared]
    # the factor graph: an edge for each family and each variable of it that others hold too
    due = {(f, frozenset({v})) for f in largest for v in f if v in shared}
    assert {(scopes[i], scopes[j]) for i, j in graph.sepsets} == due
    assert all(set(sepset) == scopes[j] for (_, j), sepset in graph.sepsets.items())


@pytest.mark.parametrize("parents", [chain(30), star(30), [[], [0, 2], [], [1], [1]]])
def test_a_network_without_loops_gives_a_tree(parents):
    assert pgm.compile(continuous(parents), method=pgm.Bethe()).is_tree


def test_a_grid_has_loops_and_small_clusters():
    graph = pgm.compile(discrete(grid(40)), method=pgm.Bethe())
    graph.check()
    assert not graph.is_tree
    assert graph.width == 2
    assert max(graph.sizes) == 8


def test_one_family_is_one_cluster():
    graph = pgm.compile(continuous([[], [0]]), method=pgm.Bethe())
    assert [len(cluster.scope) for cluster in graph] == [2]
    assert not graph.sepsets


def test_a_hub_of_a_thousand():
    graph = pgm.compile(discrete(star(1000)), method=pgm.Bethe())
    assert max(dict(graph.to_networkx().degree).values()) == 1000
    assert nx.is_tree(graph.to_networkx())
