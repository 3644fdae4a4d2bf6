"""Elimination orders: permutations, deterministic, and as good as they are known to be."""

import itertools
import math
import random

import networkx as nx
import numpy as np
import pytest
from dags import chain, continuous, discrete, grid, networks, random_parents, star, tree
from hypothesis import given

import pgm
from pgm.compile import StochasticMinFill
from pgm.compile import orders as orders_module
from pgm.compile.dissection import dissect
from pgm.compile.elimination import Core, Filling, Search, cheapest, clique_tree, moral
from pgm.compile.sparse import SparseGraph

ORDERS = {
    "min-fill": pgm.MinFill(),
    "minimum degree": pgm.MinDegree(),
    "weighted min-fill": pgm.WeightedMinFill(),
    "stochastic min-fill": StochasticMinFill(),
    "nested dissection": pgm.NestedDissection(),
    "nested dissection to the end": pgm.NestedDissection(small=1),
}
orders = pytest.mark.parametrize("order", ORDERS.values(), ids=ORDERS)


def compiled(network, order):
    return pgm.compile(network, method=pgm.JunctionTree(order))


def depth(graph):
    """How far the ends of a tree are from its middle: two searches find its longest path."""
    plain = graph.to_networkx()
    far = 0
    for _ in range(2):
        lengths = nx.single_source_shortest_path_length(plain, far)
        far = max(lengths, key=lengths.get)
    return (lengths[far] + 1) // 2


@orders
@given(networks())
def test_orders_are_permutations_and_the_same_each_time(order, network):
    found = order(network)
    assert sorted(map(repr, found)) == sorted(map(repr, network.variables))
    assert order(pgm.BayesianNetwork(network.cpds)) == found


@orders
def test_orders_are_values(order):
    assert order == type(order)(**vars(order))
    assert hash(order) == hash(type(order)(**vars(order)))


@pytest.mark.parametrize("order", [pgm.MinFill(), pgm.WeightedMinFill(), pgm.MinDegree()])
@pytest.mark.parametrize("branches", [1, 2, 3, 20])
def test_trees_have_width_one(order, branches):
    graph = compiled(continuous(tree(60, branches)), order)
    graph.check()
    assert graph.width == 1


@orders
@pytest.mark.parametrize("side", [2, 3, 4, 5, 6, 8, 12])
def test_grids_have_about_the_width_of_their_side(order, side):
    graph = compiled(continuous(grid(side)), order)
    graph.check()
    # the treewidth of a grid is its side; half as much again is what these rules reach
    assert side <= graph.width <= 1.5 * side + 1


@pytest.mark.parametrize(
    "parents", [chain(5), [[], []], [[], [0], [1], [2], [3, 0]], [[], [0], [0], [1, 2], [3]]]
)
def test_widths_of_small_networks_are_their_treewidth(parents):
    network = continuous(parents)
    possible = itertools.permutations(network.variables)
    best = min(compiled(network, order).width for order in possible)
    assert compiled(network, pgm.MinFill()).width == best


def test_weights_are_numbers_of_states():
    # Of the square 0-1-2-3, eliminating 0 or 2 joins 1 and 3, which are large.
    parents = [[], [0], [1], [2], [3, 0]]
    sizes = [2, 9, 2, 9, 2]
    network = discrete(parents, sizes)
    plain = compiled(network, pgm.MinFill())
    weighted = compiled(network, pgm.WeightedMinFill())
    assert weighted.cost < plain.cost
    assert weighted.width == plain.width


def test_weights_are_numbers_of_components():
    parents = [[], [0], [1], [2], [3, 0]]
    network = continuous(parents, [1, 5, 1, 5, 1])
    weighted = compiled(network, pgm.WeightedMinFill())
    assert weighted.cost < compiled(network, pgm.MinFill()).cost


def test_a_search_finds_cheaper_orders_of_large_networks():
    # Min-fill leaves 10 million entries, a search about four.
    network = discrete(grid(14))
    plain = compiled(network, pgm.MinFill())
    drawn = [compiled(network, StochasticMinFill(seed=seed)) for seed in (0, 1)]
    for graph in drawn:
        graph.check()
        assert graph.cost < 0.7 * plain.cost
    assert drawn[0].clusters != drawn[1].clusters
    assert compiled(network, StochasticMinFill(tries=0)).clusters == plain.clusters
    costs = [compiled(network, StochasticMinFill(tries=tries)).cost for tries in (0, 10, 30)]
    assert costs == sorted(costs, reverse=True)


