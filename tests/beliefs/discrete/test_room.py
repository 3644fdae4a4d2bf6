"""However little memory is given, the results are the same; and no more of it is taken."""

import tracemalloc

import numpy as np
import pytest
from discrete.enumeration import network

import pgm
from models.discrete import asia, xray

RUNS = 400


def drawn(net, runs=RUNS):
    """States of most variables by run, some of them missing, so that most runs differ."""
    rng = np.random.default_rng(0)
    states = net.sample(runs, rng=rng)
    return {v: np.where(rng.random(runs) < 0.4, -1, states[v]) for v in net.variables[::2]}


def wide():
    """Forty variables, each with its three predecessors as parents."""
    rng = np.random.default_rng(0)
    made = [pgm.Discrete(f"v{k}", 3) for k in range(40)]
    cpds = []
    for k, child in enumerate(made):
        given = made[max(0, k - 3) : k]
        table = rng.dirichlet(np.ones(3), size=tuple(v.size for v in given))
        cpds.append(pgm.TableCPD(child, given, table=table))
    return pgm.BayesianNetwork(cpds)


@pytest.mark.parametrize("times", [1, 10, 70, 150])
def test_results_do_not_depend_on_the_memory(times):
    net = network(5, count=9)
    graph = pgm.compile(net)
    evidence = drawn(net)
    memory = 64 * sum(graph.sizes) * times
    whole, parts = pgm.infer(graph, evidence), pgm.infer(graph, evidence, memory=memory)
    for variable in net.variables:
        np.testing.assert_allclose(
            parts[variable].values, whole[variable].values, rtol=0.0, atol=1e-14
        )
    np.testing.assert_allclose(parts.log_evidence, whole.log_evidence, rtol=1e-13, atol=1e-14)
    pair = net.variables[1], net.variables[-1]
    np.testing.assert_allclose(parts.joint(*pair).values, whole.joint(*pair).values, atol=1e-14)
    np.testing.assert_allclose(parts.belief(0).values, whole.belief(0).values, atol=1e-14)
    edge = next(iter(graph.sepsets))
    np.testing.assert_allclose(parts.message(*edge).values, whole.message(*edge).values, rtol=1e-12)
    best = pgm.most_probable(graph, evidence)
    again = pgm.most_probable(graph, evidence, memory=memory)
    assert all(np.array_equal(again.states(v), best.states(v)) for v in net.variables)


def peak(graph, evidence, memory):
    pgm.infer(graph, evidence, memory=memory)  # lays out the passes, once for a graph
    tracemalloc.start()
    posterior = pgm.infer(graph, evidence, memory=memory)
    found = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return found, posterior


def test_no_more_memory_is_taken():
    net = wide()
    graph = pgm.compile(net)
    evidence = drawn(net, 1_500)
    answers = 8 * 1_500 * sum(v.size for v in net.variables)
    found = {memory: peak(graph, evidence, memory)[0] for memory in (2**21, 2**24, 2**27)}
    for memory, taken in found.items():
        assert taken < memory + 2 * answers
    assert found[2**21] < found[2**24] / 2 < found[2**27] / 4


@pytest.mark.parametrize("memory", [0, -1, True, np.nan, np.inf, "1 GiB", 2**20 * 1j])
def test_memory_is_a_number_of_bytes(memory):
    graph = pgm.compile(asia())
    for run in (pgm.infer, pgm.most_probable):
        with pytest.raises(pgm.GraphError, match=r"a number of bytes, such as 2\*\*30, not "):
            run(graph, {}, memory=memory)


def test_memory_for_less_than_a_run_is_refused():
    graph = pgm.compile(asia())
    least = 64 * sum(graph.sizes)
    assert pgm.infer(graph, {xray: [1, -1]}, memory=least).log_evidence.shape == (2,)
    with pytest.raises(pgm.GraphError, match=rf"less than {least:,} bytes, which a single run"):
        pgm.infer(graph, {xray: [1, -1]}, memory=least - 1)


def test_memory_is_for_discrete_trees():
    loopy = pgm.compile(asia(), method=pgm.Bethe())
    with pytest.raises(pgm.GraphError, match="memory= is for two passes over a tree"):
        pgm.infer(loopy, {}, schedule=pgm.Flooding(), memory=2**30)
    x = pgm.Variable("x")
    still = pgm.GaussianCPD(x, mean=0.0, cov=1.0)
    with pytest.raises(pgm.GraphError, match="memory= is for the runs of discrete networks"):
        pgm.infer(pgm.compile(pgm.BayesianNetwork([still])), {}, memory=2**30)
    moving = pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=1.0)
    model = pgm.DynamicBayesianNetwork(prior=[still], transition=[moving], observation=[])
    with pytest.raises(pgm.GraphError, match=r"of a dynamic network keep=\[x\]"):
        pgm.infer(pgm.compile(model, steps=2), {}, memory=2**30)
