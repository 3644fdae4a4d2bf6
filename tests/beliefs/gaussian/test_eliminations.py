"""How many batched eliminations a pass takes, and that what is planned once serves all evidence."""

import numpy as np
import pytest
from gaussian.draws import assert_dense, regular

import pgm
from pgm.beliefs.gaussian import messages
from pgm.beliefs.gaussian.tree import TreePlan
from tests.dags import chain, star, tree


def scalar_network(parents):
    v = pgm.variables(" ".join(f"v{k}" for k in range(len(parents))))
    cpds = [
        pgm.LinearGaussianCPD(
            v[k], {v[j]: 0.5 for j in places}, offset=0.1 * (k % 7), cov=1.0 + k % 3
        )
        if places
        else pgm.GaussianCPD(v[k], 0.0, 1.0)
        for k, places in enumerate(parents)
    ]
    return v, pgm.BayesianNetwork(cpds)


@pytest.fixture
def shapes(monkeypatch):
    """The shapes of all matrices eliminated from."""
    found = []
    original = messages.eliminate

    def counted(factor, count):
        found.append(factor.matrix.shape)
        return original(factor, count)

    monkeypatch.setattr(messages, "eliminate", counted)
    return found


def test_a_star_of_a_thousand_leaves(shapes):
    """Equal cliques run together; each leaf's CPD has numbers of its own."""
    v, net = scalar_network(star(1000))
    posterior = pgm.infer(pgm.compile(net), dict.fromkeys(v[1:], 0.25))
    assert len(shapes) <= 5
    precision = 1.0 + sum(0.25 / (1.0 + k % 3) for k in range(1, 1001))
    weight = sum(0.5 * (0.25 - 0.1 * (k % 7)) / (1.0 + k % 3) for k in range(1, 1001))
    assert posterior[v[0]].mean == pytest.approx(weight / precision, rel=1e-12)
    assert posterior[v[0]].cov == pytest.approx(1.0 / precision, rel=1e-12)


def test_a_star_of_hidden_leaves_each_with_a_sensor(shapes):
    v, net = scalar_network([*star(300), *([1 + k] for k in range(300))])
    pgm.infer(pgm.compile(net), dict.fromkeys(v[301:], 0.25))
    assert len(shapes) <= 12


def test_a_chain_goes_from_both_ends(shapes):
    v, net = scalar_network(chain(200))
    pgm.infer(pgm.compile(net), {v[50]: 1.0})
    assert len(shapes) <= 2 * 100 + 5


def test_a_tree_takes_rounds_by_depth(shapes):
    """Of 1,023 variables, ten deep."""
    v, net = scalar_network(tree(1023, 2))
    pgm.infer(pgm.compile(net), dict.fromkeys(v[600:], 1.0))
    assert len(shapes) <= 60


def test_runs_that_share_matrices_share_eliminations(shapes):
    v, net = scalar_network(tree(31, 2))
    graph = pgm.compile(net)
    pgm.infer(graph, {v[30]: 1.0})
    alone = list(shapes)
    shapes.clear()
    pgm.infer(graph, {v[30]: np.zeros((500, 1))})
    assert shapes == alone


def test_a_plan_serves_other_values_and_other_variables():
    """Plans are kept by which variables are observed; values, and their axes, are not."""
    drawn = regular(0, 12, 2, reach=5)
    graph = pgm.compile(drawn.network())
    dense = drawn.dense()
    rng = np.random.default_rng(0)
    chosen = [drawn.observe(rng, 0.4)[0] for _ in range(3)]
    for _ in range(3):
        for evidence in chosen:
            values = {v: x + rng.normal(size=x.size) for v, x in evidence.items()}
            hidden = [v for v in drawn.variables if v not in evidence]
            assert_dense(pgm.infer(graph, values), dense, values, hidden, rng)
    assert sum(isinstance(plan, TreePlan) for plan in graph._derived.values()) == 3
    first = chosen[0]
    batch = {v: x + np.zeros((4, x.size)) for v, x in first.items()}
    assert pgm.infer(graph, batch).log_evidence.shape == (4,)
    assert sum(isinstance(plan, TreePlan) for plan in graph._derived.values()) == 3


def test_a_plan_serves_other_inputs():
    a, b, c, u = pgm.variables("a b c u")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, {a: 1.0, u: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(c, {a: 1.0}, cov=1.0),
        ]
    )
    graph = pgm.compile(net)
    for evidence, mean in (
        ({b: 2.0, u: 0.0}, 1.0),
        ({b: 2.0, u: 1.0}, 0.5),
        ({c: 2.0}, 1.0),
        ({c: 2.0, u: 5.0}, 1.0),
        ({b: 2.0, u: 2.0}, 0.0),
    ):
        assert pgm.infer(graph, evidence)[a].mean == pytest.approx(mean, abs=1e-14)


def test_a_posterior_keeps_its_own_numbers():
    """A later inference on the same graph does not reach into an earlier result."""
    drawn = regular(1, 8, 2)
    graph = pgm.compile(drawn.network())
    evidence, hidden = drawn.observe(np.random.default_rng(1), 0.4)
    first = pgm.infer(graph, evidence)
    due = first.joint(*hidden).mean.copy(), first.belief(0).h.copy()
    other = pgm.infer(graph, {v: x + 5.0 for v, x in evidence.items()})
    other.belief(0)
    np.testing.assert_array_equal(first.joint(*hidden).mean, due[0])
    np.testing.assert_array_equal(first.belief(0).h, due[1])