def test_large_networks_are_searched_in_proportion_to_what_is_asked(monkeypatch):
    made = []
    monkeypatch.setattr(Search, "_try", lambda *given: made.append(given) or [])
    network = discrete(grid(14))
    counts = []
    for tries in (20, 100, 200):
        made.clear()
        StochasticMinFill(tries=tries)(network)
        counts.append(len(made))
    assert counts == [20 * 160 // 196, 100 * 160 // 196, 200 * 160 // 196]


def entries(adjacent, order, sizes):
    """The table entries of the maximal cliques, by networkx."""
    filled = nx.Graph((v, u) for v, near in enumerate(adjacent) for u in near)
    filled.add_nodes_from(range(len(adjacent)))
    left = filled.copy()
    for vertex in order:
        fill = list(itertools.combinations(list(left[vertex]), 2))
        filled.add_edges_from(fill)
        left.add_edges_from(fill)
        left.remove_node(vertex)
    return sum(math.prod(sizes[v] for v in clique) for clique in nx.find_cliques(filled))


@pytest.mark.parametrize("seed", range(20))
def test_a_try_ends_where_its_maximal_cliques_have_more_entries_than_its_bound(seed):
    rng = np.random.default_rng(seed)
    adjacent = moral(continuous(random_parents(rng, 25)))
    sizes = rng.integers(2, 4, 25).tolist()
    core = Core.of(Filling(adjacent, [1] * 25), [], sizes)
    for number in range(4):
        tries = Search(core, random.Random(number)).tries()
        order = next(tries)(10**12)
        assert sorted(order) == list(range(25))
        due = entries(adjacent, order, sizes)
        assert next(Search(core, random.Random(number)).tries())(due) == order
        assert next(Search(core, random.Random(number)).tries())(due - 1) == []


@pytest.mark.parametrize("seed", range(10))
def test_a_search_never_finds_a_dearer_order(seed):
    rng = np.random.default_rng(seed)
    network = discrete(random_parents(rng, 60, most=4), rng.integers(2, 5, 60).tolist())
    adjacent = moral(network)
    sizes = [v.size for v in network.variables]
    order = cheapest(adjacent, sizes, 50, seed)
    assert sorted(order) == list(range(60))
    plain = entries(adjacent, cheapest(adjacent, sizes, 0, seed), sizes)
    found = entries(adjacent, order, sizes)
    assert found <= plain
    cliques = clique_tree(adjacent, order).cliques
    assert found == sum(math.prod(sizes[v] for v in clique) for clique in cliques)


@pytest.mark.parametrize("network", [discrete(grid(6)), discrete(grid(24)), continuous(grid(14))])
def test_there_is_no_search_where_it_does_not_pay(network):
    # Too small, without hope, and continuous.
    assert StochasticMinFill()(network) == pgm.MinFill()(network)


@pytest.mark.parametrize("wrong", [{"tries": -1}, {"tries": 1.5}, {"seed": "a"}, {"seed": True}])
def test_searches_take_whole_numbers(wrong):
    with pytest.raises(pgm.GraphError, match=f"whole number of {next(iter(wrong))}, 0 or more"):
        StochasticMinFill(**wrong)


@given(networks())
def test_minimum_degree_takes_childless_variables_first_then_by_degree(network):
    order = pgm.MinDegree()(network)
    parents = {p for cpd in network.cpds for p in cpd.parents}
    last = [v in parents for v in order]
    assert last == sorted(last)
    adjacent, place = moral(network), {v: k for k, v in enumerate(network.variables)}
    left = nx.Graph((v, u) for v, near in enumerate(adjacent) for u in near)
    left.add_nodes_from(range(len(adjacent)))
    for k, variable in enumerate(order):
        vertex = place[variable]
        if last[k] and (k == 0 or not last[k - 1]):
            # Several vertices of least degree are eliminated at once: the first is one of these.
            assert left.degree[vertex] == min(dict(left.degree).values())
        left.add_edges_from(itertools.combinations(list(left[vertex]), 2))
        left.remove_node(vertex)


def field(side):
    """Pixels, each seen with the next to the east and to the north."""
    x = np.reshape(pgm.variables(f"x{k}" for k in range(side * side)), (side, side))
    a, b, d = pgm.variables("a b d")
    difference = pgm.LinearGaussianCPD(d, given={a: 1.0, b: -1.0}, cov=0.1)
    cpds = [*pgm.plate(pgm.GaussianCPD(a, 0.0, 1.0), {a: x})]
    for name, one, other in (("e", x[:, :-1], x[:, 1:]), ("n", x[:-1], x[1:])):
        z = np.reshape(pgm.variables(f"{name}{k}" for k in range(one.size)), one.shape)
        cpds += pgm.plate(difference, {d: z, a: one, b: other})
    return pgm.BayesianNetwork(cpds)


def operations(network, order):
    """Σ n² over the cliques of all variables as they are eliminated, on a copy of the graph."""
    place = {v: k for k, v in enumerate(network.variables)}
    left, total = [set(near) for near in moral(network)], 0
    for variable in order:
        vertex = place[variable]
        near = left[vertex]
        total += (len(near) + 1) ** 2
        for other in near:
            left[other] |= near
            left[other] -= {other, vertex}
    return total


def test_fields_have_about_the_operations_of_min_fill_by_degrees_and_by_dissection(monkeypatch):
    side = 30
    network = field(side)
    least = operations(network, pgm.MinFill()(network))
    order = pgm.MinDegree()(network)
    assert operations(network, order) < 1.25 * least
    # SciPy tells the inverse of the order, in which they are thirty times as many.
    first, pixels = order[: -side * side], order[-side * side :]
    by_name = sorted(pixels, key=network.variables.index)
    place = {v: k for k, v in enumerate(by_name)}
    inverse = [by_name[k] for k in np.argsort([place[v] for v in pixels])]
    assert operations(network, (*first, *inverse)) > 5 * least
    monkeypatch.setattr(orders_module, "LARGE", 100)
    assert operations(network, pgm.NestedDissection()(network)) < 1.25 * least


def test_large_continuous_networks_are_ordered_by_degrees(monkeypatch):
    network = field(12)  # of whose variables 144 are parents
    monkeypatch.setattr(orders_module, "LARGE", 144)
    assert StochasticMinFill()(network) == pgm.MinFill()(network) != pgm.MinDegree()(network)
    monkeypatch.setattr(orders_module, "LARGE", 143)
    assert StochasticMinFill()(network) == pgm.MinDegree()(network)
    tables = discrete(grid(6))
    monkeypatch.setattr(orders_module, "LARGE", 0)
    assert StochasticMinFill(tries=0)(tables) == pgm.MinFill()(tables)


@given(networks())
def test_large_networks_are_dissected_by_degrees(network):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(orders_module, "LARGE", 0)
        order = pgm.NestedDissection(small=2)(network)
        assert sorted(map(repr, order)) == sorted(map(repr, network.variables))
        assert pgm.NestedDissection(small=2)(pgm.BayesianNetwork(network.cpds)) == order
        compiled(network, pgm.NestedDissection(small=2)).check()


@pytest.mark.parametrize("large", [0, 10**6])
def test_dissection_of_a_long_chain_is_shallow_by_degrees_too(monkeypatch, large):
    monkeypatch.setattr(orders_module, "LARGE", large)
    graph = compiled(continuous(chain(3000)), pgm.NestedDissection())
    assert graph.width == 2
    assert depth(graph) <= 2 * math.log2(3000) + 8


@given(networks())
def test_levels_of_a_search_are_networkx_own(network):
    adjacent = moral(network)
    plain = nx.Graph((v, u) for v, near in enumerate(adjacent) for u in near)
    plain.add_nodes_from(range(len(adjacent)))
    graph = SparseGraph.of(adjacent)
    parts = graph.components()
    assert len(set(parts)) == nx.number_connected_components(plain)
    starts = np.unique(parts, return_index=True)[1]
    due = {}
    for start in starts.tolist():
        due |= nx.single_source_shortest_path_length(plain, start)
    assert graph.levels(starts).tolist() == [due[v] for v in range(len(adjacent))]


@pytest.mark.parametrize("count", [100, 1000])
def test_dissected_chains_are_shallow(count):
    network = continuous(chain(count))
    graph = compiled(network, pgm.NestedDissection())
    graph.check()
    assert graph.width == 2
    assert depth(graph) <= 2 * math.log2(count) + 8
    assert depth(compiled(network, pgm.MinFill())) >= count // 2 - 1


def test_a_variable_in_every_family_does_not_hide_the_chain_from_dissection():
    parents = [[]] + [[0] if k == 1 else [0, k - 1] for k in range(1, 1000)]
    graph = compiled(continuous(parents), pgm.NestedDissection())
    graph.check()
    assert graph.width == 3
    assert depth(graph) <= 30


@pytest.mark.parametrize("parents", [chain(200), grid(12), grid(3, 40)])
def test_separators_leave_parts_of_at_most_about_two_thirds(parents):
    adjacent = moral(continuous(parents))
    stages = dissect(adjacent, small=1)
    graph = nx.Graph((v, u) for v, near in enumerate(adjacent) for u in near)
    parts = [set(graph)]
    for depth in range(-min(stages) + 1):
        following = []
        for part in parts:
            separator = {v for v in part if stages[v] == -depth}
            rest = list(nx.connected_components(graph.subgraph(part - separator)))
            if rest:
                # idle vertices of a level go to its side, and small parts may have no fair level
                assert max(map(len, rest)) <= 0.8 * len(part) or len(part) < 20
                assert len(rest) > 1
            else:  # not divided: all are next to one of them
                assert nx.radius(graph.subgraph(part)) <= 1
            following += rest
        parts = following
    assert not parts


def test_dissection_halves_a_chain():
    stages = dissect(moral(continuous(chain(63))), small=1)
    assert stages.count(0) == 1
    assert abs(stages.index(0) - 31) <= 11
    assert min(stages) >= -2 * 6


@orders
def test_long_chains_need_no_recursion(order):
    graph = compiled(continuous(chain(2000)), order)
    assert len(graph) > 1900
    assert graph.is_tree


def test_an_order_given_by_hand_is_taken():
    network = continuous(star(4))
    hub, *leaves = network.variables
    assert compiled(network, [*leaves, hub]).width == 1
    assert compiled(network, [hub, *leaves]).width == 4
    assert compiled(network, iter([hub, *leaves])).width == 4
    assert compiled(network, lambda network: network.variables[::-1]).width == 1
    method = pgm.JunctionTree([hub, *leaves])
    assert method == pgm.JunctionTree((hub, *leaves))
    assert hash(method) == hash(pgm.JunctionTree((hub, *leaves)))


def test_orders_given_by_hand_are_checked():
    network = continuous(star(3))
    a, b, c, d = network.variables
    stranger = pgm.Variable("stranger")
    for order, words, variable in (
        ([a, b, d], r"lacks \(x2\)", c),
        ([a, b, c, d, b], "names x1 twice", b),
        ([a, b, c, c], r"lacks \(x3\)", d),
        ([a, b, c, d, stranger], "holds stranger", stranger),
        (lambda network: network.variables[1:], r"lacks \(x0\)", a),
    ):
        with pytest.raises(pgm.GraphError, match=words) as caught:
            compiled(network, order)
        assert caught.value.variable == variable


@pytest.mark.parametrize("order", [3, None, pgm.MinFill, pgm.Variable("a"), "minfill", ""])
def test_what_is_no_order_is_refused(order):
    with pytest.raises(pgm.GraphError, match=r"no elimination order.*pgm\.WeightedMinFill\(\)"):
        pgm.JunctionTree(order)


@pytest.mark.parametrize("returned", [5, None, "x0 x1", continuous(chain(2))])
def test_a_function_that_returns_no_order_is_refused(returned):
    def order(network):
        return returned

    with pytest.raises(pgm.GraphError, match="where the network's variables were due") as caught:
        compiled(continuous(chain(2)), order)
    assert repr(order) in str(caught.value)
    assert repr(returned) in str(caught.value)


@pytest.mark.parametrize("odd", ["x1", 1, [], None])
def test_what_is_no_variable_has_no_place_in_an_order(odd):
    network = continuous(chain(2))
    with pytest.raises(pgm.GraphError, match="which is no variable"):
        compiled(network, [network.variables[0], odd])


def test_many_variables_that_an_order_lacks_are_not_all_listed():
    network = continuous(chain(700))
    listed = r"\(x1, x2, x3, x4, x5, x6, x7, x8, \.\.\. \(699 in all\)\)"
    with pytest.raises(pgm.GraphError, match=f"lacks {listed};"):
        compiled(network, network.variables[:1])


def test_dissection_takes_numpys_integers():
    assert pgm.NestedDissection(np.int64(3)) == pgm.NestedDissection(3)


@pytest.mark.parametrize("small", [0, -1, 2.5, "3", None, True, np.int64(0)])
def test_dissection_needs_a_number(small):
    with pytest.raises(pgm.GraphError, match="1 or more"):
        pgm.NestedDissection(small)
