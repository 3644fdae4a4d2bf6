"""Single queries against the table of all assignments, and against calibrated trees."""

from itertools import pairwise

import dags
import numpy as np
import pytest
from discrete.enumeration import Enumeration, network
from hypothesis import given, settings
from hypothesis import strategies as st

import pgm
from models.discrete import asia, cancer, rain, sprinkler, wet, xray
from pgm.inference.query import elimination, question
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT

CLOSE = {"rtol": 0.0, "atol": 1e-12}


@pytest.fixture
def routes(monkeypatch):
    """Record which way each answer was computed."""
    used = []
    for name in ("_eliminated", "_read"):
        found = getattr(question, name)

        def recorded(*args, found=found, name=name, **options):
            used.append(name)
            return found(*args, **options)

        monkeypatch.setattr(question, name, recorded)
    return used


@st.composite
def questions(draw):
    """Draw a random network, states and weights for some variables, and what to ask for."""
    seed = draw(st.integers(0, 2**32))
    net = network(
        seed,
        count=draw(st.integers(1, 9)),
        parents=draw(st.integers(0, 3)),
        zeros=draw(st.sampled_from([0.0, 0.2])),
        deterministic=draw(st.sampled_from([0.0, 0.2])),
    )
    states, weights, hidden = {}, {}, []
    for variable in net.variables:
        kind = draw(st.sampled_from(["hidden", "hidden", "state", "weights"]))
        if kind == "state":
            states[variable] = draw(st.integers(0, variable.size - 1))
            continue
        hidden.append(variable)
        if kind == "weights":
            weights[variable] = np.random.default_rng(seed).random(variable.size)
    wanted = draw(st.permutations(hidden))[:3] if hidden else []
    return net, states, weights, wanted


@given(questions())
@settings(max_examples=120)
def test_random_networks(question):
    net, states, weights, wanted = question
    if not wanted:
        return
    truth = Enumeration(net, states, weights)
    evidence = states | {variable: pgm.soft(given) for variable, given in weights.items()}
    if truth.evidence == 0.0:
        # What contradicts itself may lie apart from what is asked.
        with pytest.raises(pgm.EvidenceError, match="has probability zero: that for"):
            pgm.query(net, wanted, evidence)
        assert np.isnan(pgm.query(net, wanted, evidence, impossible="allow").values).all()
        return
    found = pgm.query(net, wanted, evidence)
    assert found.scope == tuple(wanted)
    assert found.log_scale == 0.0
    assert found.values.shape == tuple(v.size for v in wanted)
    np.testing.assert_allclose(found.values, truth.marginal(*wanted), **CLOSE)


@pytest.mark.parametrize("seed", range(40))
def test_impossible_evidence_about_all_variables_asked_for(seed):
    net = network(400 + seed, zeros=0.2, deterministic=0.3)
    rng = np.random.default_rng(seed)
    weights = {v: rng.permutation(v.size) == 0 for v in net.variables if v.size > 1}
    hidden = {v: pgm.soft(given) for v, given in weights.items()}
    due = Enumeration(net, {}, weights).evidence
    if due > 0.0:
        assert pgm.query(net, tuple(weights)[:4], hidden).values.max() == 1.0
        return
    with pytest.raises(pgm.EvidenceError, match="has probability zero: that for") as caught:
        pgm.query(net, tuple(weights), hidden)
    # What is named does contradict itself.
    named = str(caught.value).split("that for (")[1].split(")")[0].split(", ")
    guilty = {v: given for v, given in weights.items() if repr(v) in named}
    assert Enumeration(net, {}, guilty).evidence == 0.0


@pytest.mark.parametrize("seed", range(20))
def test_both_ways_give_the_joint_of_a_posterior(seed, routes, monkeypatch):
    net = network(300 + seed, count=12, before=4)
    graph = pgm.compile(net)
    rng = np.random.default_rng(seed)
    order = [net.variables[k] for k in rng.permutation(12)]
    batch = {
        order[0]: rng.integers(-1, order[0].size, size=(3, 1)),
        order[1]: rng.integers(0, order[1].size, size=4),
        order[2]: pgm.soft(0.1 + rng.random((3, 1, order[2].size))),
        order[3]: int(rng.integers(order[3].size)),
        order[4]: pgm.soft(0.1 + rng.random(order[4].size)),
        order[5]: np.array([0]),
        order[6]: np.array([-1]),
    }
    batch[order[0]][1] = -1
    wanted = (order[9], order[2], order[0])
    due = pgm.infer(graph, batch).joint(*wanted).values
    for cost, way in ((0, "_read"), (10**9, "_eliminated")):
        monkeypatch.setattr(question, "PASS", cost)
        monkeypatch.setattr(question, "ENTRY", cost)
        found = pgm.query(graph, wanted, batch)
        assert found.values.shape == (3, 4, *(v.size for v in wanted))
        np.testing.assert_allclose(found.values, due, **CLOSE)
        assert set(routes) <= {way}
        routes.clear()


def test_the_way_depends_on_what_it_takes(routes):
    small = asia()
    pgm.query(small, xray, {cancer: "yes"})
    # A tree of few entries answers at once; a part of a large one costs less than all of it.
    pgm.query(pgm.compile(small), xray)
    net = dags.discrete(dags.grid(9))
    pgm.query(pgm.compile(net), net.variables[0], {})
    loopy = pgm.compile(small, method=pgm.Bethe())
    found = pgm.query(loopy, xray)
    np.testing.assert_allclose(found.values, pgm.query(small, xray).values, **CLOSE)
    assert routes == ["_eliminated", "_read", "_eliminated", "_eliminated", "_eliminated"]


