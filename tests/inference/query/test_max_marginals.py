"""The best assignment with each state of each variable, against the table of all assignments."""

import copy
import pickle

import numpy as np
import pytest
from discrete.enumeration import Enumeration, network
from discrete.test_trees import evidence, question
from numpy.testing import assert_allclose

import pgm
from pgm.beliefs.discrete import storage, tree_plan
from pgm.examples import pair, rain, rainy, side, still, wet


def drawn(rng):
    """A Markov network with zeros, loops and parts of its own, and evidence of runs."""
    count = int(rng.integers(1, 7))
    variables = [pgm.Discrete(f"v{k}", int(rng.integers(1, 4))) for k in range(count)]
    factors = [pgm.Table.vacuous(v) for v in variables]
    for _ in range(rng.integers(0, 7)):
        size = min(count, int(rng.integers(0, 4)))
        scope = [variables[k] for k in rng.choice(count, size, replace=False)]
        shape = [v.size for v in scope]
        values = rng.exponential(size=shape) * (rng.random(shape) > 0.15)
        factors.append(pgm.Table(scope, values, 100.0 * rng.normal()))
    runs = int(rng.integers(1, 4))
    states, weights = {}, {}
    for v in variables:
        chance = rng.random()
        if chance < 0.3:
            states[v] = rng.integers(-1, v.size, runs)
        elif chance < 0.4:
            weights[v] = rng.random((runs, v.size)) + 0.01
    return pgm.MarkovNetwork(factors), runs, states, weights


def logs(net, run, states, weights):
    """The logarithms of all products, with the evidence of a run, by the network's variables."""
    found = np.zeros([v.size for v in net.variables])

    def add(scope, values):
        axes = [net.variables.index(v) for v in scope]
        order = np.argsort(axes)
        shape = [v.size if k in axes else 1 for k, v in enumerate(net.variables)]
        return np.transpose(values, order).reshape(shape)

    with np.errstate(divide="ignore"):
        for factor in net.factors:
            found = found + add(factor.scope, np.log(factor.values) + factor.log_scale)
        for v, own in weights.items():
            found = found + add((v,), np.log(own[run]))
        for v, own in states.items():
            if own[run] >= 0:
                found = found + add((v,), np.log(np.eye(v.size)[own[run]]))
    return found


@pytest.mark.parametrize("seed", range(150))
def test_drawn_networks(seed):
    net, runs, states, weights = drawn(np.random.default_rng(seed))
    given = states | {v: pgm.soft(own) for v, own in weights.items()}
    due = [logs(net, run, states, weights) for run in range(runs)]
    graph = pgm.compile(net)
    if any(table.max() == -np.inf for table in due):
        with pytest.raises(pgm.EvidenceError):
            pgm.max_marginals(graph, given)
        return
    found = pgm.max_marginals(graph, given)
    best = pgm.most_probable(graph, given)
    assert found.variables == net.variables
    assert_allclose(found.log_maximum, best.log_probability, rtol=1e-13, atol=1e-12)
    lead = found.log_maximum.shape
    for k, v in enumerate(net.variables):
        others = tuple(j for j in range(len(net.variables)) if j != k)
        own = found.log_values(v)
        assert own.shape == (*lead, v.size)
        assert not own.flags.writeable
        for run, table in enumerate(due[: max(found.log_maximum.size, 1)]):
            assert_allclose(own.reshape(-1, v.size)[run], table.max(axis=others), atol=1e-10)


@pytest.mark.parametrize("least", [2**16, 1])
@pytest.mark.parametrize("seed", range(12))
def test_networks_of_cpds(seed, least, monkeypatch):
    for module in (tree_plan, storage):
        monkeypatch.setattr(module, "LARGE", least)
    net = network(seed, count=4 + seed % 6, zeros=0.1, deterministic=0.1)
    states, weights = question(net, seed)
    truth = Enumeration(net, states, weights)
    if truth.evidence == 0.0:
        pytest.skip("impossible")
    found = pgm.max_marginals(pgm.compile(net), evidence(states, weights))
    for k, v in enumerate(truth.variables):
        others = tuple(j for j in range(len(truth.variables)) if j != k)
        assert_allclose(np.exp(found.log_values(v)), truth.table.max(axis=others), rtol=1e-12)
        table = found[v]
        assert table.values.max() == 1.0
        assert_allclose(table.log_values, found.log_values(v), atol=1e-13)


@pytest.mark.parametrize("method", [pgm.JunctionTree(), pgm.Bethe()])
def test_a_batch_equals_its_runs(method):
    """Also where runs are worked through in parts, and where the graph is a Bethe tree."""
    seen = [0, 1, -1, 1] * 40
    graph = pgm.compile(rainy, method=method)
    whole = pgm.max_marginals(graph, {wet: seen})
    small = pgm.max_marginals(graph, {wet: pgm.soft(np.eye(2)[np.abs(seen)])}, memory=2**15)
    for run, state in enumerate(seen):
        single = pgm.max_marginals(graph, {wet: state})
        assert_allclose(whole.log_values(rain)[run], single.log_values(rain), rtol=1e-15)
        if state >= 0:
            assert_allclose(small.log_values(rain)[run], single.log_values(rain), rtol=1e-15)
    assert whole[rain].values.shape == (160, 2)


