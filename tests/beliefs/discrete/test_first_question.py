"""A graph's first question: no plan is made for it, and its answers are those of a plan."""

import numpy as np
import pytest
from discrete.enumeration import Enumeration, network
from hypothesis import given
from hypothesis import strategies as st

import pgm
from models.discrete import asia
from pgm.beliefs.discrete import first_beliefs, first_question, tree_beliefs
from pgm.beliefs.discrete.first_question import answer
from pgm.elimination import tables
from pgm.evidence import bind_discrete

CLOSE = {"rtol": 0.0, "atol": 1e-13}


FIRST = first_beliefs._first  # as it is before the folder's fixture replaces it


@pytest.fixture(autouse=True)
def _first(monkeypatch):
    """Undo what the folder's fixture does: these tests tell first from later questions."""
    monkeypatch.setattr(first_beliefs, "_first", FIRST)


def bound(net, evidence):
    return bind_discrete(net.variables, evidence)


@pytest.mark.parametrize("tiny", [0, first_question.TINY])
@pytest.mark.parametrize("long", [1, tables.LONG])
@pytest.mark.parametrize("seed", range(25))
def test_against_the_table_of_all_assignments(seed, long, tiny, monkeypatch):
    monkeypatch.setattr(tables, "LONG", long)
    monkeypatch.setattr(first_question, "TINY", tiny)
    rng = np.random.default_rng([seed, 7])
    net = network(seed, count=3 + seed % 7, zeros=0.2 * (seed % 2), deterministic=0.1 * (seed % 3))
    drawn = net.sample(rng=rng)  # so that it is possible
    states = {v: int(drawn[v]) for v in net.variables if rng.random() < 0.3}
    weights = {v: 0.1 + rng.random(v.size) for v in net.variables if rng.random() < 0.2}
    weights = {v: given for v, given in weights.items() if v not in states}
    truth = Enumeration(net, states, weights)
    soft = {v: pgm.soft(given) for v, given in weights.items()}
    found = answer(pgm.compile(net), bound(net, states | soft))
    assert found is not None
    np.testing.assert_allclose(found.log_evidence, np.log(truth.evidence), **CLOSE)
    assert set(found.marginals) == set(net.variables) - set(states)
    for variable, values in found.marginals.items():
        np.testing.assert_allclose(values, truth.marginal(variable), **CLOSE)
        assert not values.flags.writeable


@given(st.integers(0, 1000), st.sampled_from([pgm.MinFill(), pgm.NestedDissection(small=1)]))
def test_any_tree_of_a_network_has_the_same_answer(seed, order):
    net = network(seed, count=9, parents=2, before=4)
    evidence = {net.variables[-1]: 0}
    graph = pgm.compile(net, method=pgm.JunctionTree(order))
    one, other = (answer(g, bound(net, evidence)) for g in (graph, pgm.compile(net)))
    assert one.log_evidence == pytest.approx(other.log_evidence, abs=1e-13)
    for variable, values in one.marginals.items():
        np.testing.assert_allclose(values, other.marginals[variable], **CLOSE)


def test_a_cluster_without_cpds_and_a_variable_that_only_its_parent_knows(monkeypatch):
    monkeypatch.setattr(first_question, "TINY", 0)
    a, b, c = (pgm.Discrete(name, 3) for name in "abc")
    rng = np.random.default_rng(0)
    cpds = [
        pgm.TableCPD(a, table=rng.dirichlet(np.ones(3))),
        pgm.TableCPD(b, (a,), table=rng.dirichlet(np.ones(3), 3)),
        pgm.TableCPD(c, (b,), table=rng.dirichlet(np.ones(3), 3)),
    ]
    net = pgm.BayesianNetwork(cpds)
    for clusters in ([{a, b, c}, {a, b}, {b, c}], [{a, b}, {a, b, c}, {b, c}, {a, b, c}, {a}]):
        graph = pgm.ClusterGraph(net, clusters)
        found = answer(graph, bound(net, {c: 1}))
        truth = Enumeration(net, {c: 1})
        for variable, values in found.marginals.items():
            np.testing.assert_allclose(values, truth.marginal(variable), **CLOSE)


