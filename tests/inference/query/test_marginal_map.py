"""The most probable states of some variables, the others summed over, against all states' table."""

import itertools

import numpy as np
import pytest

import pgm
from pgm.examples import coin, pair, rainy, side, still, wet


def drawn(rng):
    """A Markov network with zeros, loops and constants, what is asked for, and evidence of runs."""
    count = int(rng.integers(1, 7))
    variables = [pgm.Discrete(f"v{k}", int(rng.integers(1, 4))) for k in range(count)]
    factors = []
    for _ in range(rng.integers(1, 8)):
        size = min(count, int(rng.integers(0, 4)))
        scope = [variables[k] for k in rng.choice(count, size, replace=False)]
        shape = [v.size for v in scope]
        values = rng.exponential(size=shape) * (rng.random(shape) > 0.15)
        factors.append(pgm.Table(scope, values, rng.normal()))
    factors += [pgm.Table.vacuous(variables)]
    size = int(rng.integers(1, count + 1))
    asked = [variables[k] for k in rng.permutation(count)[:size]]
    runs = int(rng.integers(1, 4))
    states, weights = {}, {}
    for v in variables:
        chance = rng.random()
        if chance < 0.3:
            states[v] = rng.integers(-1, v.size, runs)
            states[v][0] = -1 if v in asked else states[v][0]
        elif chance < 0.4:
            weights[v] = rng.random((runs, v.size)) + 0.01
    return pgm.MarkovNetwork(factors), asked, runs, states, weights


def joint(network, run, states, weights):
    """All states' products with the evidence of a run, by the network's variables."""
    table = pgm.Table((), 1.0)
    for factor in network.factors:
        table = table * factor
    for v, own in weights.items():
        table = table * pgm.Table(v, own[run])
    for v, own in states.items():
        if own[run] >= 0:
            table = table * pgm.Table(v, np.eye(v.size)[own[run]])
    return table


@pytest.mark.parametrize("seed", range(150))
def test_drawn_networks(seed):
    rng = np.random.default_rng(seed)
    network, asked, runs, states, weights = drawn(rng)
    evidence = states | {v: pgm.soft(own) for v, own in weights.items()}
    due = [joint(network, run, states, weights).marginal(*asked) for run in range(runs)]
    graph = pgm.compile(network)
    if any(table.values.max() == 0.0 for table in due):
        with pytest.raises((pgm.EvidenceError, pgm.ModelError)):
            pgm.most_probable(graph, evidence, variables=asked)
        return
    found = pgm.most_probable(graph, evidence, variables=asked)
    assert list(found.assignment) == asked
    assert found.exact.all()
    for run, table in enumerate(due):
        own = [found.states(v) for v in asked]
        names = [state if isinstance(state, str) else str(state[run]) for state in own]
        level = found.log_probability if not evidence else found.log_probability[run]
        best = table.log_values.max()
        assert table.log_values[tuple(v.index(s) for v, s in zip(asked, names, strict=True))] == (
            pytest.approx(best, abs=1e-12)
        )
        assert level == pytest.approx(best, abs=1e-11)


def test_many_variables_are_asked_for():
    """A chain of 300, every second one asked for: more than an array has axes."""
    states = [pgm.Discrete(f"s{k}", 3) for k in range(300)]
    rng = np.random.default_rng(0)
    pairs = itertools.pairwise(states)
    chain = pgm.MarkovNetwork([pgm.Table(pair, rng.exponential(size=(3, 3))) for pair in pairs])
    asked = states[::2]
    found = pgm.most_probable(pgm.compile(chain), {}, variables=asked)
    # The maximum by a recursion of its own: over what is asked for, of sums over the others.
    ahead = np.zeros(3)
    for k in range(0, 298, 2):
        both = chain.factors[k].values @ chain.factors[k + 1].values
        ahead = (ahead[:, None] + np.log(both)).max(axis=0)
    ahead = ahead + np.log(chain.factors[298].values.sum(axis=1))
    assert found.log_probability == pytest.approx(ahead.max(), rel=1e-13)


def test_what_is_refused():
    graph = pgm.compile(rainy)
    with pytest.raises(pgm.EvidenceError, match="wet is observed: its value is its evidence"):
        pgm.most_probable(graph, {wet: "yes"}, variables=wet)
    with pytest.raises(pgm.EvidenceError, match="most_probable of side, which the network does"):
        pgm.most_probable(graph, {}, variables=side)
    with pytest.raises(pgm.EvidenceError, match="most_probable takes one or more variables"):
        pgm.most_probable(graph, {}, variables=())
    with pytest.raises(pgm.GraphError, match="of a network without time"):
        pgm.most_probable(pgm.compile(still, steps=2), {wet: [1, 1]}, variables=wet)
    with pytest.raises(pgm.GraphError, match="leave executor= out"):
        pgm.most_probable(pgm.compile(coin), {}, variables=side, executor=object())
    with pytest.raises(pgm.GraphError, match="most_probable is for discrete networks"):
        pgm.most_probable(pgm.compile(pair), {}, variables=side)


def test_tables_that_are_too_wide():
    """One variable that meets thirty joins them all when it is summed out first."""
    hub = pgm.Discrete("hub", 2)
    rim = [pgm.Discrete(f"r{k}", 2) for k in range(30)]
    star = pgm.MarkovNetwork([pgm.Table((hub, v), [[1.0, 2.0], [3.0, 1.0]]) for v in rim])
    graph = pgm.compile(star)
    assert pgm.most_probable(graph, {}).assignment[hub] == "1"
    with pytest.raises(pgm.GraphError, match=r"but \(r0, .* out needs tables of .* GiB at a time"):
        pgm.most_probable(graph, {}, variables=rim)


def test_entries_beyond_numbers():
    """What lies further below the largest entry than numbers reach is told, not dropped."""
    a, b = (pgm.Discrete(name, 2) for name in "ab")
    faint = [pgm.Table((a, b), [[1.0, 1.0], [1e-200, 1e-200]])] * 2
    with pytest.raises(pgm.NumericalError, match=r"over \(a\) .* entries e\^-921 times"):
        pgm.most_probable(pgm.compile(pgm.MarkovNetwork(faint)), {}, variables=a)
