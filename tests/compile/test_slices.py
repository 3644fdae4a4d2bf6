"""The chain of clusters of a dynamic network, against the design and the two properties."""

import itertools

import networkx as nx
import numpy as np
import pytest
from templates import MODELS, A, M, X, start

import pgm

models = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


@models
@pytest.mark.parametrize("steps", [0, 1, 5, 100])
def test_every_compiled_graph_passes_its_check(model, steps):
    graph = pgm.compile(model, steps)
    graph.check()
    assert len(graph) == steps + 1 == len(graph.clusters)
    assert len(graph.sepsets) == steps


@models
@pytest.mark.parametrize("steps", [0, 1, 4])
def test_every_cpd_stands_in_one_cluster_and_every_variable_in_a_tree(model, steps):
    graph = pgm.compile(model, steps)
    network = model.to_networkx(steps)
    children = [family[0] for cluster in graph for family in cluster.families]
    with_cpd = {node for node, kind in network.nodes(data="kind") if kind != "input"}
    assert len(children) == len(set(children))
    assert set(children) == with_cpd
    for cluster in graph:
        for cpd, family in zip(cluster.cpds, cluster.families, strict=True):
            assert set(family[1:]) == set(network.predecessors(family[0]))
            assert set(family) <= set(cluster.scope)
            assert family[0].template == cpd.child
    for node in network:
        tree = nx.Graph()
        tree.add_nodes_from(cluster.index for cluster in graph if node in cluster.scope)
        tree.add_edges_from(edge for edge, scope in graph.sepsets.items() if node in scope)
        assert nx.is_tree(tree)


@pytest.mark.parametrize(
    ("name", "first", "later", "sepset"),
    [
        ("localisation", "x[0] z[0] m[0]", "x[1] x[2] u[2] z[2] m[2]", "x[1]"),
        ("no sensor", "a[0]", "a[1] a[2]", "a[1]"),
        (
            "several states",
            "a[0] b[0] x[0] w[0] z[0] m[0]",
            "a[1] b[1] x[1] a[2] b[2] x[2] w[2] z[2] m[2]",
            "a[1] b[1] x[1]",
        ),
        # a sensor of the control has nothing to see at step 0
        ("hidden control", "x[0] z[0] m[0]", "x[1] x[2] u[2] command[2] w[2] z[2] m[2]", "x[1]"),
        ("static unknown", "x[0] m[0] z[0]", "x[1] m[1] x[2] m[2] u[2] z[2]", "x[1] m[1]"),
        ("noise of an input", "a[0]", "a[1] a[2] tires[2]", "a[1]"),
    ],
)
def test_scopes(name, first, later, sepset):
    graph = pgm.compile(MODELS[name], steps=4)

    def words(scope):
        assert len(set(scope)) == len(scope)
        return set(map(repr, scope))

    assert words(graph.clusters[0].scope) == set(first.split())
    assert words(graph.clusters[2].scope) == set(later.split())
    assert words(graph.sepsets[1, 2]) == set(sepset.split())


def test_clusters_by_index_by_slice_and_in_turn():
    graph = pgm.compile(MODELS["localisation"], steps=5)
    clusters = graph.clusters
    assert [cluster.index for cluster in clusters] == list(range(6))
    assert [cluster.index for cluster in graph] == list(range(6))
    assert clusters[-1].index == 5
    assert [cluster.index for cluster in clusters[1:4]] == [1, 2, 3]
    assert [cluster.index for cluster in clusters[::-2]] == [5, 3, 1]
    assert clusters[2] == clusters[2] == pgm.compile(MODELS["localisation"], 3).clusters[2]
    assert len({clusters[2], clusters[2], clusters[3]}) == 2
    assert clusters[2] in clusters
    assert clusters[2].size == 3 + 3 + 2 + 2 + 2
    assert repr(clusters[0]) == "Cluster(0: (x[0], z[0], m[0]))"
    for index in (6, -7):
        with pytest.raises(IndexError):
            clusters[index]


def test_sepsets_by_edge():
    graph = pgm.compile(MODELS["localisation"], steps=5)
    assert list(graph.sepsets) == [(t, t + 1) for t in range(5)]
    assert graph.sepsets[2, 3] == graph.sepsets[3, 2] == (X.at(2),)
    assert dict(graph.sepsets) == {(t, t + 1): (X.at(t),) for t in range(5)}
    for edge in [(0, 2), (1, 1), (5, 6), (-1, 0)]:
        with pytest.raises(pgm.GraphError, match="not joined"):
            graph.sepsets[edge]