def test_only_the_second_question_makes_a_plan(monkeypatch):
    made = []
    plan_for = tree_beliefs.plan_for
    monkeypatch.setattr(tree_beliefs, "plan_for", lambda *of: made.append(of) or plan_for(*of))
    net = asia()
    graph, other = pgm.compile(net), pgm.compile(net)
    evidence = {net.variables[0]: 1}
    hidden = net.variables[1:]
    first = pgm.infer(graph, evidence)
    values = [first[v].values for v in hidden]
    log_evidence = first.log_evidence
    assert not made
    second = pgm.infer(graph, evidence)
    assert len(made) == 1
    for variable, due in zip(hidden, values, strict=True):
        np.testing.assert_allclose(second[variable].values, due, **CLOSE)
    np.testing.assert_allclose(second.log_evidence, log_evidence, **CLOSE)
    pgm.infer(other, evidence)
    assert len(made) == 1  # another graph, whose first question this is


def test_all_else_is_read_from_a_plan():
    net = asia()
    graph = pgm.compile(net)
    evidence = {net.variables[0]: 1}
    first, second = pgm.infer(graph, evidence), pgm.infer(graph, evidence)
    wanted = net.variables[1], net.variables[-1]
    np.testing.assert_allclose(first.joint(*wanted).values, second.joint(*wanted).values, **CLOSE)
    for i, j in graph.sepsets:
        one, other = first.message(i, j), second.message(i, j)
        np.testing.assert_allclose(one.values, other.values, **CLOSE)
        np.testing.assert_allclose(one.log_scale, other.log_scale, **CLOSE)
    for k in range(len(graph)):
        np.testing.assert_allclose(first.belief(k).values, second.belief(k).values, **CLOSE)


def test_batches_are_never_first_questions():
    net = asia()
    evidence = {net.variables[0]: np.array([0, 1])}
    posterior = pgm.infer(pgm.compile(net), evidence)
    assert isinstance(posterior._outcome._beliefs, tree_beliefs.TreeBeliefs)
    one = {net.variables[0]: np.array([1])}
    assert pgm.infer(pgm.compile(net), one)[net.variables[1]].values.shape == (1, 2)


def test_what_numbers_do_not_hold_is_left_to_logarithms():
    count = 400
    x = [pgm.Discrete(f"x{k}", 2) for k in range(count)]
    rare = [[1.0 - 1e-3, 1e-3], [1.0 - 1e-3, 1e-3]]
    cpds = [pgm.TableCPD(x[0], table=rare[0])]
    cpds += [pgm.TableCPD(x[k], (x[k - 1],), table=rare) for k in range(1, count)]
    net = pgm.BayesianNetwork(cpds)
    graph = pgm.compile(net)
    evidence = dict.fromkeys(x[:-1], 1)
    assert answer(graph, bound(net, evidence)) is None
    posterior = pgm.infer(graph, evidence)
    np.testing.assert_allclose(posterior.log_evidence, (count - 1) * np.log(1e-3), rtol=1e-13)
    np.testing.assert_allclose(posterior[x[-1]].values, rare[0], rtol=1e-13)


@pytest.mark.parametrize("tiny", [0, first_question.TINY])
def test_impossible_evidence_is_refused_by_name(tiny, monkeypatch):
    monkeypatch.setattr(first_question, "TINY", tiny)
    net = asia()
    named = {v.name: v for v in net.variables}
    evidence = {named["either"]: "no", named["cancer"]: "yes"}
    assert answer(pgm.compile(net), bound(net, evidence)) is None
    with pytest.raises(pgm.EvidenceError, match="probability zero"):
        pgm.infer(pgm.compile(net), evidence)


def test_everything_observed():
    net = asia()
    evidence = dict.fromkeys(net.variables, 0)
    truth = Enumeration(net, evidence)
    found = answer(pgm.compile(net), bound(net, evidence))
    assert not found.marginals
    np.testing.assert_allclose(found.log_evidence, np.log(truth.evidence), **CLOSE)
