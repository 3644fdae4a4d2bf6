"""Whether evidence that a query leaves out is possible, against the table of all assignments."""

import numpy as np
import pytest
from discrete.enumeration import Enumeration, network

import pgm
from pgm.inference.query import left_out, question

RUNS = 6
a, b, c, d = (pgm.Discrete(name, size) for name, size in (("a", 2), ("b", 2), ("c", 3), ("d", 2)))


def drawn(seed):
    """Draw a network with zeros, and evidence: of all runs, of some, the same of all, and soft."""
    net = network(seed, count=9, parents=2, largest=3, zeros=0.2, deterministic=0.1)
    rng = np.random.default_rng(seed)
    order = [net.variables[k] for k in rng.permutation(9)]
    evidence, runs = {}, [({}, {}) for _ in range(RUNS)]
    for variable in order[:7]:
        size = variable.size
        kind = rng.choice(["all", "some", "same", "soft", "none"], p=[0.4, 0.1, 0.25, 0.1, 0.15])
        if kind == "soft":
            weights = rng.integers(0, 2, (RUNS, size)) + np.eye(size)[rng.integers(size)]
            evidence[variable] = pgm.soft(weights)
            for run, own in zip(runs, weights, strict=True):
                run[1][variable] = own
        elif kind != "none":
            low = -1 if kind == "some" else 0
            states = rng.integers(low, size, RUNS) if kind != "same" else int(rng.integers(size))
            evidence[variable] = states
            for run, own in zip(runs, np.broadcast_to(states, RUNS), strict=True):
                if own >= 0:
                    run[0][variable] = int(own)
    return net, evidence, [Enumeration(net, *run) for run in runs], order[7:]


def outcome(ask):
    try:
        return ask()
    except pgm.EvidenceError as error:
        return error


@pytest.mark.parametrize("compiled", [False, True])
def test_runs_are_refused_just_where_their_evidence_has_probability_zero(compiled, monkeypatch):
    batches, left, found_there = [], [], left_out.contradictions

    def counted(*args):
        found = found_there(*args)
        left.append(len(found))
        return found

    monkeypatch.setattr(question, "contradictions", counted)
    for seed in range(150):
        net, evidence, truth, wanted = drawn(seed)
        asked = pgm.compile(net) if compiled else net
        lost = np.array([each.evidence == 0.0 for each in truth])
        found = pgm.query(asked, wanted, evidence, impossible="allow").values
        found = np.broadcast_to(found, (RUNS, *(v.size for v in wanted)))
        for run, each in enumerate(truth):
            if lost[run]:
                assert np.isnan(found[run]).all()
            else:
                np.testing.assert_allclose(found[run], each.marginal(*wanted), atol=1e-12)
        error = outcome(lambda: pgm.query(asked, wanted, evidence))  # noqa: B023, called at once
        assert isinstance(error, pgm.EvidenceError) == lost.any()
        if lost.any() and error.run is not None:
            assert error.run == lost.argmax()
        batches.append(lost)
    # The draw has both kinds, and many that elimination of what bears would not have found.
    assert 0.2 < np.mean(batches) < 0.8
    assert sum(0 < lost.sum() < RUNS for lost in batches) > 30
    assert np.count_nonzero(left) > 30


def test_what_is_named_does_contradict_itself():
    named = 0
    for seed in range(200, 300):
        net, _, _, wanted = drawn(seed)
        rng = np.random.default_rng(seed)
        states = {v: int(rng.integers(v.size)) for v in net.variables if v not in wanted}
        if Enumeration(net, states).evidence > 0.0:
            continue
        with pytest.raises(pgm.EvidenceError) as caught:
            pgm.query(net, wanted, states)
        names = str(caught.value).split("that for (")[1].split(")")[0].split(", ")
        guilty = {v: state for v, state in states.items() if repr(v) in names}
        assert Enumeration(net, guilty).evidence == 0.0
        named += 1
    assert named > 30


NET = pgm.BayesianNetwork(
    [
        pgm.TableCPD(a, table=[1.0, 0.0]),
        pgm.TableCPD(b, a, table=[[0.3, 0.7], [0.1, 0.9]]),
        pgm.TableCPD(c, a, table=[[0.5, 0.5, 0.0], [0.0, 0.5, 0.5]]),
        pgm.TableCPD(d, c, table=[[0.2, 0.8], [0.5, 0.5], [1.0, 0.0]]),
    ]
)


def test_a_prior_above_what_is_asked():
    """The state of a leaves its own prior out of the question."""
    found = pgm.query(NET, b, {a: [0, 1, 0]}, impossible="allow").values
    np.testing.assert_allclose(found, [[0.3, 0.7], [np.nan] * 2, [0.3, 0.7]])
    with pytest.raises(pgm.EvidenceError, match=r"run 1\): that for \(a\).*allow") as caught:
        pgm.query(NET, b, {a: [0, 1, 0]})
    assert (caught.value.run, caught.value.variable) == (1, a)
    with pytest.raises(pgm.EvidenceError) as caught:
        pgm.query(NET, b, {a: 1})
    assert caught.value.run is None
    assert "allow" not in str(caught.value)
    with pytest.raises(pgm.EvidenceError, match=r"first in run \(1, 0\)"):
        pgm.query(NET, b, {a: [[0], [1]], d: [[0, 1], [1, 0]]})


