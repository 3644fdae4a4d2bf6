"""Messages and beliefs of trees against their definition, unnormalised."""

import numpy as np
import pytest
from discrete.enumeration import Enumeration, network
from discrete.test_trees import evidence, question

import pgm


def plain(net, states, weights, cluster):
    """A cluster's potential times evidence, as an array over its whole scope."""
    axis = {v: k for k, v in enumerate(cluster.scope)}
    table = np.ones([v.size for v in cluster.scope])
    factors = [((*cpd.given, cpd.child), cpd.table) for cpd in cluster.cpds]
    factors += [((v,), np.eye(v.size)[s]) for v, s in states.items() if v in axis]
    for variable, given in weights.items():
        graph_home = min((c for c in net if variable in c.scope), key=lambda c: (c.size, c.index))
        if graph_home == cluster:
            factors.append(((variable,), given))
    for scope, factor in factors:
        table = np.einsum(
            table, range(table.ndim), factor, [axis[v] for v in scope], range(table.ndim)
        )
    return table


def message(graph, states, weights, i, j):
    """Sum the potential times all other messages: recursive, dense, over whole sepsets."""
    scope = graph.clusters[i].scope
    axis = {v: k for k, v in enumerate(scope)}
    table = plain(graph, states, weights, graph.clusters[i])
    for k in graph.neighbours(i):
        if k != j:
            sepset = graph.sepsets[min(i, k), max(i, k)]
            table = np.einsum(
                table,
                range(table.ndim),
                message(graph, states, weights, k, i),
                [axis[v] for v in sepset],
                range(table.ndim),
            )
    if j is None:
        return table
    sepset = graph.sepsets[min(i, j), max(i, j)]
    return np.einsum(table, range(table.ndim), [axis[v] for v in sepset])


def sliced(values, scope, states):
    return values[tuple(states.get(v, slice(None)) for v in scope)]


@pytest.mark.parametrize("seed", range(15))
def test_messages_and_beliefs_are_their_definition(seed):
    net = network(seed, count=7, zeros=0.1)
    states, weights = question(net, seed)
    truth = Enumeration(net, states, weights)
    if truth.evidence == 0.0:
        pytest.skip("impossible evidence")
    graph = pgm.compile(net)
    posterior = pgm.infer(graph, evidence(states, weights))
    for i, j in [*graph.sepsets, *((j, i) for i, j in graph.sepsets)]:
        sepset = graph.sepsets[min(i, j), max(i, j)]
        found = posterior.message(i, j)
        assert found.scope == tuple(v for v in sepset if v not in states)
        due = sliced(message(graph, states, weights, i, j), sepset, states)
        np.testing.assert_allclose(
            found.values * np.exp(found.log_scale), due, rtol=1e-12, atol=1e-15
        )
    for cluster in graph:
        found = posterior.belief(cluster)
        assert found.scope == tuple(v for v in cluster.scope if v not in states)
        due = sliced(message(graph, states, weights, cluster.index, None), cluster.scope, states)
        np.testing.assert_allclose(
            found.values * np.exp(found.log_scale), due, rtol=1e-12, atol=1e-15
        )


def test_the_total_of_a_belief_is_the_evidence_of_its_tree():
    a, b, c, d = (pgm.Discrete(name, 2) for name in "abcd")
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(a, table=[0.2, 0.8]),
            pgm.TableCPD(b, a, table=[[0.5, 0.5], [0.1, 0.9]]),
            pgm.TableCPD(c, table=[0.4, 0.6]),
            pgm.TableCPD(d, c, table=[[0.3, 0.7], [0.6, 0.4]]),
        ]
    )
    posterior = pgm.infer(pgm.ClusterGraph(net, [{a, b}, {c, d}]), {b: 1, d: 0})
    assert float(posterior.belief(0).log_total) == pytest.approx(np.log(0.2 * 0.5 + 0.8 * 0.9))
    assert float(posterior.belief(1).log_total) == pytest.approx(np.log(0.4 * 0.3 + 0.6 * 0.6))
    assert float(posterior.log_evidence) == pytest.approx(np.log(0.82 * 0.48))
