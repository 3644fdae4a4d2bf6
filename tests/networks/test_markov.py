"""Markov networks of tables: drawn ones against the sum over all states; refusals."""

import itertools
import pickle

import numpy as np
import pytest
from crossed import slow_after
from numpy.testing import assert_allclose

import pgm

A, B, C = (pgm.Discrete(name, states=("-", "+")) for name in "abc")
ALIKE = [[2.0, 1.0], [1.0, 2.0]]


def drawn(rng):
    """A network of one to five variables, of one to three states, and factors of any scopes.

    There are zeros, scopes that are repeated, numbers, parts that nothing joins, and numbers that
    float64 cannot hold.
    """
    variables = [pgm.Discrete(f"v{k}", int(rng.integers(1, 4))) for k in range(rng.integers(1, 6))]
    factors = [pgm.Table.vacuous(v) for v in variables if rng.random() < 0.3]
    for _ in range(rng.integers(1, 7)):
        count = rng.integers(0, min(4, len(variables) + 1))
        scope = [variables[k] for k in rng.permutation(len(variables))[:count]]
        values = rng.exponential(size=[v.size for v in scope]) * 10.0 ** rng.uniform(-3, 3)
        if rng.random() < 0.3:
            values = values * (rng.random(values.shape) > 0.2)
        factors.append(pgm.Table(scope, values, rng.choice([0.0, 0.0, 0.0, 300.0, -900.0, 800.0])))
    if not any(factor.scope for factor in factors):
        return drawn(rng)
    return pgm.MarkovNetwork(factors)


def logs(network, evidence=None):
    """The logarithm of the product of all factors, with an axis for each variable."""
    found = np.zeros([v.size for v in network.variables])
    for factor in network.factors:
        places = [network.variables.index(v) for v in factor.scope]
        shape = [1] * found.ndim
        for place in places:
            shape[place] = found.shape[place]
        found = found + factor.log_values.transpose(np.argsort(places)).reshape(shape)
    for variable, state in (evidence or {}).items():
        at = [1] * found.ndim
        at[network.variables.index(variable)] = variable.size
        weights = np.zeros(variable.size)
        if isinstance(state, int | np.integer):
            weights = np.where(np.arange(variable.size) == state, 1.0, 0.0)
        else:
            weights = state
        with np.errstate(divide="ignore"):
            found = found + np.log(weights).reshape(at)
    return found


def others(array, place):
    return tuple(k for k in range(array.ndim) if k != place)


@pytest.mark.parametrize("seed", slow_after(6, range(20)))
def test_drawn_networks_equal_the_sum_over_all_states(seed):
    """Fifty networks each: ln Z, marginals, queries, joints, maxima, beliefs; asked twice."""
    rng = np.random.default_rng(seed)
    for _ in range(50):
        network = drawn(rng)
        evidence = {v: int(rng.integers(v.size)) for v in network.variables if rng.random() < 0.25}
        whole = logs(network, evidence)
        total = np.logaddexp.reduce(whole.ravel())
        graph = pgm.compile(network)
        graph.check()
        hidden = [v for v in network.variables if v not in evidence]
        if total == -np.inf:
            with pytest.raises(pgm.EvidenceError, match="impossible"):
                pgm.infer(graph, evidence)
            continue
        share = np.exp(whole - total)
        for _ in range(2):
            posterior = pgm.infer(graph, evidence)
            assert_allclose(posterior.log_evidence, total, rtol=1e-12, atol=1e-10)
            for v in hidden:
                due = share.sum(axis=others(share, network.variables.index(v)))
                assert_allclose(posterior[v].probabilities, due, atol=1e-12)
                assert_allclose(pgm.query(graph, v, evidence).probabilities, due, atol=1e-12)
                assert_allclose(pgm.query(network, v, evidence).probabilities, due, atol=1e-12)
        found = pgm.most_probable(graph, evidence)
        assert_allclose(found.log_probability, whole.max(), rtol=1e-12, atol=1e-9)
        states = tuple(v.index(found.assignment[v]) for v in network.variables)
        assert_allclose(whole[states], whole.max(), rtol=1e-12, atol=1e-9)
        if len(hidden) > 1:
            axes = tuple(k for k, v in enumerate(network.variables) if v in evidence)
            joint = posterior.joint(*hidden).probabilities
            assert_allclose(joint, share.sum(axis=axes), atol=1e-12)