def test_a_chain_of_a_thousand_whose_states_lie_far_apart():
    """Logarithms tell what numbers cannot; the table refuses to be zero where it is not."""
    count = 1000
    states = [pgm.Discrete(f"s{k}", 2) for k in range(count)]
    rng = np.random.default_rng(0)
    tables = rng.dirichlet([0.3, 0.3], size=(count - 1, 2))
    links = zip(states, states[1:], tables, strict=False)
    net = pgm.MarkovNetwork(
        [pgm.Table((one, other), own) for one, other, own in links]
        + [pgm.Table(v, [1.0, 0.3]) for v in states]
        + [pgm.Table(states[0], [1.0, 1e-290])] * 3
    )
    found = pgm.max_marginals(pgm.compile(net), {})
    # Forth and back, as lists.
    single = np.log([1.0, 0.3])
    ahead = [single + 3 * np.log([1.0, 1e-290])]
    for own in tables:
        ahead.append((ahead[-1][:, None] + np.log(own)).max(axis=0) + single)
    behind = np.zeros(2)
    for k in range(count - 1, -1, -1):
        assert_allclose(found.log_values(states[k]), ahead[k] + behind, rtol=1e-13)
        if k:
            behind = (np.log(tables[k - 1]) + single + behind).max(axis=1)
    with pytest.raises(pgm.NumericalError, match=r"max-marginal of s0 .*log_values\(s0\)"):
        found[states[0]]
    assert found[states[500]].log_scale == found.log_values(states[500]).max()


def test_a_forest_and_variables_of_one_state():
    one = pgm.Discrete("one", 1)
    net = pgm.MarkovNetwork([pgm.Table(one, [2.0]), pgm.Table(rain, [3.0, 0.0]), pgm.Table((), 5)])
    found = pgm.max_marginals(pgm.compile(net), {})
    assert_allclose(found.log_maximum, np.log(30.0))
    assert_allclose(found.log_values(one), [np.log(30.0)])
    assert found.log_values(rain)[1] == -np.inf
    assert found[rain].values.tolist() == [1.0, 0.0]


def test_it_is_a_value():
    found = pgm.max_marginals(pgm.compile(rainy), {wet: "yes"})
    for twin in (copy.deepcopy(found), pickle.loads(pickle.dumps(found))):
        assert twin.log_values(rain).tolist() == found.log_values(rain).tolist()
    with pytest.raises(AttributeError):
        found.log_maximum = 0.0
    with pytest.raises(TypeError):
        list(found)
    assert repr(found).splitlines()[0].startswith("MaxMarginals(2 variables; ln of the maximum")


def test_what_is_refused():
    graph = pgm.compile(rainy)
    with pytest.raises(pgm.GraphError, match="takes a cluster graph"):
        pgm.max_marginals(rainy, {})
    with pytest.raises(pgm.GraphError, match=r"in proportion to their marginals"):
        pgm.max_marginals(pgm.compile(pair), {})
    with pytest.raises(pgm.GraphError, match=r"has time; .*unroll"):
        pgm.max_marginals(pgm.compile(still, steps=2), {wet: [1, 1]})
    ring = [pgm.Discrete(name, 2) for name in "abc"]
    loop = pgm.MarkovNetwork([pgm.Table((ring[k - 1], ring[k]), np.ones((2, 2))) for k in range(3)])
    with pytest.raises(pgm.GraphError, match="has loops, and max_marginals is for trees"):
        pgm.max_marginals(pgm.compile(loop, method=pgm.Bethe()), {})
    with pytest.raises(pgm.EvidenceError, match="evidence maps variables to states; found list"):
        pgm.max_marginals(graph, [wet])
    with pytest.raises(pgm.EvidenceError, match="evidence for side, which the network does not"):
        pgm.max_marginals(graph, {side: 0})
    with pytest.raises(pgm.EvidenceError, match="side has no max-marginal"):
        pgm.max_marginals(graph, {})[side]
    with pytest.raises(pgm.EvidenceError, match="by variable, not by 'rain'"):
        pgm.max_marginals(graph, {})["rain"]
    sure = pgm.BayesianNetwork(
        [pgm.TableCPD(rain, table=[1, 0]), pgm.TableCPD(wet, rain, table=[[1, 0], [0, 1]])]
    )
    with pytest.raises(pgm.EvidenceError, match="probability zero"):
        pgm.max_marginals(pgm.compile(sure), {wet: [0, 1]})
