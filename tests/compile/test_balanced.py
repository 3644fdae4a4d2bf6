"""The balanced cluster tree of a dynamic network, against a tree built by recursion."""

import copy
import math
import pickle

import networkx as nx
import numpy as np
import pytest
from dags import chain, continuous
from hypothesis import given, settings
from hypothesis import strategies as st
from templates import MODELS, A, M, X

import pgm
from pgm.compile import BalancedGraph

models = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
structure = settings(max_examples=40, deadline=None)
any_model = st.sampled_from(sorted(MODELS)).map(MODELS.get)


def balanced(model, steps):
    return pgm.compile(model, steps, method=pgm.Balanced())


def roundness(number):
    return max(k for k in range(60) if number % 2**k == 0)


def by_hand(model, steps):
    """Scopes by index and sepsets by edge, from cutting segments where their roundest step is."""
    chain_ = pgm.compile(model, steps)
    scopes = {cluster.index: set(cluster.scope) for cluster in chain_}
    sepsets = {}

    def at(*some):
        return {state.at(step) for step in some for state in model.states}

    def build(first, last):
        if last - first == 1:
            return last
        middle = max(range(first + 1, last), key=roundness)
        index = steps + middle
        scopes[index] = at(first, middle, last)
        for one, other in ((first, middle), (middle, last)):
            sepsets[frozenset((index, build(one, other)))] = at(one, other)
        return index

    if steps:
        sepsets[frozenset((0, build(0, steps)))] = at(0)
    return scopes, sepsets


@given(any_model, st.integers(0, 70))
@structure
def test_it_is_what_recursion_builds(model, steps):
    graph = balanced(model, steps)
    scopes, sepsets = by_hand(model, steps)
    assert {cluster.index: set(cluster.scope) for cluster in graph} == scopes
    assert {frozenset(edge): set(scope) for edge, scope in graph.sepsets.items()} == sepsets
    assert len(graph) == len(scopes)
    assert len(graph.sepsets) == len(sepsets)
    assert list(graph.sepsets) == sorted(graph.sepsets)
    for index in scopes:
        joined = {k for edge in sepsets if index in edge for k in edge} - {index}
        assert graph.neighbours(index) == tuple(sorted(joined))
        assert len(graph.cluster(index).scope) == len(scopes[index])


@given(any_model, st.integers(0, 70))
@structure
def test_it_passes_its_check_and_that_of_a_graph_made_by_hand(model, steps):
    graph = balanced(model, steps)
    graph.check()
    unrolled = pgm.ClusterGraph(
        model.unroll(steps), [cluster.scope for cluster in graph], graph.sepsets
    )
    assert unrolled.is_tree
    assert graph.is_tree
    assert nx.is_tree(graph.to_networkx())


@models
@pytest.mark.parametrize("steps", [0, 1, 2, 7])
def test_leaves_are_the_slices_and_hold_all_cpds(model, steps):
    graph, slices = balanced(model, steps), pgm.compile(model, steps)
    assert [graph.cluster(k) for k in range(steps + 1)] == list(slices)
    assert list(graph.families()) == list(slices.families())
    for cluster in graph.clusters[steps + 1 :]:
        assert cluster.cpds == cluster.families == ()


@given(st.integers(1, 5000))
@structure
def test_depth_is_the_logarithm_and_the_family_agrees(steps):
    graph = balanced(MODELS["no sensor"], steps)
    depth = {graph.root: 0}
    waiting = [graph.root]
    while waiting:
        index = waiting.pop()
        first, last = graph.segment(index)
        below = [graph.segment(child) for child in graph.children(index) if child]
        if below:
            assert below == [(first, index - steps), (index - steps, last)]
        else:
            assert last - first == 1 or index == 0
        for child in graph.children(index):
            assert graph.parent(child) == index
            depth[child] = depth[index] + 1
            waiting.append(child)
    assert len(depth) == len(graph) == 2 * steps
    assert max(depth.values()) == graph.depth == max(math.ceil(math.log2(steps)), 1)
    assert graph.parent(graph.root) is None
    assert graph.segment(graph.root) == (0, steps)


def test_a_single_step_is_a_single_cluster():
    graph = balanced(MODELS["localisation"], 0)
    assert (len(graph), graph.root, graph.depth, graph.parent(0)) == (1, 0, 0, None)
    assert graph.children(0) == graph.neighbours(0) == ()
    assert graph.segment(0) == (0, 0)
    assert dict(graph.sepsets) == {}


def test_a_hundred_thousand_steps_are_arithmetic():
    graph = balanced(MODELS["localisation"], 100_000)
    assert len(graph) == 200_000
    assert graph.depth == 17
    assert graph.root == 100_000 + 65_536
    assert graph.clusters[-1].scope == (X.at(99_998), X.at(99_999), X.at(100_000))
    assert graph.neighbours(100_000) == (199_999,)
    assert (199_998, 199_999) in graph.sepsets
    assert (199_997, 199_999) not in graph.sepsets
    assert graph.within(4) == [0, 1, 2, 3, 4, 100_001, 100_002, 100_003]


