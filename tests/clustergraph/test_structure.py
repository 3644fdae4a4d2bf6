"""Cluster graphs made by hand: what is refused, what is derived, and how they are kept."""

import copy
import pickle

import networkx as nx
import numpy as np
import pytest
from dags import continuous, discrete, networks
from hypothesis import given

import pgm
from pgm.clustergraph import check_families
from pgm.clustergraph.cluster import amount, extent, size, work

# The square: a, b given a, c given a, d given b and c.
NET = continuous([[], [0], [0], [1, 2]])
A, B, C, D = NET.variables
TREE = [{A, B, C}, {B, C, D}]
# Without the edge of a and d, the family of d would be lost: {b, c, d} holds it.
LOOP = [{A, B}, {A, C}, {B, C, D}]
LOOP_SEPSETS = {(0, 1): {A}, (0, 2): {B}, (1, 2): {C}}
STRANGER = pgm.Variable("stranger")


def test_a_tree_by_hand():
    graph = pgm.ClusterGraph(NET, TREE)
    graph.check()
    assert [cluster.scope for cluster in graph] == [(A, B, C), (B, C, D)]
    assert dict(graph.sepsets) == {(0, 1): (B, C)}
    assert graph.is_tree
    assert graph.neighbours(0) == (1,)
    assert [[cpd.child for cpd in cluster.cpds] for cluster in graph] == [[A, B, C], [D]]
    assert [cluster.index for cluster in graph.clusters] == [0, 1]


def test_a_loop_by_hand():
    graph = pgm.ClusterGraph(NET, LOOP, LOOP_SEPSETS)
    graph.check()
    assert not graph.is_tree
    assert dict(graph.sepsets) == {(0, 1): (A,), (0, 2): (B,), (1, 2): (C,)}
    assert graph.neighbours(2) == graph.neighbours(graph.clusters[2]) == (0, 1)
    assert graph.neighbours(np.int64(0)) == (1, 2)


@pytest.mark.parametrize("stranger", [99, 2, -1, "0", None, 1.0])
def test_only_clusters_have_neighbours(stranger):
    with pytest.raises(pgm.GraphError, match=r"clusters are 0\.\.1") as caught:
        pgm.ClusterGraph(NET, TREE).neighbours(stranger)
    assert caught.value.cluster == stranger


def walk(method=None):
    x = pgm.Variable("x")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=1.0)],
    )
    return pgm.compile(model, 12, method=method)


GRAPHS = {
    "by hand": lambda: pgm.ClusterGraph(NET, TREE),
    "with a loop": lambda: pgm.ClusterGraph(NET, LOOP, LOOP_SEPSETS),
    "junction tree": lambda: pgm.compile(NET),
    "tables": lambda: pgm.compile(discrete([[], [0], [0], [1, 2]])),
    "bethe": lambda: pgm.compile(NET, method=pgm.Bethe()),
    "chain": walk,
    "balanced": lambda: walk(pgm.Balanced()),
}


@pytest.mark.parametrize("make", GRAPHS.values(), ids=GRAPHS)
def test_every_graph_gives_its_clusters_by_index_or_value(make):
    graph = make()
    for k, cluster in enumerate(graph.clusters):
        assert graph.cluster(k) == graph.cluster(np.int64(k)) == graph.cluster(cluster) == cluster
    last = len(graph) - 1
    for stranger in (-1, last + 1, 1.0, graph.cluster(last).scope):
        with pytest.raises(pgm.GraphError, match=rf"there is no .*; clusters are 0\.\.{last}"):
            graph.cluster(stranger)
    with pytest.raises(pgm.GraphError, match=r"of another graph|there is no cluster Cluster"):
        graph.cluster(pgm.results.Cluster(last, (STRANGER,), (), ()))


def test_the_clusters_of_a_small_graph_are_named():
    with pytest.raises(pgm.GraphError, match=r"0\.\.1: 0 \(x0, x1, x2\), 1 \(x1, x2, x3\)"):
        pgm.ClusterGraph(NET, TREE).cluster(2)


