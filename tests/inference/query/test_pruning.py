"""What bears on a query: barren and separated parts are left out, counted by tables and CPDs."""

import dags
import networkx as nx
import numpy as np
import pytest
from discrete.enumeration import network
from hypothesis import given
from hypothesis import strategies as st

import pgm
from pgm.elimination import orders
from pgm.evidence.static import bind_discrete
from pgm.inference.query.plan import QueryPlan
from pgm.inference.query.requisite import Requisite


def requisite(net, wanted, evidence=None):
    return Requisite.of(net, wanted, bind_discrete(net.variables, evidence or {}))


def names(part):
    return {repr(cpd.child) for cpd in part.factors}


def chain(count):
    return dags.discrete(dags.chain(count))


def test_barren_variables_are_left_out():
    net = chain(10)
    v = net.variables
    assert names(requisite(net, v[3:4])) == {"x0", "x1", "x2", "x3"}
    assert names(requisite(net, v[3:4], {v[5]: 0})) == {f"x{k}" for k in range(6)}


def test_what_evidence_separates_is_left_out():
    net = chain(10)
    v = net.variables
    part = requisite(net, v[4:5], {v[2]: 0, v[3]: 1, v[7]: 0, v[9]: 1})
    assert names(part) == {"x4", "x5", "x6", "x7"}
    assert set(part.hidden) == set(v[4:7])
    assert set(part.evidence.states) == {v[3], v[7]}
    # Evidence in some runs alone, or soft, separates nothing.
    for weak in ([0, -1], pgm.soft([1.0, 2.0])):
        assert names(requisite(net, v[4:5], {v[3]: weak})) == {f"x{k}" for k in range(5)}
    assert names(requisite(net, v[4:5], {v[3]: [0, 1]})) == {"x4"}


def test_causes_are_joined_by_what_they_explain():
    net = dags.discrete([[], [], [0, 1], [2], []])
    v = net.variables
    assert names(requisite(net, v[:1])) == {"x0"}
    assert names(requisite(net, v[:1], {v[1]: 0})) == {"x0"}
    assert names(requisite(net, v[:1], {v[1]: 0, v[2]: 0})) == {"x0", "x2"}
    assert names(requisite(net, v[:1], {v[3]: 0})) == {"x0", "x1", "x2", "x3"}


def test_variables_of_one_state_are_known():
    net = dags.discrete(dags.chain(5), [2, 2, 1, 2, 2])
    v = net.variables
    assert names(requisite(net, v[3:4], {v[0]: 0, v[4]: 1})) == {"x3", "x4"}
    np.testing.assert_array_equal(pgm.query(net, v[2]).values, [1.0])
    assert pgm.query(net, (v[2], v[3])).values.shape == (1, 2)
    assert pgm.query(net, (v[3], v[2]), {v[4]: [0, 1, 0]}).values.shape == (3, 2, 1)


@given(dags.shapes(most=10), st.data())
def test_it_is_what_is_not_d_separated(parents, data):
    net = dags.discrete(parents)
    variables = list(net.variables)
    observed = data.draw(st.sets(st.sampled_from(variables), max_size=len(variables) - 1))
    hidden = [v for v in variables if v not in observed]
    wanted = data.draw(st.sampled_from(hidden))
    part = requisite(net, (wanted,), dict.fromkeys(observed, 0))
    graph = net.to_networkx()
    above = set().union(*({v} | nx.ancestors(graph, v) for v in (wanted, *observed)))
    bears = {v for v in hidden if v != wanted and not net.separated(wanted, v, observed)}
    assert set(part.hidden) == {wanted} | (bears & above)
    for v in observed:
        if not net.separated(wanted, v, observed - {v}):
            assert v in part.evidence.states


def test_a_part_of_a_network_whose_junction_tree_is_too_large():
    side = 40
    rng = np.random.default_rng(0)
    grid = dags.grid(side)
    variables = [pgm.Discrete(f"x{k}", 2) for k in range(side * side)]
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(
                v, [variables[p] for p in places], table=rng.dirichlet([1, 1], [2] * len(places))
            )
            for v, places in zip(variables, grid, strict=True)
        ]
    )
    graph = pgm.compile(net, method=pgm.JunctionTree(order=pgm.MinFill()))
    with pytest.raises(pgm.GraphError, match="too large"):
        pgm.infer(graph, {})
    inside = [r * side + c for r in range(4) for c in range(4)]
    corner = pgm.BayesianNetwork([net.cpd(variables[k]) for k in inside])
    wanted, evidence = (variables[3], variables[2 * side]), {variables[3 * side + 3]: 1}
    due = pgm.infer(pgm.compile(corner), evidence).joint(*wanted).values
    for source in (net, graph):
        np.testing.assert_allclose(pgm.query(source, wanted, evidence).values, due, atol=1e-12)
    part = requisite(net, wanted, evidence)
    assert len(part.factors) == 16
    assert max(QueryPlan.of(part, wanted).sums.products) <= 2**6
    with pytest.raises(pgm.GraphError, match=r"tables that are too large: .* GiB at a time"):
        pgm.query(net, variables[-1])


def test_tables_are_no_larger_than_the_order_needs():
    net = chain(200)
    v = net.variables
    plan = QueryPlan.of(requisite(net, (v[0], v[-1])), (v[0], v[-1]))
    assert max(plan.sums.products) == 2**3
    assert plan.sums.peak < 50
    star = dags.discrete(dags.star(50))
    centre, *leaves = star.variables
    part = requisite(star, (centre,), dict.fromkeys(leaves, 0))
    plan = QueryPlan.of(part, (centre,))
    assert plan.sums.products == [2]
    # Where variables differ in size, the better of two orders is taken.
    wide = network(3, count=60, largest=8, before=6)
    last = wide.variables[-1:]
    part = requisite(wide, last)
    sizes = [v.size for v in part.hidden]
    place = {v: k for k, v in enumerate(part.hidden)}
    scopes = [tuple(place[v] for v in scope) for scope in part.open]
    adjacent = [{k for f in scopes if p in f for k in f} - {p} for p in range(len(sizes))]
    asked = [place[v] for v in last]
    costs = [
        orders._ordered(scopes, adjacent, sizes, weights, asked)[1].cost
        for weights in (sizes, [1] * len(sizes))
    ]
    assert QueryPlan.of(part, last).sums.cost == min(costs)
