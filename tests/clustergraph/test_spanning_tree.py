"""The tree that joins clusters where no sepsets are given, against all spanning trees."""

import itertools
import math

import networkx as nx
import numpy as np
import pytest
from dags import continuous, networks, star
from hypothesis import given, settings
from hypothesis import strategies as st

import pgm
from pgm.clustergraph.cluster import check_running_intersection, is_forest, spanning_tree

VARIABLES = pgm.variables("a b c d e")


def overlaps(scopes, weight=len):
    graph = nx.Graph()
    graph.add_nodes_from(range(len(scopes)))
    for i, j in itertools.combinations(range(len(scopes)), 2):
        shared = set(scopes[i]) & set(scopes[j])
        if shared:
            graph.add_edge(i, j, weight=weight(shared))
    return graph


def carries(scopes, edges):
    """Whether the clusters of each variable are connected by edges between them."""
    tree = nx.Graph()
    tree.add_nodes_from(range(len(scopes)))
    tree.add_edges_from(edges)
    return all(
        nx.is_connected(tree.subgraph(k for k, scope in enumerate(scopes) if variable in scope))
        for variable in set().union(*scopes)
    )


@st.composite
def covers(draw):
    """Draw the scopes of some clusters."""
    subsets = st.sets(st.sampled_from(VARIABLES), min_size=1, max_size=4)
    found = draw(st.lists(subsets, min_size=1, max_size=5))
    return [tuple(sorted(scope, key=VARIABLES.index)) for scope in found]


@settings(max_examples=150)
@given(covers())
def test_a_tree_is_found_if_and_only_if_there_is_one(scopes):
    graph = overlaps(scopes)
    possible = any(
        carries(scopes, edges)
        for edges in itertools.combinations(
            graph.edges, len(graph) - nx.number_connected_components(graph)
        )
    )
    if not possible:
        with pytest.raises(pgm.GraphError, match="no tree of these clusters") as caught:
            spanning_tree(scopes)
        assert caught.value.variable in VARIABLES
        assert caught.value.variable not in scopes[caught.value.cluster]
        return
    found = spanning_tree(scopes)
    check_running_intersection(scopes, found)
    assert is_forest(found)
    for (i, j), sepset in found.items():
        assert i < j
        assert set(sepset) == set(scopes[i]) & set(scopes[j]) != set()
    # one of the maximum-weight spanning trees of the textbooks, and the weight decides
    largest = nx.maximum_spanning_tree(graph)
    assert sum(map(len, found.values())) == largest.size(weight="weight")
    assert carries(scopes, largest.edges)


@given(networks())
def test_the_clusters_of_a_junction_tree_are_joined_again(network):
    compiled = pgm.compile(network)
    again = pgm.ClusterGraph(network, [cluster.scope for cluster in compiled])
    again.check()
    assert again.is_tree
    weights = [sum(map(len, graph.sepsets.values())) for graph in (compiled, again)]
    assert weights[0] == weights[1]


def test_weighing_sepsets_by_components_or_table_entries_would_do_as_well():
    rng = np.random.default_rng(0)
    sizes = dict(zip(VARIABLES, (2, 3, 2, 9, 9), strict=True))
    found = 0
    for _ in range(500):
        scopes = [
            tuple(v for v in VARIABLES if rng.random() < 0.5) or VARIABLES[:1] for _ in range(5)
        ]
        try:
            due = sum(map(len, spanning_tree(scopes).values()))
        except pgm.GraphError:
            continue
        found += 1
        for weight in (sum, math.prod):
            graph = overlaps(scopes, lambda shared, weight=weight: weight(map(sizes.get, shared)))
            tree = nx.maximum_spanning_tree(graph)
            assert carries(scopes, tree.edges)
            assert sum(len({*scopes[i]} & {*scopes[j]}) for i, j in tree.edges) == due
    assert found > 50


def test_a_variable_in_thousands_of_clusters():
    network = continuous(star(5000))
    hub, *rest = network.variables
    graph = pgm.ClusterGraph(network, [{hub, leaf} for leaf in rest])
    assert graph.is_tree
    assert len(graph.sepsets) == 4999


def test_clusters_that_share_nothing_are_not_joined():
    a, b, c, d = pgm.variables("a b c d")
    assert spanning_tree([(a, b), (c,), (b, d)]) == {(0, 2): (b,)}
    assert spanning_tree([]) == {}
