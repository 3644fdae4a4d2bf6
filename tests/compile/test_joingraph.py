"""Join graphs: clusters of bounded size, and the junction tree where the bound allows it."""

import itertools

import numpy as np
import pytest
from compile.drawn import gaussians, hidden, observed, tables, windows
from dags import chain, continuous, discrete, grid, networks, star
from discrete.enumeration import Enumeration
from gaussian.loops import solve
from hypothesis import given, settings
from hypothesis import strategies as st

import pgm
from pgm.clustergraph.cluster import size

ORDERS = [pgm.MinFill(), pgm.WeightedMinFill(), lambda network: network.variables[::-1]]
SCHEDULES = [pgm.Flooding(), pgm.Sequential(), pgm.Residual()]
orders = pytest.mark.parametrize("order", ORDERS, ids=["min-fill", "weighted", "reverse"])


def least(network):
    """Return the size of the largest family."""
    return max(size(cpd.scope) for cpd in network.cpds)


def shape(graph):
    """List clusters and labelled edges, without their numbers."""
    scopes = [frozenset(cluster.scope) for cluster in graph]
    assert len(set(scopes)) == len(scopes)
    edges = {
        (frozenset({scopes[i], scopes[j]}), frozenset(sepset))
        for (i, j), sepset in graph.sepsets.items()
    }
    return set(scopes), edges


@orders
@settings(max_examples=50)
@given(networks(), st.integers(0, 20))
def test_clusters_are_no_larger_than_asked_and_none_is_in_another(order, network, more):
    most = least(network) + more
    graph = pgm.compile(network, method=pgm.JoinGraph(most, order=order))
    graph.check()
    assert max(graph.sizes) <= most
    scopes = [set(cluster.scope) for cluster in graph]
    assert not any(a <= b for a, b in itertools.permutations(scopes, 2))


@orders
@settings(max_examples=50)
@given(networks(), st.integers(0, 3))
def test_where_all_cliques_fit_it_is_the_junction_tree(order, network, more):
    tree = pgm.compile(network, method=pgm.JunctionTree(order))
    graph = pgm.compile(network, method=pgm.JoinGraph(max(tree.sizes) + more, order))
    assert graph.is_tree
    assert shape(graph) == shape(tree)


def test_mini_buckets_of_three():
    """The example of Dechter, Kask and Mateescu (2002), its mini-buckets written out by hand.

    G: GFE. E: EBF. F: FCD | BF, what EBF left. D: CDB. C: CAB. B: AB, what CAB left, and B, what
    BF left. A: A, what CAB left at last.
    """
    a, b, c, d, e, f, g = (pgm.Discrete(name, 2) for name in "ABCDEFG")
    families = {a: (), b: (a,), c: (a, b), d: (b,), f: (c, d), e: (b, f), g: (f, e)}
    network = pgm.BayesianNetwork(
        [
            pgm.TableCPD(v, given, table=np.full((2,) * (len(given) + 1), 0.5))
            for v, given in families.items()
        ]
    )
    graph = pgm.compile(network, method=pgm.JoinGraph(8, order=[g, e, f, d, c, b, a]))
    gfe, ebf, fcd, cdb, cab = (
        frozenset(scope) for scope in ((g, f, e), (e, b, f), (f, c, d), (c, d, b), (c, a, b))
    )
    due = {(gfe, ebf): {e, f}, (ebf, fcd): {f}, (fcd, cdb): {c, d}, (cdb, cab): {b, c}}
    due |= {(ebf, cab): {b}}
    assert shape(graph) == (
        {gfe, ebf, fcd, cdb, cab},
        {(frozenset(ends), frozenset(sepset)) for ends, sepset in due.items()},
    )


def errors(network, evidence, bounds, error):
    """Errors of all marginals together, by the size that clusters may have."""
    found = []
    for bound in bounds:
        graph = pgm.compile(network, method=pgm.JoinGraph(bound))
        posterior = pgm.infer(graph, evidence, schedule=pgm.Flooding(damping=0.3))
        assert posterior.status.converged
        found.append(sum(error(posterior[v], v) for v in hidden(network, evidence)))
    return np.array(found)


def test_marginals_with_larger_clusters():
    """They need not be nearer to the exact ones each time; on average they are."""
    total = np.zeros(3)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        network = tables(rng, windows(rng, 14, most=2, reach=7), most=2)
        evidence = observed(rng, network, 2)
        due = Enumeration(network, evidence)

        def error(belief, v, due=due):
            return np.abs(belief.probabilities - due.marginal(v)).max()

        total += errors(network, evidence, (8, 32, 64), error)
    small, large, exact = total
    assert small > 2.0 * large > 0.1
    assert exact < 1e-8


