"""The k most probable assignments, against all of them sorted."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.examples import coin, pair, rain, rainy, side, still, wet


def drawn(rng):
    """A network of tables with zeros, and evidence of one run."""
    size = int(rng.integers(1, 6))
    variables = [pgm.Discrete(f"v{k}", int(rng.integers(1, 4))) for k in range(size)]
    factors = [pgm.Table.vacuous(variables)]
    for _ in range(rng.integers(1, 7)):
        scope = [variables[k] for k in rng.choice(size, min(size, 2), replace=False)]
        shape = [v.size for v in scope]
        values = rng.exponential(size=shape) * (rng.random(shape) > 0.15)
        factors.append(pgm.Table(scope, values, rng.normal()))
    evidence, table = {}, pgm.Table((), 1.0)
    for factor in factors:
        table = table * factor
    for v in variables:
        chance = rng.random()
        if chance < 0.15:
            evidence[v] = int(rng.integers(v.size))
            table = table * pgm.Table(v, np.eye(v.size)[evidence[v]])
        elif chance < 0.3:
            soft = rng.random(v.size) + 0.01
            evidence[v] = pgm.soft(soft)
            table = table * pgm.Table(v, soft)
    return pgm.MarkovNetwork(factors), evidence, table


@pytest.mark.parametrize("seed", range(100))
def test_all_assignments_in_turn(seed):
    rng = np.random.default_rng(seed)
    network, evidence, table = drawn(rng)
    graph = pgm.compile(network)
    due = np.sort(table.log_values[table.values > 0.0])[::-1]
    if not due.size:
        with pytest.raises((pgm.EvidenceError, pgm.ModelError)):
            pgm.most_probable(graph, evidence, count=3)
        return
    count = int(rng.integers(1, due.size + 3))
    found = pgm.most_probable(graph, evidence, count=count)
    assert found.log_probability.shape == (min(count, due.size),)
    assert_allclose(found.log_probability, due[:count], atol=1e-11)
    at = tuple(found.assignment[v] for v in table.scope)
    assert_allclose(table.log_values[at], found.log_probability, atol=1e-11)
    assert len(set(zip(*(own.tolist() for own in at), strict=True))) == len(found.log_probability)
    assert found.exact.all()


def test_large_tables():
    """Plans for one run and for many lay tables out in ways of their own."""
    rng = np.random.default_rng(0)
    variables = [pgm.Discrete(f"v{k}", 3) for k in range(9)]
    factors = [pgm.Table(variables[k : k + 6], rng.exponential(size=(3,) * 6)) for k in range(4)]
    table = pgm.Table((), 1.0)
    for factor in factors:
        table = table * factor
    found = pgm.most_probable(pgm.compile(pgm.MarkovNetwork(factors)), {}, count=50)
    due = np.sort(table.log_values.ravel())[::-1][:50]
    assert_allclose(found.log_probability, due, atol=1e-12)
    at = tuple(found.assignment[v] for v in table.scope)
    assert_allclose(table.log_values[at], due, atol=1e-12)


def test_names_of_states():
    found = pgm.most_probable(pgm.compile(rainy), {wet: "yes"}, count=5)
    assert found.states(rain).tolist() == ["yes", "no"]
    assert not found.assignment[rain].flags.writeable
    assert len(pgm.most_probable(pgm.compile(rainy), {}, count=10**30).log_probability) == 4
    assert found.states(wet).tolist() == ["yes", "yes"]
    assert_allclose(np.exp(found.log_probability), [0.375, 0.125])


def test_a_long_chain():
    """The second best path of 200 steps is the best one that leaves it somewhere."""
    rng = np.random.default_rng(0)
    states = [pgm.Discrete(f"s{k}", 4) for k in range(200)]
    tables = [rng.exponential(size=(4, 4)) for _ in range(199)]
    chain = [
        pgm.Table((one, other), table)
        for one, other, table in zip(states, states[1:], tables, strict=False)
    ]
    found = pgm.most_probable(pgm.compile(pgm.MarkovNetwork(chain)), {}, count=4)
    # The four best paths to each state, by a recursion of lists.
    ahead = [[0.0] for _ in range(4)]
    for table in tables:
        logs = np.log(table)
        ahead = [
            sorted((v + logs[i, j] for i in range(4) for v in ahead[i]), reverse=True)[:4]
            for j in range(4)
        ]
    due = sorted((v for own in ahead for v in own), reverse=True)[:4]
    assert_allclose(found.log_probability, due, rtol=1e-12)


def test_what_is_refused():
    graph = pgm.compile(rainy)
    for wrong in (0, -1, 1.5, "2", True):
        with pytest.raises(pgm.GraphError, match="count is how many assignments"):
            pgm.most_probable(graph, {}, count=wrong)
    with pytest.raises(pgm.GraphError, match="leave count= out, or executor="):
        pgm.most_probable(graph, {}, count=2, executor=object())
    with pytest.raises(pgm.GraphError, match="assignments are of a network without time"):
        pgm.most_probable(pgm.compile(still, steps=2), {wet: [1, 1]}, count=2)
    with pytest.raises(pgm.EvidenceError, match=r"has the runs \(2,\)"):
        pgm.most_probable(graph, {wet: [0, 1]}, count=2)
    with pytest.raises(pgm.GraphError, match="most_probable is for discrete networks"):
        pgm.most_probable(pgm.compile(pair), {}, count=2)
    everything = pgm.most_probable(pgm.compile(coin), {side: 1}, count=2)
    assert everything.states(side).tolist() == ["tails"]
