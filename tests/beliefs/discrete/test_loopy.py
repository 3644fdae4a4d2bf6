"""Messages on graphs of any shape: exact on trees, and a plain twin's where they go round."""

import numpy as np
import pytest
from discrete.enumeration import Enumeration, network
from discrete.test_messages import plain
from discrete.test_trees import evidence, question

import pgm
from models.discrete import asia, cloudy, rain, sprinkler, sprinkling, wet, xray
from pgm.schedules import limits

SCHEDULES = [pgm.Flooding(), pgm.Sequential(), pgm.Residual(), pgm.Flooding(damping=0.4)]


def around(graph, states, weights, rounds=400):
    """All messages at once, many times: dictionaries of arrays, each normalised to one."""
    potentials = [plain(graph, states, weights, cluster) for cluster in graph]
    edges = [*graph.sepsets, *((j, i) for i, j in graph.sepsets)]
    sepset = {(i, j): graph.sepsets[min(i, j), max(i, j)] for i, j in edges}
    kept = {edge: np.ones([v.size for v in sepset[edge]]) for edge in edges}

    def product(i, but=None):
        scope = graph.clusters[i].scope
        table = potentials[i]
        for k in graph.neighbours(i):
            if k != but:
                axes = [scope.index(v) for v in sepset[k, i]]
                table = np.einsum(table, range(table.ndim), kept[k, i], axes, range(table.ndim))
        return table, scope

    def sent(i, j):
        table, scope = product(i, j)
        total = np.einsum(table, range(table.ndim), [scope.index(v) for v in sepset[i, j]])
        return total / total.sum()

    for _ in range(rounds):
        kept = {edge: sent(*edge) for edge in edges}
    beliefs = [product(i)[0] for i in range(len(graph))]
    return potentials, [table / table.sum() for table in beliefs], kept


def bethe(graph, potentials, beliefs):
    """The Bethe value from beliefs alone: expected ln potentials plus entropies."""
    total = 0.0
    for potential, belief in zip(potentials, beliefs, strict=True):
        inside = belief > 0.0
        total += (belief[inside] * np.log(potential[inside] / belief[inside])).sum()
    for (i, _), sepset in graph.sepsets.items():
        scope = graph.clusters[i].scope
        axes = [scope.index(v) for v in sepset]
        shared = np.einsum(beliefs[i], range(len(scope)), axes)
        total += (shared[shared > 0.0] * np.log(shared[shared > 0.0])).sum()
    return total


def four_cycle(seed):
    """Four variables in a ring, whose neighbours a sensor each finds to agree or not."""
    rng = np.random.default_rng(seed)
    ring = [pgm.Discrete(f"r{k}", 2 + k % 2) for k in range(4)]
    sensors = [pgm.Discrete(f"s{k}", 2) for k in range(4)]
    cpds = [pgm.TableCPD(v, table=rng.dirichlet(np.ones(v.size))) for v in ring]
    clusters = []
    for k, sensor in enumerate(sensors):
        pair = ring[k], ring[(k + 1) % 4]
        sizes = [v.size for v in pair]
        cpds.append(pgm.TableCPD(sensor, pair, table=rng.dirichlet([1, 1], sizes)))
        clusters.append({*pair, sensor})
    sepsets = {(k, (k + 1) % 4): {ring[(k + 1) % 4]} for k in range(4)}
    graph = pgm.ClusterGraph(pgm.BayesianNetwork(cpds), clusters, sepsets)
    return graph, ring, sensors


@pytest.mark.parametrize("schedule", SCHEDULES, ids=repr)
@pytest.mark.parametrize("seed", range(3))
def test_a_four_cycle(seed, schedule):
    graph, ring, sensors = four_cycle(seed)
    states = {sensor: k % 2 for k, sensor in enumerate(sensors)}
    weights = {ring[0]: np.array([0.3, 0.9])}
    posterior = pgm.infer(graph, evidence(states, weights), schedule=schedule)
    assert posterior.status.converged
    assert posterior.log_evidence_kind == "bethe"
    potentials, beliefs, kept = around(graph, states, weights)
    for cluster, due in zip(graph, beliefs, strict=True):
        own = due[tuple(states.get(v, slice(None)) for v in cluster.scope)]
        np.testing.assert_allclose(posterior.belief(cluster).probabilities, own, atol=1e-9)
    for (i, j), due in kept.items():
        np.testing.assert_allclose(posterior.message(i, j).probabilities, due, atol=1e-9)
    value = bethe(graph, potentials, beliefs)
    assert float(posterior.log_evidence) == pytest.approx(value, abs=1e-8)
    exact = Enumeration(graph.network, states, weights)
    assert float(posterior.log_evidence) != pytest.approx(np.log(exact.evidence), abs=1e-5)
    for variable in ring:
        np.testing.assert_allclose(posterior[variable].values, exact.marginal(variable), atol=0.2)