def test_deviations_with_larger_clusters():
    rng = np.random.default_rng(0)
    network = gaussians(rng, grid(5))
    evidence = observed(rng, network, 2)
    due = solve(network, evidence)

    def error(belief, v):
        return np.abs(np.log(belief.std / due.std(v))).max()

    small, large, exact = errors(network, evidence, (3, 5, 6), error)
    assert small > 1.5 * large > 0.1
    assert exact < 1e-9


@pytest.mark.parametrize("schedule", SCHEDULES, ids=lambda s: type(s).__name__)
def test_means_around_loops_are_exact_where_messages_converge(schedule):
    rng = np.random.default_rng(3)
    network = gaussians(rng, windows(rng, 20, most=2, reach=8), gain=0.5)
    evidence = observed(rng, network, 4)
    graph = pgm.compile(network, method=pgm.JoinGraph(4))
    assert not graph.is_tree
    posterior, due = pgm.infer(graph, evidence, schedule=schedule), solve(network, evidence)
    assert posterior.status.converged
    for variable in due.places:
        error = posterior[variable].mean - np.ravel(due.means(variable))
        assert np.abs(error / due.std(variable)).max() < 1e-7


def test_a_large_grid_has_clusters_of_the_size_asked_for():
    network = discrete(grid(20))
    assert max(pgm.compile(network).sizes) > 10**5
    graph = pgm.compile(network, method=pgm.JoinGraph(256))
    graph.check()
    assert max(graph.sizes) == 256


@orders
def test_a_hub_of_hundreds(order):
    graph = pgm.compile(discrete(star(300)), method=pgm.JoinGraph(16, order))
    graph.check()
    assert graph.is_tree
    hub_first = pgm.JoinGraph(16, lambda network: network.variables)
    graph = pgm.compile(discrete(star(300)), method=hub_first)
    graph.check()
    assert max(graph.sizes) == 16


def test_clusters_and_sepsets_do_not_depend_on_the_run():
    first, second = (pgm.compile(continuous(grid(6)), method=pgm.JoinGraph(4)) for _ in range(2))
    assert [cluster.scope for cluster in first] == [cluster.scope for cluster in second]
    assert first.sepsets == second.sepsets


@pytest.mark.parametrize(
    ("network", "child", "words"),
    [
        (discrete([[], [], [0], [0, 1]], [2, 3, 5, 4]), 3, r"family \(.*\) takes 24 table entries"),
        (continuous([[], [], [0, 1]], [2, 3, 4]), 2, r"family \(.*\) takes 9 components"),
    ],
)
def test_a_family_that_is_too_large_is_refused(network, child, words):
    with pytest.raises(pgm.GraphError, match=words) as caught:
        pgm.compile(network, method=pgm.JoinGraph(8))
    assert caught.value.variable == network.variables[child]
    enough = least(network)
    assert f"give max_size={enough} or more" in str(caught.value)
    pgm.compile(network, method=pgm.JoinGraph(enough)).check()


@pytest.mark.parametrize("most", [0, -1, 2.5, "3", None, True, np.int64(0)])
def test_it_needs_a_size(most):
    with pytest.raises(pgm.GraphError, match=r"`max_size`.*1 or more"):
        pgm.JoinGraph(most)


@pytest.mark.parametrize("order", [3, None, pgm.MinFill, "minfill"])
def test_what_is_no_order_is_refused(order):
    with pytest.raises(pgm.GraphError, match="no elimination order"):
        pgm.JoinGraph(8, order)


def test_an_order_of_other_variables_is_refused():
    network = discrete(chain(3))
    with pytest.raises(pgm.GraphError, match="the elimination order lacks"):
        pgm.compile(network, method=pgm.JoinGraph(8, network.variables[1:]))


def test_the_method_is_a_value():
    assert repr(pgm.JoinGraph(8)) == "JoinGraph(max_size=8, order=MinFill())"
    assert pgm.JoinGraph(np.int64(8)) == pgm.JoinGraph(8, pgm.MinFill())
    assert len({pgm.JoinGraph(8), pgm.JoinGraph(8), pgm.JoinGraph(9)}) == 2
    with pytest.raises(AttributeError):
        pgm.JoinGraph(8).max_size = 9