def test_clusters_of_another_graph_are_refused():
    tree, loop = pgm.ClusterGraph(NET, TREE), pgm.ClusterGraph(NET, LOOP, LOOP_SEPSETS)
    for ask in (tree.index, tree.neighbours):
        with pytest.raises(pgm.GraphError, match=r"Cluster\(0: \(x0, x1\)\) .* another graph") as e:
            ask(loop.clusters[0])
        assert e.value.cluster == loop.clusters[0]
    # the same scope, but other CPDs
    alike = pgm.ClusterGraph(continuous([[], [0], [0], [1, 2]]), TREE)
    with pytest.raises(pgm.GraphError, match="another graph"):
        tree.index(alike.clusters[0])
    assert tree.index(pgm.ClusterGraph(NET, TREE).clusters[1]) == 1


def test_scopes_are_in_the_networks_order_whatever_is_given():
    graph = pgm.ClusterGraph(NET, [[C, A, B], (D, C, B)], {frozenset((1, 0)): [C, B]})
    assert [cluster.scope for cluster in graph] == [(A, B, C), (B, C, D)]
    assert dict(graph.sepsets) == {(0, 1): (B, C)}


def test_numpys_integers_name_clusters():
    edge = tuple(np.array([1, 0]))
    assert list(pgm.ClusterGraph(NET, TREE, {edge: {B, C}}).sepsets) == [(0, 1)]


def test_equal_clusters_are_legal():
    for sepsets in (None, {(0, 1): {B, C}, (1, 2): {B, C, D}}):
        graph = pgm.ClusterGraph(NET, [*TREE, {B, C, D}], sepsets)
        graph.check()
        assert graph.is_tree
        assert graph.sepsets[1, 2] == (B, C, D)
        assert [len(cluster.cpds) for cluster in graph] == [3, 1, 0]


def test_each_cpd_goes_to_the_smallest_cluster_that_holds_it():
    graph = pgm.ClusterGraph(NET, [{A, B, C}, {A, B}, {A}, {B, C, D}])
    assert [[cpd.child for cpd in cluster.cpds] for cluster in graph] == [[C], [B], [A], [D]]
    # by the entries of a table, not by its axes
    net = discrete([[], [0], [0], [0]], [2, 9, 2, 2])
    a, b, c, d = net.variables
    graph = pgm.ClusterGraph(net, [{a, b}, {a, c, d}])
    assert [[cpd.child for cpd in cluster.cpds] for cluster in graph] == [[b], [a, c, d]]


def test_an_edge_that_carries_nothing_is_legal():
    net = continuous([[], []])
    a, b = net.variables
    graph = pgm.ClusterGraph(net, [{a}, {b}], {(0, 1): set()})
    graph.check()
    assert graph.sepsets[0, 1] == ()


@pytest.mark.parametrize(
    ("clusters", "sepsets", "words", "variable", "cluster"),
    [
        ([], None, "no cluster holds the family", A, None),
        ([{A, B}, {A, C}, {C, D}], None, r"no cluster holds the family \(x3, x1, x2\)", D, None),
        (LOOP, None, "no tree of these clusters carries each variable", None, None),
        (LOOP, {(0, 1): {A}, (0, 2): {B}}, "x2 is in clusters .* no path", C, None),
        (LOOP, {}, "running intersection fails", None, None),
        (TREE, {(0, 1): {B, C, D}}, "between clusters 0 and 1 holds x3, which cluster 0", D, 0),
        (TREE, {(0, 1): {B, C, STRANGER}}, "holds stranger, which the network", STRANGER, None),
        ([*TREE, {STRANGER}], None, "cluster 2 holds stranger", STRANGER, None),
        ([*TREE, set()], None, "cluster 2 is empty", None, 2),
        (TREE, {(0, 2): {B}}, r"clusters 0\.\.1, not \(0, 2\)", None, None),
        (TREE, {(-1, 0): {B}}, r"clusters 0\.\.1, not \(-1, 0\)", None, None),
        (TREE, {(0, 0): {B}}, r"clusters 0\.\.1, not \(0, 0\)", None, None),
        (TREE, {(0, 1): {B, C}, (1, 0): {B, C}}, "0 and 1 are given two sepsets", None, 0),
        (TREE, {(0, 1.0): {B, C}}, "is none", None, None),
        (TREE, {"01": {B, C}}, "'01' is none", None, None),
        (TREE, {(0, 1, 2): {B, C}}, "is none", None, None),
        (TREE, {0: {B, C}}, "0 is none", None, None),
        (TREE, [(0, 1)], "sepsets maps pairs", None, None),
        (
            TREE,
            {(0, 1): 3},
            "clusters 0 and 1 is a set of variables, not 3",
            None,
            None,
        ),
        ([*TREE, 3], None, "cluster 2 is a set of variables, not 3", None, None),
        (3, None, "clusters is a sequence of sets", None, None),
    ],
)
def test_what_is_refused(clusters, sepsets, words, variable, cluster):
    with pytest.raises(pgm.GraphError, match=words) as caught:
        pgm.ClusterGraph(NET, clusters, sepsets)
    if variable is not None:
        assert caught.value.variable == variable
    if cluster is not None:
        assert caught.value.cluster == cluster