def test_runs_soft_evidence_and_what_some_runs_exclude():
    rng = np.random.default_rng(5)
    for _ in range(100):
        network = drawn(rng)
        hard, soft = {}, {}
        for v in network.variables:
            what = rng.random()
            if what < 0.25:
                hard[v] = rng.integers(-1, v.size, size=3)
            elif what < 0.4:
                soft[v] = rng.random((3, v.size)) + 0.01
        if not np.isfinite(np.logaddexp.reduce(logs(network).ravel())) or not hard:
            continue
        evidence = hard | {v: pgm.soft(weights) for v, weights in soft.items()}
        posterior = pgm.infer(pgm.compile(network), evidence, impossible="allow")
        for run in range(3):
            known = {v: int(states[run]) for v, states in hard.items() if states[run] >= 0}
            whole = logs(network, known | {v: weights[run] for v, weights in soft.items()})
            total = np.logaddexp.reduce(whole.ravel())
            assert_allclose(posterior.log_evidence[run], total, rtol=1e-12, atol=1e-10)
            for place, v in enumerate(network.variables):
                if v in hard and (hard[v] >= 0).all():
                    continue
                values = posterior[v].values[run]
                if total == -np.inf:
                    assert np.isnan(values).all()
                    continue
                due = np.exp(whole - total).sum(axis=others(whole, place))
                assert_allclose(values, due, atol=1e-12)