@pytest.mark.parametrize("method", [None, pgm.Bethe()])
@pytest.mark.parametrize("schedule", SCHEDULES, ids=repr)
@pytest.mark.parametrize("seed", range(4))
def test_on_trees_they_are_exact(seed, schedule, method):
    net = network(30 + seed, parents=1) if method else network(30 + seed)
    graph = pgm.compile(net, method=method)
    assert graph.is_tree
    states, weights = question(net, seed)
    truth = Enumeration(net, states, weights)
    posterior = pgm.infer(graph, evidence(states, weights), schedule=schedule)
    assert posterior.status.converged
    assert posterior.log_evidence_kind == "exact"
    np.testing.assert_allclose(posterior.log_evidence, np.log(truth.evidence), atol=1e-9)
    hidden = [v for v in net.variables if v not in states]
    for variable in hidden:
        np.testing.assert_allclose(posterior[variable].values, truth.marginal(variable), atol=1e-9)
    wanted = hidden[0], hidden[-1]
    np.testing.assert_allclose(posterior.joint(*wanted).values, truth.marginal(*wanted), atol=1e-9)
    for cluster in graph:
        scope = [v for v in cluster.scope if v not in states]
        np.testing.assert_allclose(
            posterior.belief(cluster).probabilities, truth.marginal(*scope), atol=1e-9
        )


@pytest.mark.parametrize("schedule", SCHEDULES, ids=repr)
def test_a_batch_equals_its_runs(schedule):
    graph, ring, sensors = four_cycle(5)
    rng = np.random.default_rng(0)
    given = {sensor: rng.integers(-1, 2, 4) for sensor in sensors}
    whole = pgm.infer(graph, given, schedule=schedule)
    assert whole.status.residuals.shape == (whole.status.iterations, 4)
    for run in range(4):
        single = pgm.infer(graph, {s: int(v[run]) for s, v in given.items()}, schedule=schedule)
        for variable in ring:
            np.testing.assert_allclose(
                whole[variable].values[run], single[variable].values, atol=1e-9
            )
        np.testing.assert_allclose(whole.log_evidence[run], single.log_evidence, atol=1e-9)


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")  # seven rounds are enough to compare
def test_small_batches_are_the_same(monkeypatch):
    net = network(40, count=10)
    graph = pgm.compile(net, method=pgm.Bethe())
    whole = pgm.infer(graph, {}, schedule=pgm.Flooding(iterations=7))
    monkeypatch.setattr(limits, "BATCH", 1)
    small = pgm.infer(pgm.compile(net, method=pgm.Bethe()), {}, schedule=pgm.Flooding(iterations=7))
    for variable in net.variables:
        np.testing.assert_allclose(small[variable].values, whole[variable].values, atol=1e-14)


def test_the_wet_grass():
    """Cloudy, sprinkler, rain and wet are a loop; what is known of it is approximate."""
    graph = pgm.compile(sprinkler(), method=pgm.Bethe())
    assert not graph.is_tree
    posterior = pgm.infer(graph, {wet: "yes"}, schedule=pgm.Sequential())
    assert posterior.status.converged
    _, beliefs, _ = around(graph, {wet: 1}, {})
    for cluster, due in zip(graph, beliefs, strict=True):
        axes = [cluster.scope.index(v) for v in cluster.scope if v != wet]
        due = np.einsum(due, range(due.ndim), axes)
        np.testing.assert_allclose(posterior.belief(cluster).probabilities, due, atol=1e-9)
    truth = Enumeration(sprinkler(), {wet: 1})
    for variable in (cloudy, sprinkling, rain):
        error = abs(posterior[variable].values - truth.marginal(variable)).max()
        assert 1e-3 < error < 0.15


def test_a_run_that_is_not_given_enough_iterations_says_so():
    graph, _, sensors = four_cycle(0)
    states = dict.fromkeys(sensors, 1)
    with pytest.warns(pgm.ConvergenceWarning, match="after 2 rounds: the last changed one by"):
        posterior = pgm.infer(graph, states, schedule=pgm.Flooding(iterations=2))
    assert not posterior.status.converged
    assert posterior.status.iterations == 2


def test_evidence_that_messages_find_impossible():
    a, b, c = (pgm.Discrete(name, 2) for name in "abc")
    same = [[1.0, 0.0], [0.0, 1.0]]
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(a, table=[0.5, 0.5]),
            pgm.TableCPD(b, a, table=same),
            pgm.TableCPD(c, b, table=same),
        ]
    )
    graph = pgm.compile(net, method=pgm.Bethe())
    for schedule in SCHEDULES:
        with pytest.raises(pgm.EvidenceError, match="probability zero"):
            pgm.infer(graph, {a: 0, c: 1}, schedule=schedule)
        with pytest.raises(pgm.EvidenceError, match=r"probability zero \(first in run 1\)"):
            pgm.infer(graph, {a: [0, 0], c: [0, 1]}, schedule=schedule)


def test_a_graph_of_one_cluster():
    net = sprinkler()
    graph = pgm.ClusterGraph(net, [set(net.variables)])
    for schedule in SCHEDULES:
        posterior = pgm.infer(graph, {wet: "yes"}, schedule=schedule)
        truth = Enumeration(net, {wet: 1})
        np.testing.assert_allclose(posterior[rain].values, truth.marginal(rain), atol=1e-15)
        np.testing.assert_allclose(posterior.log_evidence, np.log(truth.evidence), atol=1e-15)


def test_a_variable_observed_in_some_runs():
    graph = pgm.compile(asia(), method=pgm.Bethe())
    posterior = pgm.infer(graph, {xray: [0, -1]}, schedule=pgm.Sequential())
    assert posterior[xray].values[0].tolist() == [1.0, 0.0]
    assert 0.05 < posterior[xray].values[1, 1] < 0.2