@pytest.mark.parametrize("scope", [["x0"], [A, A], "x0"])
def test_clusters_and_sepsets_hold_variables_once(scope):
    with pytest.raises(pgm.ModelError, match=r"^cluster 2 holds (variables, not 'x0'|x0 twice)"):
        pgm.ClusterGraph(NET, [*TREE, scope])
    with pytest.raises(pgm.ModelError, match=r"^the sepset between clusters 0 and 1 holds "):
        pgm.ClusterGraph(NET, TREE, {(1, 0): scope})


@pytest.mark.parametrize("network", [None, NET.cpds, "net"])
def test_a_graph_is_of_a_network(network):
    with pytest.raises(pgm.GraphError, match="of a network without time"):
        pgm.ClusterGraph(network, TREE)


def test_the_error_for_running_intersection_names_the_clusters_and_says_what_to_do():
    with pytest.raises(pgm.GraphError) as caught:
        pgm.ClusterGraph(NET, LOOP)
    error = caught.value
    held = [k for k, scope in enumerate(LOOP) if error.variable in scope]
    assert len(held) == 2
    assert f"{error.variable!r} is in clusters {held[0]} and {held[1]}" in str(error)
    assert error.cluster not in held
    assert "give sepsets" in str(error)
    repaired = [
        scope | ({error.variable} if k == error.cluster else set()) for k, scope in enumerate(LOOP)
    ]
    pgm.ClusterGraph(NET, repaired).check()


def test_long_lists_of_clusters_are_cut_short():
    net = continuous([[]] + [[0]] * 50)
    hub, *rest = net.variables
    with pytest.raises(pgm.GraphError, match=r"\[0, 1, 2, 3, 4, \.\.\.\] and \[49\]") as caught:
        pgm.ClusterGraph(net, [{hub, leaf} for leaf in rest], {(0, k): {hub} for k in range(1, 49)})
    assert caught.value.cluster == 49


def test_long_lists_of_variables_are_cut_short():
    net = continuous([[], *([0],) * 8, list(range(9))])
    *_, last = net.variables
    listed = r"\(x9, x0, x1, x2, x3, x4, x5, x6, \.\.\. \(10 in all\)\)"
    with pytest.raises(pgm.GraphError, match=f"holds the family {listed} of") as caught:
        pgm.ClusterGraph(net, [net.variables[:-1]])
    assert caught.value.variable == last
    whole = pgm.ClusterGraph(net, [net.variables]).clusters[0]
    assert repr(whole) == "Cluster(0: (x0, x1, x2, x3, x4, x5, x6, x7, ... (10 in all)))"
    with pytest.raises(pgm.GraphError, match=f"assigned the family {listed}, but"):
        check_families([net.variables[:5]], [[net.cpds[-1].scope]])
    small = pgm.ClusterGraph(NET, [NET.variables]).clusters[0]
    assert repr(small) == "Cluster(0: (x0, x1, x2, x3))"


def test_sizes_of_continuous_clusters():
    net = continuous([[], [0], [1], [1]], [2, 1, 3, 1])
    graph = pgm.compile(net)
    scopes = [{v.name for v in cluster.scope} for cluster in graph]
    assert dict(zip(map(frozenset, scopes), graph.sizes, strict=True)) == {
        frozenset({"x0", "x1"}): 3,
        frozenset({"x1", "x2"}): 4,
        frozenset({"x1", "x3"}): 2,
    }
    assert graph.sizes == tuple(cluster.size for cluster in graph)
    assert graph.width == 1
    assert graph.cost == 27 + 64 + 8


