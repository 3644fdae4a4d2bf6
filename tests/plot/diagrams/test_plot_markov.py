"""`pgm.plot.markov_network` against NetworkX's moral graph."""

from itertools import combinations

import networkx as nx
import numpy as np
import pytest
from matplotlib.patches import Ellipse, FancyArrowPatch

import pgm
import pgm.plot
from models.seven_nodes import CLUSTERS, seven_nodes, seven_nodes_clusters
from pgm import EvidenceError, ModelError
from tests.plot.conftest import two_states
from tests.plot.diagrams.test_plot_static import NETWORKS, gaussian

a, b, c, d = pgm.variables("a b c d")


def drawn(ax):
    """The lines of a picture as pairs of names, by whether they are dashed."""
    at = {text.get_position(): text.get_text().replace("\n", "") for text in ax.texts}
    names = [at[tuple(p.center)] for p in ax.patches if isinstance(p, Ellipse)]
    ovals = [p for p in ax.patches if isinstance(p, Ellipse)]
    assert not any(isinstance(p, FancyArrowPatch) for p in ax.patches)

    def nearest(point):
        reach = [np.hypot(*(2.0 * (point - o.center) / (o.width, o.height))) for o in ovals]
        assert min(reach) == pytest.approx(1.0, abs=0.1)  # lines end at borders
        return names[int(np.argmin(reach))]

    found = {False: set(), True: set()}
    for line in ax.lines:
        ends = line.get_xydata()[[0, -1]]
        found[line.is_dashed()].add(frozenset(map(nearest, ends)))
    assert sum(map(len, found.values())) == len(ax.lines)
    return names, found[False], found[True]


def pairs(edges):
    return {frozenset(repr(v) for v in edge) for edge in edges}


@pytest.mark.parametrize("name", ["asia", "one", "apart", "chain", "complete", "dense"])
def test_a_bayesian_network_is_drawn_as_its_moral_graph(name):
    parents = NETWORKS[name]
    network = gaussian(
        {
            each.replace(" ", ""): [p.replace(" ", "") for p in given]
            for each, given in parents.items()
        }
    )
    names, plain, dashed = drawn(pgm.plot.markov_network(network))
    moral = nx.moral_graph(network.to_networkx())
    assert sorted(names) == sorted(map(repr, moral))
    assert plain == pairs(network.to_networkx().edges)
    assert plain | dashed == pairs(moral.edges)
    assert not plain & dashed


def test_a_dynamic_network_is_unrolled():
    model = two_states()
    names, plain, dashed = drawn(pgm.plot.markov_network(model, steps=2))
    moral = nx.moral_graph(model.to_networkx(2))
    assert sorted(names) == sorted(map(repr, moral))
    assert plain | dashed == pairs(moral.edges)


def test_what_has_a_scope_may_be_drawn():
    due = pairs(pair for scope in CLUSTERS.values() for pair in combinations(scope, 2))
    graph = seven_nodes_clusters()
    posterior = pgm.infer(graph, {})
    for factors in (
        CLUSTERS.values(),
        graph,
        [posterior.belief(cluster) for cluster in graph],
        (cpd for cpd in seven_nodes().cpds),
    ):
        assert drawn(pgm.plot.markov_network(factors))[1] == due


def test_a_loop_that_no_arrows_could_say():
    names, plain, dashed = drawn(pgm.plot.markov_network([{a, b}, {b, c}, {c, d}, {d, a}]))
    assert sorted(names) == ["a", "b", "c", "d"]
    assert plain == pairs([(a, b), (b, c), (c, d), (d, a)])
    assert not dashed


def test_parts_that_are_not_joined_and_a_variable_alone():
    names, plain, _ = drawn(pgm.plot.markov_network([(a, b), (c,)]))
    assert sorted(names) == ["a", "b", "c"]
    assert plain == pairs([(a, b)])


def test_observed_variables_are_shaded():
    ax = pgm.plot.markov_network([(a, b), (b, c)], evidence=[b])
    at = {text.get_position(): text.get_text() for text in ax.texts}
    grey = {at[tuple(p.center)] for p in ax.patches if p.get_facecolor()[0] < 0.9}
    assert grey == {"b"}


@pytest.mark.parametrize(
    ("given", "also", "error", "told"),
    [
        (3, {}, ModelError, "draws a network, or a list of factors.*found int"),
        ([], {}, ModelError, "found an empty one"),
        ("ab", {}, ModelError, "found str"),
        ([(a, b), c], {}, ModelError, r"item 1 of the factors, c, has no scope"),
        ([(a, "b")], {}, ModelError, "item 0 of the factors holds 'b', no variable"),
        ([(a, b)], {"steps": 2}, ModelError, "steps cut a DynamicBayesianNetwork"),
        (seven_nodes(), {"steps": 2}, ModelError, "steps cut a DynamicBayesianNetwork"),
        ([(a, b)], {"evidence": [c]}, EvidenceError, "evidence names .*c"),
    ],
)
def test_what_does_not_fit_is_refused(given, also, error, told):
    with pytest.raises(error, match=told):
        pgm.plot.markov_network(given, **also)
