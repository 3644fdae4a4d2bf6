"""Calibrated trees against the table of all assignments."""

import numpy as np
import pytest
from discrete.enumeration import Enumeration, network

import pgm
from models.discrete import asia, cancer, rain, sprinkler, wet, xray
from pgm.beliefs.discrete import storage, tree_passes, tree_plan
from pgm.evidence import bind_discrete

CLOSE = {"rtol": 0.0, "atol": 1e-12}


def question(net, seed, hard=0.25, soft=0.15):
    """Draw evidence: states of some variables, weights of others."""
    rng = np.random.default_rng([seed, 1])
    states, weights = {}, {}
    for variable in net.variables:
        draw = rng.random()
        if draw < hard:
            states[variable] = int(rng.integers(variable.size))
        elif draw < hard + soft:
            weights[variable] = rng.random(variable.size)
    return states, weights


def evidence(states, weights):
    return states | {variable: pgm.soft(given) for variable, given in weights.items()}


def check(net, graph, seed):
    """Compare all answers with the enumeration's; say whether the evidence was possible."""
    states, weights = question(net, seed)
    truth = Enumeration(net, states, weights)
    if truth.evidence == 0.0:
        with pytest.raises(pgm.EvidenceError, match="probability zero"):
            pgm.infer(graph, evidence(states, weights))
        return False
    posterior = pgm.infer(graph, evidence(states, weights))
    np.testing.assert_allclose(posterior.log_evidence, np.log(truth.evidence), **CLOSE)
    hidden = [v for v in net.variables if v not in states]
    for variable in hidden:
        np.testing.assert_allclose(posterior[variable].values, truth.marginal(variable), **CLOSE)
        assert posterior[variable].log_scale == 0.0
    rng = np.random.default_rng([seed, 2])
    for count in (2, 3):
        if len(hidden) >= count:
            wanted = [hidden[k] for k in rng.choice(len(hidden), count, replace=False)]
            joint = posterior.joint(*wanted)
            assert joint.scope == tuple(wanted)
            np.testing.assert_allclose(joint.values, truth.marginal(*wanted), **CLOSE)
    return True


@pytest.mark.parametrize("seed", range(30))
def test_random_networks(seed):
    net = network(seed, count=4 + seed % 6)
    assert check(net, pgm.compile(net), seed)


@pytest.mark.parametrize("seed", range(40))
def test_networks_with_zeros_and_certainties(seed):
    net = network(100 + seed, zeros=0.2, deterministic=0.2)
    check(net, pgm.compile(net), seed)


def test_some_of_those_have_impossible_evidence_and_most_have_not():
    found = []
    for seed in range(40):
        net = network(100 + seed, zeros=0.2, deterministic=0.2)
        found.append(Enumeration(net, *question(net, seed)).evidence > 0.0)
    assert 20 < sum(found) < 40


@pytest.mark.parametrize("seed", range(10))
def test_forests_of_unconnected_networks(seed):
    net = network(200 + seed, parents=1)
    graph = pgm.compile(net)
    assert len(graph.sepsets) < len(graph) or len(graph) == 1
    assert check(net, graph, seed)


@pytest.mark.parametrize("seed", range(10))
def test_graphs_made_by_hand(seed):
    net = network(300 + seed, count=7, parents=2, before=2)
    v = sorted(net.variables, key=lambda variable: variable.name)
    graph = pgm.ClusterGraph(net, [set(v[k : k + 4]) for k in range(4)])
    assert check(net, graph, seed)


def test_a_sepset_that_shares_nothing():
    net = network(3, count=4, parents=1)
    v = net.variables
    single = pgm.BayesianNetwork(
        [pgm.TableCPD(each, table=np.full(each.size, 1 / each.size)) for each in v]
    )
    graph = pgm.ClusterGraph(single, [{v[0], v[1]}, {v[2]}, {v[3]}], {(0, 1): set(), (1, 2): set()})
    assert check(single, graph, 0)


