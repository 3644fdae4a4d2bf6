"""The most probable states of some variables, the others summed over, against all states' table."""

import importlib
import itertools

import numpy as np
import pytest

import pgm
from pgm.elimination import max_sum
from pgm.examples import coin, pair, rainy, side, still, wet
from pgm.schedules import limits

# The function `pgm.inference.query` has the package's name.
branch_and_bound = importlib.import_module("pgm.inference.query.branch_and_bound")


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


@pytest.mark.parametrize("seed", range(60))
@pytest.mark.parametrize("small", [False, True])
def test_several_assignments(seed, small, request):
    """The likeliest states of some variables are the largest entries of their table."""
    if small:
        request.getfixturevalue("small_tables")
    rng = np.random.default_rng(seed)
    network, asked, _, states, weights = drawn(rng)
    known = {v: int(own[-1]) for v, own in states.items() if v not in asked and own[-1] >= 0}
    soft = {v: own[-1] for v, own in weights.items()}
    evidence = {**known, **{v: pgm.soft(own) for v, own in soft.items()}}
    by_run = {v: np.array([state]) for v, state in known.items()}
    table = joint(network, 0, by_run, {v: own[None] for v, own in soft.items()}).marginal(*asked)
    due = np.sort(table.log_values.ravel())[::-1]
    due = due[due > -np.inf]
    if not due.size:
        return
    found = pgm.most_probable(pgm.compile(network), evidence, variables=asked, count=7)
    assert found.exact.all()
    np.testing.assert_allclose(found.log_probability, due[:7], atol=1e-10)
    indices = tuple(found.assignment[v] for v in asked)
    np.testing.assert_allclose(table.log_values[indices], due[:7], atol=1e-10)
    assert len({*zip(*map(np.ndarray.tolist, indices), strict=True)}) == len(due[:7])


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


@pytest.fixture
def small_tables(monkeypatch):
    """Any table is too large to sum first, so that all has to be searched."""
    monkeypatch.setattr(max_sum, "PREFERENCES", [4, 0])
    monkeypatch.setattr(max_sum, "EXACT", 0)
    monkeypatch.setattr(max_sum, "BOUND", 0)
    monkeypatch.setattr(max_sum, "TRIES", 3)


@pytest.mark.parametrize("seed", range(150))
@pytest.mark.usefixtures("small_tables")
def test_search(seed):
    """A search by bounds finds what the table of all states has, ties and zeros among it."""
    test_drawn_networks(seed)


def grid(seed):
    """A grid of 4 by 5, some of its variables, and the table of these."""
    rng = np.random.default_rng(seed)
    cells = [[pgm.Discrete(f"c{i}{j}", 2) for j in range(5)] for i in range(4)]
    pairs = [pair for row in cells for pair in itertools.pairwise(row)]
    pairs += [pair for column in zip(*cells, strict=True) for pair in itertools.pairwise(column)]
    strength = rng.choice([0.3, 3.0])
    drawn = [pgm.Table(pair, np.exp(strength * rng.normal(size=(2, 2)))) for pair in pairs]
    network = pgm.MarkovNetwork(drawn)
    every = list(itertools.chain(*cells))
    asked = [every[k] for k in rng.permutation(20)[: rng.integers(1, 20)]]
    return network, asked, joint(network, 0, {}, {}).marginal(*asked)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.usefixtures("small_tables")
def test_search_in_grids(seed):
    """Sums in a grid are joined to many maxima."""
    network, asked, table = grid(seed)
    found = pgm.most_probable(pgm.compile(network), {}, variables=asked)
    assert found.exact
    assert found.log_probability == pytest.approx(table.log_values.max(), abs=1e-11)
    assert found.bound == found.log_probability


def star(seed, count):
    """A hub that meets all others: summed out, it joins them."""
    rng = np.random.default_rng(seed)
    hub = pgm.Discrete("hub", 2)
    rim = [pgm.Discrete(f"r{k}", 2) for k in range(count)]
    factors = [pgm.Table((hub, v), rng.exponential(size=(2, 2))) for v in rim]
    return rim, pgm.compile(pgm.MarkovNetwork(factors))


def test_sums_that_join_forty_variables():
    """A table of 2⁴⁰ entries is never made; no state that differs by one or two is better."""
    rim, graph = star(0, 40)
    found = pgm.most_probable(graph, {}, variables=rim)
    assert found.exact
    level = pgm.infer(graph, dict(found.assignment)).log_evidence
    assert found.log_probability == pytest.approx(level, abs=1e-12)
    pairs = [*itertools.combinations(range(40), 2), *[(k, k) for k in range(40)]]
    states = np.tile([v.index(found.states(v)) for v in rim], (len(pairs), 1))
    for run, two in enumerate(pairs):
        states[run, [*{*two}]] ^= 1
    others = pgm.infer(graph, dict(zip(rim, states.T, strict=True))).log_evidence
    assert (others <= level + 1e-12).all()


def test_runs_of_a_search():
    """Runs are searched one by one, each by what it leaves open."""
    rim, graph = star(1, 20)
    known = {rim[0]: [0, -1], rim[1]: [1, -1]}
    found = pgm.most_probable(graph, known, variables=rim[1:])
    assert found.assignment[rim[1]][0] == 1
    first = pgm.most_probable(graph, {rim[0]: 0, rim[1]: 1}, variables=rim[2:])
    second = pgm.most_probable(graph, {}, variables=rim[1:])
    due = [float(first.log_probability), float(second.log_probability)]
    assert found.log_probability == pytest.approx(due, abs=1e-12)


@pytest.mark.usefixtures("small_tables")
def test_a_search_that_is_given_up(monkeypatch):
    """The best so far is told, with a bound on what may be missing."""
    exact = []
    for seed in range(10):
        network, asked, table = grid(seed)
        graph = pgm.compile(network)
        monkeypatch.setattr(branch_and_bound, "WORK", 0)
        found = pgm.most_probable(graph, {}, variables=asked)
        best = table.log_values.max()
        assert found.log_probability <= best + 1e-11
        assert best <= found.bound + 1e-11
        if not found.exact:
            assert found.log_probability < found.bound < np.inf
            assert f"at most {found.bound:.6g}" in repr(found)
        exact.append(bool(found.exact))
    assert not all(exact)


def test_tables_that_are_too_wide(monkeypatch):
    """What no order of sums and maxima makes small enough is refused."""
    states = [pgm.Discrete(f"s{k}", 3) for k in range(8)]
    pairs = itertools.combinations(states, 2)
    every = pgm.MarkovNetwork([pgm.Table(pair, np.eye(3) + 1.0) for pair in pairs])
    graph = pgm.compile(every)
    monkeypatch.setattr(limits, "LIMIT", 8000)
    with pytest.raises(pgm.GraphError, match=r"a marginal MAP needs are too large: .* limit"):
        pgm.most_probable(graph, {}, variables=states[:4])


def test_entries_beyond_numbers():
    """Entries further below the largest than numbers reach are compared all the same."""
    a, b = (pgm.Discrete(name, 2) for name in "ab")
    faint = [pgm.Table((a, b), [[1e-200, 1e-200], [1e-201, 1e-200]])] * 2
    found = pgm.most_probable(pgm.compile(pgm.MarkovNetwork(faint)), {}, variables=a)
    assert found.assignment[a] == "0"
    assert found.log_probability == pytest.approx(np.log(2) - 400 * np.log(10), rel=1e-15)
