"""Layered trees: a maximum spanning tree of the families for each variable."""

import itertools

import networkx as nx
import numpy as np
import pytest
from compile.drawn import gaussians, hidden, observed, polytree, tables, windows
from dags import chain, continuous, discrete, grid, networks, random_parents, star
from discrete.enumeration import Enumeration
from gaussian.loops import solve
from hypothesis import given, settings
from numpy.testing import assert_allclose

import pgm

SCHEDULES = [pgm.Flooding(), pgm.Sequential(), pgm.Residual()]


def overlaps(graph):
    """Make the graph of all clusters that share variables, by how many they share."""
    found = nx.Graph()
    found.add_nodes_from(range(len(graph)))
    for a, b in itertools.combinations(graph, 2):
        if shared := len(set(a.scope) & set(b.scope)):
            found.add_edge(a.index, b.index, weight=shared)
    return found


def weight(graph):
    """Sum the weights of the edges of a graph."""
    return sum(shared for _, _, shared in graph.edges.data("weight"))


@settings(max_examples=60)
@given(networks())
def test_each_variable_has_a_spanning_tree_of_the_greatest_weight(network):
    graph = pgm.compile(network, method=pgm.LTRIP())
    graph.check()
    families = {frozenset(cpd.scope) for cpd in network.cpds}
    assert sorted(map(sorted, (map(repr, c.scope) for c in graph))) == sorted(
        sorted(map(repr, f)) for f in families if not any(f < other for other in families)
    )
    everything = overlaps(graph)
    for variable in network.variables:
        holders = [cluster.index for cluster in graph if variable in cluster.scope]
        layer = [edge for edge, sepset in graph.sepsets.items() if variable in sepset]
        tree = everything.edge_subgraph(layer)
        assert len(layer) == len(holders) - 1
        assert weight(tree) == weight(nx.maximum_spanning_tree(everything.subgraph(holders)))


@settings(max_examples=60)
@given(networks(most=7))
def test_families_that_a_junction_tree_joins_are_joined_to_one(network):
    graph = pgm.compile(network, method=pgm.LTRIP())
    # A tree has running intersection just if it carries each variable of k clusters k - 1 times.
    due = sum(len(cluster.scope) for cluster in graph) - len(network.variables)
    if weight(nx.maximum_spanning_tree(overlaps(graph))) == due:
        assert graph.is_tree
    for (i, j), sepset in graph.sepsets.items():
        both = set(graph.clusters[i].scope) & set(graph.clusters[j].scope)
        assert set(sepset) <= both
        assert not graph.is_tree or set(sepset) == both


@pytest.mark.parametrize("last", range(2, 5))
def test_ties_are_broken_alike_for_all_variables(last):
    """Three families share {x0, x1}; that x1 alone leads on from one of them makes no loop."""
    parents = [[], [0], [0, 1], [0, 1], [0, 1], [1, last]]
    graph = pgm.compile(discrete(parents), method=pgm.LTRIP())
    x = graph.network.variables
    assert graph.is_tree
    assert sorted(map(len, graph.sepsets.values())) == [2, 2, 2]
    assert {x[1], x[last]} in map(set, graph.sepsets.values())


def test_sepsets_hold_what_families_share():
    """A second-order chain: its families in a row, each joined to the next by two variables."""
    parents = [list(range(max(0, k - 2), k)) for k in range(8)]
    graph = pgm.compile(continuous(parents), method=pgm.LTRIP())
    assert graph.is_tree
    assert [len(sepset) for sepset in graph.sepsets.values()] == [2] * 5
    assert not pgm.compile(graph.network, method=pgm.Bethe()).is_tree


