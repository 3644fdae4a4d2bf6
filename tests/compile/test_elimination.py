"""Elimination against counting afresh, and clique trees against networkx."""

import itertools

import networkx as nx
import numpy as np
import pytest
from dags import continuous, grid, networks, random_parents, star
from hypothesis import given, settings
from hypothesis import strategies as st

import pgm
from pgm.compile.elimination import Filling, clique_tree, min_fill, moral


def as_networkx(adjacent):
    graph = nx.Graph()
    graph.add_nodes_from(range(len(adjacent)))
    graph.add_edges_from((v, u) for v, near in enumerate(adjacent) for u in near)
    return graph


@st.composite
def graphs(draw, most=9):
    """Draw a graph and the weights of its vertices."""
    count = draw(st.integers(1, most))
    pairs = list(itertools.combinations(range(count), 2))
    chosen = draw(st.sets(st.sampled_from(pairs))) if pairs else set()
    adjacent = [set() for _ in range(count)]
    for a, b in chosen:
        adjacent[a].add(b)
        adjacent[b].add(a)
    return adjacent, draw(st.lists(st.integers(1, 5), min_size=count, max_size=count))


def counted(graph, weights, vertex):
    """The fill of a vertex, by looking at every pair of its neighbours."""
    pairs = itertools.combinations(graph[vertex], 2)
    return sum(weights[a] * weights[b] for a, b in pairs if not graph.has_edge(a, b))


def eliminate(graph, vertex):
    graph.add_edges_from(itertools.combinations(list(graph[vertex]), 2))
    graph.remove_node(vertex)


def filled(adjacent, order):
    """The graph with the fill of an elimination order, by eliminating on a copy."""
    result, left = as_networkx(adjacent), as_networkx(adjacent)
    for vertex in order:
        result.add_edges_from(itertools.combinations(list(left[vertex]), 2))
        eliminate(left, vertex)
    return result


@given(networks())
def test_the_moral_graph_is_networkx_own(network):
    directed = nx.DiGraph()
    directed.add_nodes_from(network.variables)
    directed.add_edges_from((p, cpd.child) for cpd in network.cpds for p in cpd.parents)
    due = nx.moral_graph(directed)
    variables = network.variables
    for vertex, near in enumerate(moral(network)):
        assert {variables[k] for k in near} == set(due[variables[vertex]])


def test_parents_of_the_noise_are_family():
    a, b, c = pgm.variables("a b c")
    noisy = pgm.LinearGaussianCPD(b, {a: 1.0}, cov=pgm.noise(lambda c: c[..., None], given=c))
    network = pgm.BayesianNetwork([pgm.GaussianCPD(a, 0.0, 1.0), noisy])
    assert network.inputs == (c,)
    assert moral(network) == [{1, 2}, {0, 2}, {0, 1}]


@given(graphs(), st.randoms(use_true_random=False))
def test_fill_is_what_counting_afresh_gives_at_every_step(case, random):
    adjacent, weights = case
    fast, slow = Filling(adjacent, weights), as_networkx(adjacent)
    order = list(slow)
    random.shuffle(order)
    for vertex in order:
        before = {v: fast.fill[v] for v in slow}
        assert before == {v: counted(slow, weights, v) for v in slow}
        touched = fast.eliminate(vertex)
        eliminate(slow, vertex)
        assert {v: fast.adjacent[v] for v in slow} == {v: set(slow[v]) for v in slow}
        changed = {v for v in slow if fast.fill[v] != before[v]}
        assert changed <= touched <= set(slow)


@given(graphs(), st.booleans())
def test_min_fill_takes_the_first_vertex_of_least_fill(case, staged):
    adjacent, weights = case
    stages = [vertex % 3 for vertex in range(len(adjacent))] if staged else None
    order = min_fill(adjacent, weights, stages)
    left = as_networkx(adjacent)
    assert sorted(order) == sorted(left)
    for vertex in order:
        costs = {v: (stages[v] if stages else 0, counted(left, weights, v), v) for v in left}
        assert vertex == min(left, key=costs.__getitem__)
        eliminate(left, vertex)


def test_the_graph_given_is_left_as_it_was():
    adjacent = moral(continuous(grid(4)))
    before = [set(near) for near in adjacent]
    clique_tree(adjacent, min_fill(adjacent, [1] * 16))
    assert adjacent == before


@settings(max_examples=120)
@given(graphs(), st.randoms(use_true_random=False))
def test_clique_trees_against_networkx(case, random):
    adjacent, _ = case
    order = list(range(len(adjacent)))
    random.shuffle(order)
    result = clique_tree(adjacent, order)
    chordal = filled(adjacent, order)
    assert nx.is_chordal(chordal)
    cliques = [frozenset(clique) for clique in result.cliques]
    assert len(set(cliques)) == len(cliques)
    assert set(cliques) == set(nx.chordal_graph_cliques(chordal))
    for (i, j), shared in result.sepsets.items():
        assert i < j
        assert shared == cliques[i] & cliques[j] != set()
    joined = nx.Graph()
    joined.add_nodes_from(range(len(cliques)))
    joined.add_edges_from(result.sepsets)
    assert nx.is_forest(joined)
    pairs = itertools.combinations(range(len(cliques)), 2)
    overlaps = nx.Graph()
    overlaps.add_weighted_edges_from(
        (i, j, len(cliques[i] & cliques[j])) for i, j in pairs if cliques[i] & cliques[j]
    )
    largest = nx.maximum_spanning_tree(overlaps).size(weight="weight")
    assert sum(map(len, result.sepsets.values())) == largest


@pytest.mark.parametrize("seed", range(5))
def test_larger_graphs_against_networkx(seed):
    adjacent = moral(continuous(random_parents(np.random.default_rng(seed), 80, most=2)))
    order = min_fill(adjacent, [1] * len(adjacent))
    chordal = filled(adjacent, order)
    cliques = clique_tree(adjacent, order).cliques
    assert set(map(frozenset, cliques)) == set(nx.chordal_graph_cliques(chordal))
    # the networkx heuristic is the same but for ties
    width, _ = nx.approximation.treewidth_min_fill_in(as_networkx(adjacent))
    assert max(map(len, cliques)) - 1 <= width + 3


def test_a_chordal_graph_gets_no_fill():
    adjacent = moral(continuous(star(1000)))
    tree = clique_tree(adjacent, min_fill(adjacent, [1] * len(adjacent)))
    assert all(0 in clique and len(clique) == 2 for clique in tree.cliques)
    assert len(tree.cliques) == 1000


def test_a_family_of_hundreds_is_one_clique():
    adjacent = moral(continuous([[] for _ in range(300)] + [list(range(300))]))
    tree = clique_tree(adjacent, min_fill(adjacent, [1] * len(adjacent)))
    assert tree.cliques == [set(range(301))]
