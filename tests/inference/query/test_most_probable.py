"""The most probable assignment against the largest entry of the table of all assignments."""

import copy
import itertools
import pickle

import numpy as np
import pytest
from discrete.enumeration import Enumeration, network
from discrete.test_batches import batch, one
from discrete.test_trees import evidence, question

import pgm
from models.discrete import asia, dyspnoea, smoking, xray
from pgm.beliefs.discrete import storage, tree_plan


@pytest.mark.parametrize("least", [2**16, 1])
@pytest.mark.parametrize("seed", range(25))
def test_it_attains_the_largest_probability(seed, least, monkeypatch):
    for module in (tree_plan, storage):
        monkeypatch.setattr(module, "LARGE", least)
    net = network(seed, count=4 + seed % 6, zeros=0.1, deterministic=0.1)
    states, weights = question(net, seed)
    truth = Enumeration(net, states, weights)
    graph = pgm.compile(net)
    if truth.evidence == 0.0:
        with pytest.raises(pgm.EvidenceError, match="probability zero"):
            pgm.most_probable(graph, evidence(states, weights))
        return
    found = pgm.most_probable(graph, evidence(states, weights))
    assert list(found.assignment) == list(net.variables)
    assert all(found.assignment[v] == v.states[s] for v, s in states.items())
    assert truth.value(found.assignment) == pytest.approx(truth.table.max(), rel=1e-12)
    assert float(found.log_probability) == pytest.approx(np.log(truth.table.max()), abs=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_a_batch_equals_its_runs(seed):
    net = network(seed, count=7)
    graph = pgm.compile(net)
    given = batch(net, seed)
    whole = pgm.most_probable(graph, given)
    assert whole.log_probability.shape == (5,)
    for run in range(5):
        single = pgm.most_probable(graph, one(given, run))
        assert whole.log_probability[run] == single.log_probability
        for variable in net.variables:
            assert variable.states[whole.assignment[variable][run]] == single.assignment[variable]


def test_the_first_of_equals():
    variables = [pgm.Discrete(f"v{k}", 3) for k in range(4)]
    chain = [pgm.TableCPD(variables[0], table=np.full(3, 1 / 3))]
    for before, after in itertools.pairwise(variables):
        chain.append(pgm.TableCPD(after, before, table=np.full((3, 3), 1 / 3)))
    found = pgm.most_probable(pgm.compile(pgm.BayesianNetwork(chain)), {variables[2]: "2"})
    assert list(found.assignment.values()) == ["0", "0", "2", "0"]


def test_a_chain_against_viterbi():
    rng = np.random.default_rng(2)
    count, size = 300, 6
    step = rng.dirichlet(np.full(size, 0.5), size)
    sensor = rng.dirichlet(np.full(size, 0.3), size)
    states = [pgm.Discrete(f"x{t}", size) for t in range(count)]
    readings = [pgm.Discrete(f"z{t}", size) for t in range(count)]
    cpds = [pgm.TableCPD(states[0], table=step[0])]
    cpds += [pgm.TableCPD(b, a, table=step) for a, b in itertools.pairwise(states)]
    cpds += [pgm.TableCPD(z, x, table=sensor) for x, z in zip(states, readings, strict=True)]
    seen = rng.integers(size, size=count)
    found = pgm.most_probable(
        pgm.compile(pgm.BayesianNetwork(cpds)), dict(zip(readings, map(int, seen), strict=True))
    )
    score, back = np.log(step[0]) + np.log(sensor[:, seen[0]]), []
    for z in seen[1:]:
        every = score[:, None] + np.log(step)
        back.append(every.argmax(axis=0))
        score = every.max(axis=0) + np.log(sensor[:, z])
    path = [int(score.argmax())]
    for pointers in reversed(back):
        path.append(int(pointers[path[-1]]))
    assert [int(found.assignment[x]) for x in states] == path[::-1]
    assert float(found.log_probability) == pytest.approx(score.max(), rel=1e-12)


def test_it_is_a_value():
    found = pgm.most_probable(pgm.compile(asia()), {xray: "yes"})
    for twin in (copy.deepcopy(found), pickle.loads(pickle.dumps(found))):
        assert dict(twin.assignment) == dict(found.assignment)
    with pytest.raises(TypeError):
        found.assignment[smoking] = "no"
    with pytest.raises(AttributeError):
        found.assignment = {}
    with pytest.raises(ValueError, match="read-only"):
        found.log_probability[...] = 0.0


def test_names_of_a_batch():
    found = pgm.most_probable(pgm.compile(asia()), {dyspnoea: [["no", "yes"]]})
    assert found.assignment[dyspnoea].tolist() == [[0, 1]]
    for variable in asia().variables:
        assert found.states(variable).shape == (1, 2)
        for run in range(2):
            single = pgm.most_probable(pgm.compile(asia()), {dyspnoea: run})
            assert found.states(variable)[0, run] == single.states(variable)
            assert single.states(variable) == single.assignment[variable]
    assert repr(found).splitlines()[0] == "MostProbable(8 variables, runs (1, 2))"
    with pytest.raises(pgm.EvidenceError, match=r"stranger is not in the assignment; .*dyspnoea"):
        found.states(pgm.Discrete("stranger", 2))
    with pytest.raises(pgm.EvidenceError, match="by variable, not by 'xray'"):
        found.states("xray")


def test_reprs():
    few = pgm.most_probable(pgm.compile(asia()), {xray: "yes"})
    assert repr(few).startswith("MostProbable(")
    assert "xray yes" in repr(few)
    assert repr(few).endswith(f"; ln p {float(few.log_probability):.6g})")
    many = network(0, count=12)
    found = pgm.most_probable(pgm.compile(many), {})
    assert repr(found).count(", ") == 10
    assert "... 12 variables; ln p" in repr(found)


def test_errors():
    net = asia()
    with pytest.raises(pgm.GraphError, match=r"has loops, and most_probable is for trees"):
        pgm.most_probable(pgm.compile(net, method=pgm.Bethe()), {})
    with pytest.raises(pgm.GraphError, match="takes a cluster graph"):
        pgm.most_probable(net, {})
    with pytest.raises(pgm.EvidenceError, match="maps variables to states; found list"):
        pgm.most_probable(pgm.compile(net), [])
    a = pgm.Variable("a")
    continuous = pgm.BayesianNetwork([pgm.GaussianCPD(a, 0.0, 1.0)])
    with pytest.raises(pgm.GraphError, match=r"continuous .* most probable values are the means"):
        pgm.most_probable(pgm.compile(continuous), {})
    moving = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(a, given={a.previous: 1.0}, cov=1.0)],
        observation=[],
    )
    with pytest.raises(pgm.GraphError, match="continuous"):
        pgm.most_probable(pgm.compile(moving, steps=2), {})