@pytest.mark.parametrize("seed", range(6))
def test_discrete_networks_without_loops_are_exact(seed):
    rng = np.random.default_rng(seed)
    network = tables(rng, polytree(rng, 9))
    evidence = observed(rng, network, 2)
    graph = pgm.compile(network, method=pgm.LTRIP())
    assert graph.is_tree
    posterior, due = pgm.infer(graph, evidence), Enumeration(network, evidence)
    for variable in hidden(network, evidence):
        assert_allclose(
            posterior[variable].probabilities, due.marginal(variable), rtol=1e-12, atol=1e-15
        )
    assert_allclose(posterior.log_evidence, np.log(due.evidence), rtol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_gaussian_networks_without_loops_are_exact(seed):
    rng = np.random.default_rng(seed)
    network = gaussians(rng, polytree(rng, 20))
    evidence = observed(rng, network, 4)
    graph = pgm.compile(network, method=pgm.LTRIP())
    assert graph.is_tree
    posterior, due = pgm.infer(graph, evidence), solve(network, evidence)
    for variable in due.places:
        assert_allclose(
            posterior[variable].mean, np.ravel(due.means(variable)), rtol=1e-9, atol=1e-9
        )
        assert_allclose(posterior[variable].cov, due.cov(variable), rtol=1e-9)


@pytest.mark.parametrize("schedule", SCHEDULES, ids=lambda s: type(s).__name__)
def test_means_around_loops_are_exact_where_messages_converge(schedule):
    rng = np.random.default_rng(1)
    network = gaussians(rng, windows(rng, 20), gain=0.4)
    evidence = observed(rng, network, 4)
    graph = pgm.compile(network, method=pgm.LTRIP())
    assert not graph.is_tree
    assert max(map(len, graph.sepsets.values())) > 1
    posterior, due = pgm.infer(graph, evidence, schedule=schedule), solve(network, evidence)
    assert posterior.status.converged
    for variable in due.places:
        error = posterior[variable].mean - np.ravel(due.means(variable))
        assert np.abs(error / due.std(variable)).max() < 1e-7


@pytest.mark.parametrize("schedule", SCHEDULES, ids=lambda s: type(s).__name__)
def test_where_families_share_one_variable_beliefs_are_those_of_the_bethe_graph(schedule):
    rng = np.random.default_rng(2)
    network = tables(rng, grid(4))
    evidence = observed(rng, network, 2)
    layered, bethe = (
        pgm.infer(pgm.compile(network, method=method), evidence, schedule=schedule)
        for method in (pgm.LTRIP(), pgm.Bethe())
    )
    assert layered.status.converged
    assert bethe.status.converged
    for variable in hidden(network, evidence):
        ours, theirs = layered[variable].probabilities, bethe[variable].probabilities
        assert_allclose(ours, theirs, atol=1e-7)
    assert_allclose(layered.log_evidence, bethe.log_evidence, atol=1e-7)


def test_sepsets_of_two_variables_make_beliefs_better():
    """Mean error over ten networks whose families overlap: half that of the Bethe graph."""
    errors = {pgm.LTRIP(): 0.0, pgm.Bethe(): 0.0}
    for seed in range(10):
        rng = np.random.default_rng(seed)
        network = tables(rng, windows(rng, 12, reach=5), most=2)
        evidence = observed(rng, network, 2)
        due = Enumeration(network, evidence)
        for method in errors:
            graph = pgm.compile(network, method=method)
            posterior = pgm.infer(graph, evidence, schedule=pgm.Flooding(damping=0.3))
            errors[method] += sum(
                np.abs(posterior[v].probabilities - due.marginal(v)).max()
                for v in hidden(network, evidence)
            )
    assert errors[pgm.LTRIP()] < 0.5 * errors[pgm.Bethe()]


def test_a_hub_of_a_thousand():
    graph = pgm.compile(discrete(star(1000)), method=pgm.LTRIP())
    assert graph.is_tree
    assert len(graph.sepsets) == 999


def test_parts_that_are_not_connected_and_single_variables():
    graph = pgm.compile(discrete([[], [], [1], [], [3], [4]]), method=pgm.LTRIP())
    graph.check()
    assert [len(c) for c in nx.connected_components(graph.to_networkx())] == [1, 1, 2]
    assert len(pgm.compile(continuous(chain(1)), method=pgm.LTRIP())) == 1


def test_clusters_and_sepsets_do_not_depend_on_the_run():
    for parents in (grid(6), random_parents(np.random.default_rng(0), 40)):
        first, second = (pgm.compile(continuous(parents), method=pgm.LTRIP()) for _ in range(2))
        assert [cluster.scope for cluster in first] == [cluster.scope for cluster in second]
        assert first.sepsets == second.sepsets


def test_the_method_is_a_value():
    assert repr(pgm.LTRIP()) == "LTRIP()"
    assert {pgm.LTRIP(), pgm.LTRIP()} == {pgm.LTRIP()}