@pytest.mark.parametrize("least", [1, 8])
@pytest.mark.parametrize("seed", range(12))
def test_tables_that_are_used_where_they_stand(seed, least, monkeypatch):
    """What large tables take, on small ones."""
    for module in (tree_plan, storage):
        monkeypatch.setattr(module, "LARGE", least)
    net = network(400 + seed, count=9)
    assert check(net, pgm.compile(net), seed)


@pytest.mark.parametrize("zeros", [0.0, 0.2])
@pytest.mark.parametrize("held", [0, 2**26])
@pytest.mark.parametrize("seed", range(12))
def test_potentials_that_are_made_again_and_tables_that_are_entered_apart(
    seed, held, zeros, monkeypatch
):
    """What the largest graphs take, and larger ones, on small ones."""
    monkeypatch.setattr(tree_passes, "HELD", held)
    monkeypatch.setattr(tree_passes, "SMALL", 0)
    net = network(500 + seed, count=9, zeros=zeros, deterministic=zeros)
    graph = pgm.compile(net)
    for again in range(3):
        check(net, graph, seed + again)


def test_without_evidence_only_the_roots_are_active():
    net = network(8, count=10)
    plan = tree_plan.plan_for(pgm.compile(net), 1, 2**22)
    everywhere = bind_discrete(net.variables, dict.fromkeys(net.variables, 0))
    assert plan.above(everywhere) == plan.everything
    roots = [stack.bit for stack in plan.stacks if stack.down is None]
    assert plan.above(bind_discrete(net.variables, {})) == sum(roots) < plan.everything


def test_columns_that_were_rounded_count_in_the_evidence():
    a, b = pgm.Discrete("a", 2), pgm.Discrete("b", 2)
    table = np.array([[0.3, 0.7], [0.9, 0.1]]) * (1 + 3e-10)
    net = pgm.BayesianNetwork([pgm.TableCPD(a, table=[0.4, 0.6]), pgm.TableCPD(b, a, table=table)])
    found = pgm.infer(pgm.compile(net), {}).log_evidence
    np.testing.assert_allclose(found, np.log(np.array([0.4, 0.6]) @ table.sum(axis=1)), atol=1e-15)


def test_a_large_table():
    net = network(7, count=18, largest=2, parents=3)
    names = [v for v in net.variables if v.size == 2]
    graph = pgm.ClusterGraph(net, [set(net.variables)])
    tree = pgm.infer(pgm.compile(net), {names[3]: 1})
    whole = pgm.infer(graph, {names[3]: 1})
    for variable in net.variables:
        if variable != names[3]:
            np.testing.assert_allclose(whole[variable].values, tree[variable].values, **CLOSE)


def test_variables_of_one_state():
    a, b, c = pgm.Discrete("a", 1), pgm.Discrete("b", 1), pgm.Discrete("c", 2)
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(a, table=[1.0]),
            pgm.TableCPD(b, a, table=[[1.0]]),
            pgm.TableCPD(c, b, table=[[0.3, 0.7]]),
        ]
    )
    posterior = pgm.infer(pgm.compile(net), {a: 0})
    assert posterior[b].values.tolist() == [1.0]
    np.testing.assert_allclose(posterior[c].values, [0.3, 0.7], **CLOSE)
    assert posterior.log_evidence == 0.0


def test_textbook_numbers():
    grass = pgm.infer(pgm.compile(sprinkler()), {wet: "yes"})
    assert float(grass[rain]["yes"]) == pytest.approx(0.7079, abs=5e-5)
    clinic = pgm.infer(pgm.compile(asia()), {xray: "yes"})
    truth = Enumeration(asia(), {xray: 1})
    np.testing.assert_allclose(clinic[cancer].values, truth.marginal(cancer), **CLOSE)


def test_what_a_posterior_says_of_itself():
    graph = pgm.compile(sprinkler())
    posterior = pgm.infer(graph, {wet: "yes"}, schedule=pgm.Calibration())
    assert posterior.graph is graph
    assert posterior.log_evidence_kind == "exact"
    assert posterior.status.iterations == 1
    assert posterior.status.converged.all()
    assert repr(posterior).startswith("Posterior(ClusterGraph(")