@models
@pytest.mark.parametrize("steps", [0, 1, 2, 9])
def test_sizes_width_and_cost(model, steps):
    graph = balanced(model, steps)
    assert graph.sizes == tuple(cluster.size for cluster in graph)
    assert graph.width == max(len(cluster.scope) for cluster in graph) - 1
    assert graph.cost == sum(cluster.size**3 for cluster in graph)


@given(st.integers(0, 40), st.integers(0, 45))
@structure
def test_the_clusters_within_some_steps(steps, last):
    graph = balanced(MODELS["hidden control"], steps)
    due = [c.index for c in graph if max(v.step for v in c.scope) <= last]
    assert list(graph.within(last)) == due


def test_names_and_strangers():
    graph = balanced(MODELS["static unknown"], 5)
    assert repr(graph).splitlines()[0] == (
        "BalancedGraph(clusters 0..9 over steps 0..5, depth 3, sepsets of [x, m])"
    )
    assert graph.sepsets[9, 7] == graph.sepsets[7, 9] == (X.at(0), M.at(0), X.at(4), M.at(4))
    assert graph.segment(graph.clusters[8]) == (2, 4)
    for edge in ((7, 8, 9), (1, 2), (9, 10), "no edge"):
        assert edge not in graph.sepsets
        assert graph.sepsets.get(edge) is None
    with pytest.raises(pgm.GraphError, match="clusters 1 and 2 are not joined"):
        graph.sepsets[1, 2]
    for ask in (graph.neighbours, graph.parent, graph.children, graph.segment):
        with pytest.raises(pgm.GraphError, match=r"clusters are 0\.\.9"):
            ask(10)
        with pytest.raises(pgm.GraphError, match="of another graph"):
            ask(balanced(MODELS["static unknown"], 6).clusters[8])


@pytest.mark.parametrize("way", [copy.deepcopy, lambda g: pickle.loads(pickle.dumps(g))])
def test_it_is_a_value(way):
    graph = balanced(MODELS["localisation"], 6)
    assert graph.root == 10
    twin = way(graph)
    assert isinstance(twin, BalancedGraph)
    assert repr(twin) == repr(graph)
    with pytest.raises(AttributeError, match="immutable"):
        graph.steps = 7
    assert pgm.Balanced() == pgm.Balanced()


class Tampered(BalancedGraph):
    """A balanced tree one part of which somebody has changed."""

    def __init__(self, scope=None, sepset=None):
        super().__init__(MODELS["static unknown"], 6)
        self._set(_scope=scope or {}, _edges=sepset or {})

    def _view(self, index):
        found = super()._view(index)
        changed = self._scope.get(index, lambda scope: scope)(found.scope)
        return pgm.results.Cluster(index, changed, found.cpds, found.families)

    def _sepset(self, i, j):
        return self._edges.get((i, j), lambda scope: scope)(super()._sepset(i, j))


@pytest.mark.parametrize(
    ("scope", "sepset", "words"),
    [
        ({3: lambda s: s[:-1]}, {}, "family preservation fails: cluster 3"),
        ({10: lambda s: s[2:]}, {}, r"holds x\[0\], which cluster 10 does not"),
        ({}, {(8, 10): lambda s: s[1:]}, r"running intersection fails: x\[0\]"),
        ({}, {(0, 10): lambda s: ()}, r"running intersection fails: x\[0\]"),
        ({}, {(3, 9): lambda s: (*s, X.at(1))}, r"holds x\[1\], which cluster"),
        ({12 - 3: lambda s: (*s, M.at(6))}, {}, r"running intersection fails: m\[6\]"),
    ],
)
def test_a_tampered_tree_is_refused(scope, sepset, words):
    Tampered().check()
    with pytest.raises(pgm.GraphError, match=words):
        Tampered(scope, sepset).check()


def test_what_it_is_not_for():
    with pytest.raises(pgm.GraphError, match=r"no time.*NestedDissection") as caught:
        pgm.compile(continuous(chain(4)), method=pgm.Balanced())
    assert "Balanced()" in str(caught.value)
    with pytest.raises(pgm.GraphError, match="steps=T"):
        pgm.compile(MODELS["no sensor"], method=pgm.Balanced())
    with pytest.raises(pgm.GraphError, match=r"pgm\.Balanced\(\).*not by.*unroll"):
        pgm.compile(MODELS["no sensor"], 3, method=pgm.Bethe())
    with pytest.raises(pgm.GraphError, match="not by"):
        pgm.compile(MODELS["no sensor"], 3, method=pgm.Balanced)
    with pytest.raises(pgm.GraphError, match="continuous"):
        pgm.most_probable(balanced(MODELS["no sensor"], 3), {A.at(1): 0})


def test_numpys_integers_are_integers():
    graph = balanced(MODELS["no sensor"], np.int64(5))
    assert graph.segment(np.int64(9)) == (0, 5)
    assert graph.clusters[np.int64(9)].index == 9