@pytest.mark.parametrize("method", [pgm.Bethe(), pgm.LTRIP(), pgm.JoinGraph(9)], ids=repr)
def test_every_method_is_exact_on_a_tree_of_pairs(method):
    rng = np.random.default_rng(2)
    v = [pgm.Discrete(f"v{k}", 3) for k in range(7)]
    pairs = [pgm.Table((v[k], v[(k - 1) // 2]), 1e5 * rng.random((3, 3))) for k in range(1, 7)]
    network = pgm.MarkovNetwork([*pairs, pgm.Table((), 3.0)])
    due = pgm.infer(pgm.compile(network), {v[0]: 1})
    graph = pgm.compile(network, method=method)
    found = pgm.infer(graph, {v[0]: 1}, schedule=pgm.Flooding())
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-9)
    assert_allclose(found[v[6]].probabilities, due[v[6]].probabilities, atol=1e-9)


def test_clusters_by_hand_and_a_loop():
    v = [pgm.Discrete(f"v{k}", 2) for k in range(4)]
    loop = pgm.MarkovNetwork([pgm.Table((v[k], v[(k + 1) % 4]), ALIKE) for k in range(4)])
    graph = pgm.ClusterGraph(loop, [{v[0], v[1], v[2]}, {v[2], v[3], v[0]}])
    total = sum(
        np.prod([2.0 if s[k] == s[(k + 1) % 4] else 1.0 for k in range(4)])
        for s in itertools.product((0, 1), repeat=4)
    )
    posterior = pgm.infer(graph, {})
    assert_allclose(posterior.log_evidence, np.log(total))
    assert_allclose(np.exp(posterior.belief(0).log_total), total)
    assert len(graph.clusters[0].factors) == 2
    assert graph.clusters[0].cpds == ()
    with pytest.raises(pgm.GraphError, match=r"holds the family \(v2, v3\) of a factor"):
        pgm.ClusterGraph(loop, [{v[0], v[1], v[2]}, {v[3], v[0]}])
    bethe = pgm.infer(pgm.compile(loop, method=pgm.Bethe()), {}, schedule=pgm.Flooding())
    assert bethe.log_evidence_kind == "bethe"


def test_a_bayesian_network_is_one():
    from pgm.examples import rain, rainy, wet

    assert isinstance(rainy, pgm.MarkovNetwork)
    assert rainy.factors == rainy.cpds
    network = pgm.MarkovNetwork([*rainy.factors, pgm.Table(rain, [1.0, 3.0])])
    assert network.cpds == rainy.cpds
    found = pgm.infer(pgm.compile(network), {wet: "yes"})
    due = pgm.infer(pgm.compile(rainy), {wet: "yes", rain: pgm.soft([1.0, 3.0])})
    assert_allclose(found[rain].probabilities, due[rain].probabilities)
    assert_allclose(found.log_evidence, due.log_evidence)


def test_separation_is_that_of_the_graph():
    network = pgm.MarkovNetwork([pgm.Table((A, B), ALIKE), pgm.Table((B, C), ALIKE)])
    assert network.separated(A, C, given=B)
    assert not network.separated(A, C)
    assert set(map(frozenset, network.to_networkx().edges)) == {
        frozenset({A, B}),
        frozenset({B, C}),
    }
    with pytest.raises(pgm.ModelError, match="must be disjoint"):
        network.separated(A, B, given=B)


def test_shown_and_pickled():
    network = pgm.MarkovNetwork([pgm.Table((A, B), ALIKE), pgm.Table((), 2.0)])
    assert repr(network) == "MarkovNetwork(φ(a, b)  φ())"
    many = pgm.MarkovNetwork([pgm.Table(A, [1.0, 1.0])] * 20)
    assert repr(many).startswith("MarkovNetwork(20 factors, discrete)")
    again = pickle.loads(pickle.dumps(network))
    assert_allclose(pgm.infer(pgm.compile(again), {}).log_evidence, np.log(12.0))


def test_factors_that_exclude_one_another():
    network = pgm.MarkovNetwork([pgm.Table(A, [1.0, 0.0]), pgm.Table(A, [0.0, 1.0])])
    for asked in (
        lambda: pgm.infer(pgm.compile(network), {}),
        lambda: pgm.infer(pgm.compile(network), {}, impossible="allow"),
        lambda: pgm.query(network, A),
        lambda: pgm.most_probable(pgm.compile(network), {}),
    ):
        with pytest.raises(pgm.EvidenceError, match="factors exclude one another"):
            asked()


def test_what_a_query_leaves_out_may_be_impossible():
    """Parts that nothing joins to the variable asked for, and two CPDs of one child."""
    even = pgm.Table(A, [1.0, 1.0])
    part = pgm.Table((B, C), [[0.0, 1.0], [0.0, 1.0]])
    network = pgm.MarkovNetwork([even, part])
    assert_allclose(pgm.query(network, A, {C: "+"}).probabilities, [0.5, 0.5])
    with pytest.raises(pgm.EvidenceError, match="the evidence has probability zero"):
        pgm.query(network, A, {C: "-"})
    sure = [pgm.TableCPD(B, table=[1.0, 0.0]), pgm.TableCPD(B, given=C, table=[[0, 1], [0, 1]])]
    twice = pgm.MarkovNetwork([even, *sure, pgm.Table.vacuous(C)])
    with pytest.raises(pgm.EvidenceError, match=r"probability zero|exclude one another"):
        pgm.query(twice, A, {C: "-"})


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ([], "at least one variable"),
        ([pgm.Table((), 3.0)], "at least one variable"),
        ([1], "or CPDs, not 1"),
        (5, "a sequence of factors, not 5"),
        ([pgm.Table(A, [[1, 1]], lead=1)], "is a stack of factors"),
        ([pgm.Table.vacuous(v) for v in (A, pgm.Discrete("a", 3))], "two different variables"),
        ([pgm.Table.vacuous(A.previous)], "of a step before"),
    ],
)
def test_what_is_no_network(factors, words):
    with pytest.raises(pgm.ModelError, match=words):
        pgm.MarkovNetwork(factors)


def test_log_scales_beyond_numbers():
    own = pgm.Discrete("own", 2)
    far = [pgm.Table(own, [1.0, 2.0], 1e308)] * 2
    with pytest.raises(pgm.NumericalError, match="the log-scales of factors add to more than"):
        pgm.infer(pgm.compile(pgm.MarkovNetwork(far)), {})