def test_through_a_variable_that_nobody_observed():
    """c = 2 is impossible with a = 0, and d = 1 with c = 2: of c two states are left."""
    assert pgm.query(NET, b, {a: 0, d: 0}).values.tolist() == [0.3, 0.7]

    net = pgm.BayesianNetwork(
        [*NET.cpds[:3], pgm.TableCPD(d, c, table=[[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])]
    )
    with pytest.raises(pgm.EvidenceError, match=r"first in run 1\): that for \(a, d\)"):
        pgm.query(net, b, {a: 0, d: [0, 1]})
    # The earliest run is named, whichever part it is in.
    with pytest.raises(pgm.EvidenceError, match=r"first in run 0\): that for \(a\)"):
        pgm.query(net, b, {a: [1, 0], d: [1, 1]})


def test_what_bears_and_what_does_not_in_different_runs():
    e = pgm.Discrete("e", 2)
    net = pgm.BayesianNetwork([*NET.cpds, pgm.TableCPD(e, b, table=[[1.0, 0.0], [1.0, 0.0]])])
    evidence = {a: [0, 0, 1, 0], e: [0, 1, 0, 0]}
    found = pgm.query(net, b, evidence, impossible="allow").values
    assert np.isnan(found).any(axis=1).tolist() == [False, True, True, False]
    with pytest.raises(pgm.EvidenceError, match=r"first in run 1\): that for \(a, e\)"):
        pgm.query(net, b, evidence)
    with pytest.raises(pgm.EvidenceError, match=r"first in run 1\): that for \(a\)"):
        pgm.query(net, b, {a: [0, 1, 0, 0], e: [0, 0, 1, 0]})


def test_a_variable_of_one_state_is_asked_for():
    one = pgm.Discrete("one", 1)
    net = pgm.BayesianNetwork([*NET.cpds, pgm.TableCPD(one, table=[1.0])])
    assert pgm.query(net, one, {a: 0}).values.tolist() == [1.0]
    with pytest.raises(pgm.EvidenceError, match="probability zero"):
        pgm.query(net, one, {a: 1})


def grid(side, table):
    """A grid of variables of two states, each with the ones above and left of it as parents."""
    cells = {(i, j): pgm.Discrete(f"g{i}_{j}", 2) for i in range(side) for j in range(side)}
    cpds = []
    for (i, j), cell in cells.items():
        parents = [cells[k] for k in ((i - 1, j), (i, j - 1)) if k in cells]
        cpds.append(pgm.TableCPD(cell, tuple(parents), table=table(len(parents))))
    return cells, cpds


def some_zeros(parents):
    """A child may be 1 only where a parent is."""
    found = np.full((2,) * parents + (2,), 0.5)
    if parents:
        found[(0,) * parents] = [1.0, 0.0]
    return found


@pytest.fixture
def plans(monkeypatch):
    """Record the eliminations of what is left out."""
    used = []
    eliminate = left_out.eliminate

    def recorded(plan, evidence):
        used.append(plan)
        return eliminate(plan, evidence)

    monkeypatch.setattr(left_out, "eliminate", recorded)
    return used


def test_nothing_is_eliminated_without_zeros(plans):
    """A grid of 60 × 60 could not be summed out."""
    cells, cpds = grid(60, lambda parents: np.full((2,) * parents + (2,), 0.5))
    net = pgm.BayesianNetwork([*cpds, pgm.TableCPD(b, cells[59, 59], table=[[0.75, 0.25]] * 2)])
    assert pgm.query(net, b, {cells[59, 59]: 1}).values.tolist() == [0.75, 0.25]
    assert not plans


def test_above_the_limit_of_memory_it_is_left_undone(plans, monkeypatch):
    cells, cpds = grid(6, some_zeros)
    last = cells[5, 5]
    net = pgm.BayesianNetwork([*cpds, pgm.TableCPD(b, last, table=[[0.75, 0.25]] * 2)])
    # The corner is 1, though the cells of an antidiagonal are not.
    evidence = {last: 1} | {cell: 0 for (i, j), cell in cells.items() if i + j == 4}
    with pytest.raises(pgm.EvidenceError, match="probability zero"):
        pgm.query(net, b, evidence)
    assert pgm.query(net, b, {last: 1}).values.tolist() == [0.75, 0.25]
    assert plans
    plans.clear()
    monkeypatch.setattr(left_out.limits, "LIMIT", 16)
    assert pgm.query(net, b, evidence).values.tolist() == [0.75, 0.25]
    assert not plans


def test_zeros_that_exclude_nothing_are_left_out(plans):
    """Children without evidence, their parents in turn, and what no evidence touches."""
    cells, cpds = grid(30, some_zeros)
    first, second = cells[0, 0], cells[0, 1]
    net = pgm.BayesianNetwork([*cpds, pgm.TableCPD(b, second, table=[[0.75, 0.25]] * 2)])
    assert pgm.query(net, b, {first: 1, second: 1}).values.tolist() == [0.75, 0.25]
    assert not plans
    with pytest.raises(pgm.EvidenceError, match="probability zero"):
        pgm.query(net, b, {first: 0, second: 1})