def test_asking_whether_an_edge_is_there_does_not_raise():
    sepsets = pgm.compile(MODELS["localisation"], steps=5).sepsets
    assert (0, 1) in sepsets
    assert (0, 2) not in sepsets
    assert sepsets.get((5, 6)) is None


def test_neighbours_and_networkx():
    graph = pgm.compile(MODELS["static unknown"], steps=3)
    assert [graph.neighbours(t) for t in range(4)] == [(1,), (0, 2), (1, 3), (2,)]
    assert pgm.compile(MODELS["static unknown"], steps=0).neighbours(0) == ()
    assert graph.neighbours(graph.clusters[2]) == graph.neighbours(np.int64(2)) == (1, 3)
    for stranger in (4, -1, 99, "2"):
        with pytest.raises(pgm.GraphError, match=r"clusters are 0\.\.3"):
            graph.neighbours(stranger)
    plain = graph.to_networkx()
    assert nx.is_isomorphic(plain, nx.path_graph(4))
    for i, j in itertools.pairwise(range(4)):
        assert plain.edges[i, j]["sepset"] == (X.at(i), M.at(i))
        assert plain.nodes[i]["cluster"] == graph.clusters[i]


def test_clusters_are_named_by_index_or_value():
    graph = pgm.compile(MODELS["localisation"], steps=3)
    assert graph.index(2) == graph.index(graph.clusters[2]) == 2
    for stranger in (4, -1, "2", 1.0, None, pgm.compile(MODELS["localisation"], 9).clusters[7]):
        with pytest.raises(pgm.GraphError, match=r"clusters are 0\.\.3"):
            graph.index(stranger)
    assert graph.index(pgm.compile(MODELS["localisation"], 9).clusters[2]) == 2
    other = pgm.compile(MODELS["no sensor"], steps=3).clusters[2]
    for ask in (graph.index, graph.neighbours):
        with pytest.raises(pgm.GraphError, match=r"Cluster\(2: .* of another graph") as caught:
            ask(other)
        assert caught.value.cluster == other


@models
def test_the_network_is_the_model(model):
    graph = pgm.compile(model, steps=3)
    assert graph.network is graph.model is model
    with pytest.raises(AttributeError, match="immutable"):
        graph.network = None


def test_numpys_integers_are_integers():
    graph = pgm.compile(MODELS["localisation"], steps=np.int64(3))
    assert len(graph) == 4
    assert graph.index(np.int64(2)) == 2
    assert graph.clusters[np.int64(2)].index == 2


@pytest.mark.parametrize("steps", [None, -1, 2.0, "3", True])
def test_the_number_of_steps_is_asked_for(steps):
    with pytest.raises(pgm.GraphError, match="steps=T"):
        pgm.compile(MODELS["localisation"], steps)


@pytest.mark.parametrize("model", [None, start(A), [start(A)]])
def test_only_networks_are_compiled(model):
    with pytest.raises(pgm.ModelError, match="takes a network"):
        pgm.compile(model, 3)


def test_a_graph_is_immutable():
    graph = pgm.compile(MODELS["localisation"], steps=3)
    with pytest.raises(AttributeError, match="immutable"):
        graph.steps = 4
    with pytest.raises(TypeError):
        graph.sepsets[0, 1] = ()
    with pytest.raises(TypeError):
        graph.clusters[0] = None
    with pytest.raises(AttributeError):
        graph.clusters[0].scope = ()


def test_repr_tells_the_chain():
    graph = pgm.compile(MODELS["localisation"], steps=3)
    assert "0..3" in repr(graph)
    assert "x" in repr(graph)


@pytest.mark.parametrize("method", [None, pgm.Balanced()])
@pytest.mark.parametrize("index", [-1, 99, 1.5])
def test_a_cluster_that_is_not_there(index, method):
    x = pgm.Variable("x")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=1.0)],
    )
    with pytest.raises(pgm.GraphError, match="there is no cluster"):
        pgm.compile(model, 4, method=method).cluster(index)
    with pytest.raises(pgm.ModelError, match="unrolled to slices"):
        model.to_networkx(1.5)
    with pytest.raises(pgm.ModelError, match="there is no step -1"):
        model.cpds_at(-1)