def test_runs_in_pieces(monkeypatch):
    net = network(5, count=12, before=4)
    seen = net.sample(100, rng=1)
    evidence = {v: seen[v] for v in net.variables[6:]}
    wanted = net.variables[:3]
    whole = pgm.query(net, wanted, evidence)
    counts = []
    eliminate = elimination.eliminate

    def counted(plan, piece):
        counts.append(piece.runs)
        return eliminate(plan, piece)

    monkeypatch.setattr(question, "eliminate", counted)
    monkeypatch.setattr(question.limits, "BATCH", 1000)
    np.testing.assert_array_equal(pgm.query(net, wanted, evidence).values, whole.values)
    assert sum(counts) == 100
    assert len(counts) > 3
    for run in (0, 50, 99):
        alone = pgm.query(net, wanted, {v: int(s[run]) for v, s in evidence.items()})
        np.testing.assert_allclose(whole.values[run], alone.values, **CLOSE)


def test_evidence_that_does_not_bear_leaves_its_runs():
    a, b, c = (pgm.Discrete(name, 2) for name in "abc")
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(a, table=[0.3, 0.7]),
            pgm.TableCPD(b, a, table=[[0.5, 0.5], [0.1, 0.9]]),
            pgm.TableCPD(c, table=[1.0, 0.0]),
        ]
    )
    found = pgm.query(net, a, {b: 1, c: [[0], [0], [-1]]})
    assert found.values.shape == (3, 1, 2)
    np.testing.assert_allclose(found.values, [[[0.15 / 0.78, 0.63 / 0.78]]] * 3)
    # Evidence of probability zero that does bear is refused, in the run that has it.
    with pytest.raises(pgm.EvidenceError, match=r"zero \(first in run \(1, 0\)\)"):
        pgm.query(net, (a, c), {b: 1, c: pgm.soft([[[1, 0]], [[0, 1]], [[1, 1]]])})


def test_a_name_and_an_index():
    net = sprinkler()
    found = pgm.query(net, rain, {wet: "yes"})
    assert float(found["yes"]) == pytest.approx(0.70792767)
    np.testing.assert_array_equal(found.values, pgm.query(net, [rain], {wet: 1}).values)


@pytest.fixture
def kernels(monkeypatch):
    """Record which semirings are used."""
    used = []
    result = elimination.tables

    def recorded(plan, evidence, semiring):
        used.append(semiring)
        return result(plan, evidence, semiring)

    monkeypatch.setattr(elimination, "tables", recorded)
    return used


def hidden_markov(count):
    rng = np.random.default_rng(0)
    states = [pgm.Discrete(f"x{t}", 4) for t in range(count)]
    readings = [pgm.Discrete(f"z{t}", 4) for t in range(count)]
    step, sensor = (rng.dirichlet(np.full(4, 0.3), 4) for _ in range(2))
    cpds = [pgm.TableCPD(states[0], table=step[0])]
    cpds += [pgm.TableCPD(b, a, table=step) for a, b in pairwise(states)]
    cpds += [pgm.TableCPD(z, x, table=sensor) for x, z in zip(states, readings, strict=True)]
    return pgm.BayesianNetwork(cpds), states, readings


def test_a_long_chain_does_not_underflow(kernels):
    net, states, readings = hidden_markov(1000)
    drawn = net.sample(rng=1)
    evidence = {z: int(drawn[z]) for z in readings}
    posterior = pgm.infer(pgm.compile(net), evidence)
    assert posterior.log_evidence < -750  # beyond what a number holds
    found = pgm.query(net, states[500], evidence)
    np.testing.assert_allclose(found.values, posterior[states[500]].values, atol=1e-10)
    ends = pgm.query(net, (states[999], states[0]), evidence)
    due = posterior.joint(states[999], states[0]).values
    np.testing.assert_allclose(ends.values, due, atol=1e-10)
    assert kernels == [SUM_PRODUCT, SUM_PRODUCT]


def test_what_underflows_is_computed_with_logarithms(kernels):
    a, b, c, d = (pgm.Discrete(name, ("no", "yes")) for name in "abcd")
    rare = [[1e-200, 1.0 - 1e-200], [0.5, 0.5]]
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(a, table=[0.4, 0.6]),
            pgm.TableCPD(b, a, table=rare),
            pgm.TableCPD(c, a, table=rare),
            pgm.TableCPD(d, a, table=[[0.5, 0.5], [1.0, 0.0]]),
        ]
    )
    found = pgm.query(net, (a, c), {b: "no", c: pgm.soft([1, 1e-200]), d: "yes"})
    np.testing.assert_allclose(found.values, [[0.5, 0.5], [0.0, 0.0]], rtol=1e-12)
    assert kernels == [SUM_PRODUCT, LOG_SUM_PRODUCT]
    batch = {b: [0, 1], c: [0, 1], d: [1, 1]}
    np.testing.assert_allclose(pgm.query(net, a, batch).values, [[1.0, 0.0]] * 2, rtol=1e-12)