def test_sizes_of_discrete_clusters():
    net = discrete([[], [0], [1]], [2, 3, 5])
    graph = pgm.compile(net)
    assert sorted(graph.sizes) == [6, 15]
    assert graph.width == 1
    assert graph.cost == 21


def test_sizes_are_exact_however_large():
    many = [pgm.Discrete(f"v{k}", states=10) for k in range(400)]
    assert size(tuple(many)) == work(tuple(many)) == 10**400
    assert extent(many[0]) == 10
    assert extent(pgm.Variable("x", ("a", "b"))) == 2
    assert amount(size(tuple(many))) == "10^400.0"
    assert amount(2**20) == "1048576"
    assert amount(2**68) == "10^20.5"


def test_repr_tells_what_to_expect():
    assert (
        repr(pgm.ClusterGraph(NET, LOOP, LOOP_SEPSETS)).splitlines()[0]
        == "ClusterGraph(3 clusters, 3 sepsets, width 2, largest cluster 3 components, cost 43)"
    )
    a, b = (net := discrete([[], [0]], [4, 5])).variables
    assert (
        repr(pgm.ClusterGraph(net, [{a, b}])).splitlines()[0]
        == "ClusterGraph(1 cluster, 0 sepsets, width 1, largest cluster 20 table entries, "
        "cost 20)"
    )
    net = discrete([[]] * 40, [10] * 40)
    assert repr(pgm.ClusterGraph(net, [net.variables])).splitlines()[0].endswith("cost 10^40.0)")


@given(networks())
def test_whether_it_is_a_tree_against_networkx(network):
    for method in (pgm.JunctionTree(), pgm.Bethe()):
        graph = pgm.compile(network, method=method)
        assert graph.is_tree == nx.is_forest(graph.to_networkx())


def test_check_finds_what_was_not_built_by_the_constructor():
    graph = pgm.ClusterGraph(NET, LOOP, LOOP_SEPSETS)
    broken = copy.copy(graph)
    broken._set(_sepsets={(0, 1): (A,), (0, 2): (B,)})
    with pytest.raises(pgm.GraphError, match="running intersection"):
        broken.check()
    graph.check()


def test_what_is_derived_is_made_once():
    graph = pgm.ClusterGraph(NET, TREE)
    calls = []

    def plan(made_of, *key):
        calls.append((made_of, key))
        return object()

    first = graph.derived(plan, 1, "a")
    assert graph.derived(plan, 1, "a") is first
    assert graph.derived(plan, 2) is not first
    assert calls == [(graph, (1, "a")), (graph, (2,))]


WAYS = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda value: pickle.loads(pickle.dumps(value)),
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize(
    "graph",
    [pgm.ClusterGraph(NET, TREE), pgm.ClusterGraph(NET, LOOP, LOOP_SEPSETS)],
    ids=["tree", "loop"],
)
def test_copies_answer_alike_and_leave_behind_what_was_derived(way, graph):
    # a function that cannot be pickled
    made = graph.derived(lambda graph: lambda: graph)
    twin = way(graph)
    assert "_derived" not in vars(twin)
    assert twin.derived(lambda graph: 0) == 0
    assert made() is graph
    assert [cluster.scope for cluster in twin] == [cluster.scope for cluster in graph]
    assert dict(twin.sepsets) == dict(graph.sepsets)
    assert twin.is_tree == graph.is_tree
    assert (twin.sizes, twin.width, twin.cost) == (graph.sizes, graph.width, graph.cost)
    assert [twin.neighbours(k) for k in range(len(twin))] == [
        graph.neighbours(k) for k in range(len(graph))
    ]
    twin.check()
    with pytest.raises(TypeError):
        twin.sepsets[0, 1] = ()
    with pytest.raises(AttributeError, match="immutable"):
        twin.network = None


def test_slices_leave_behind_what_was_derived_too():
    x = pgm.Variable("x")
    graph = pgm.compile(
        pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(x, 0.0, 1.0)],
            [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1.0)],
        ),
        steps=3,
    )
    graph.derived(lambda graph: lambda: graph)
    twin = pickle.loads(pickle.dumps(graph))
    assert "_derived" not in vars(twin)
    assert twin.sizes == graph.sizes == (1, 2, 2, 2)
