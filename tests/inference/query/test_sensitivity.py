"""Sensitivity to each entry, against the same network with the entry changed, by enumeration."""

import copy
import pickle

import numpy as np
import pytest
from discrete.enumeration import Enumeration, network
from discrete.test_trees import evidence, question
from numpy.testing import assert_allclose

import pgm
from pgm.examples import coin, pair, rain, rainy, side, still, wet


def changed(net, cpd, at, theta):
    """The network with one entry changed, and the others of its column in proportion."""
    table = np.array(cpd.table)
    column, state = table[at[:-1]], at[-1]
    total, left = column.sum(), np.delete(column, state)
    others = left / left.sum() if left.sum() else np.full(left.size, 1.0 / left.size)
    # Where the sum is one but for rounding, an entry of one leaves nothing.
    rest = total - theta if theta < min(total, 1.0) else 0.0
    table[at[:-1]] = np.insert(others * rest, state, theta)
    new = pgm.TableCPD(cpd.child, cpd.given, table=table)
    return pgm.BayesianNetwork([new if c is cpd else c for c in net.cpds])


def ends(net, cpd, at, event, states, weights):
    """p(event, evidence) and p(evidence) with an entry of zero, and of one."""
    found = []
    for theta in (0.0, 1.0):
        other = changed(net, cpd, at, theta)
        given = Enumeration(other, states, weights).evidence
        found.append((Enumeration(other, states | event, weights).evidence, given))
    return found


@pytest.mark.parametrize("seed", range(60))
def test_drawn_networks(seed):
    rng = np.random.default_rng(seed)
    net = network(seed, count=2 + seed % 5, largest=3, parents=2, zeros=0.2, deterministic=0.15)
    states, weights = question(net, seed)
    hidden = [v for v in net.variables if v not in states]
    if Enumeration(net, states, weights).evidence == 0.0 or not hidden:
        pytest.skip("impossible, or nothing hidden")
    chosen = rng.permutation(len(hidden))[: int(rng.integers(1, 3))]
    event = {hidden[k]: hidden[k].states[rng.integers(hidden[k].size)] for k in chosen}
    asked = net if seed % 2 else pgm.compile(net)
    found = pgm.sensitivity(asked, event, evidence(states, weights))
    present = Enumeration(net, states | event, weights).evidence
    present /= Enumeration(net, states, weights).evidence
    assert_allclose(found.probability, present, atol=1e-13)
    for cpd in net.cpds:
        own = found[cpd.child]
        assert own.cpd is cpd
        assert own.derivative.shape == cpd.table.shape
        half = own.probability(0.3)
        same = own.probability(cpd.table)
        assert_allclose(same, np.full(same.shape, present), atol=1e-12)
        if cpd.child.size == 1:
            assert (own.derivative == 0.0).all()
            continue
        a, b, c, d = own.coefficients
        for at in np.ndindex(cpd.table.shape):
            (j0, e0), (j1, e1) = ends(net, cpd, at, event, states, weights)
            theta = cpd.table[at]
            total = (1 - theta) * e0 + theta * e1
            slope = (j1 * e0 - j0 * e1) / total**2
            assert_allclose(own.derivative[at], slope, rtol=1e-9, atol=1e-11)
            for value, told in ((0.3, half[at]), (0.0, None), (1.0, None), (0.8, None)):
                given = (1 - value) * e0 + value * e1
                told = own.probability(value)[at] if told is None else told
                if given == 0.0:
                    assert np.isnan(told)
                    continue
                assert_allclose(told, ((1 - value) * j0 + value * j1) / given, atol=1e-12)
                quotient = (a[at] * value + b[at]) / (c[at] * value + d[at])
                assert_allclose(quotient, told, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_intervals(seed):
    """Inside P(θ) is within the bounds, outside it is not; of every entry, on a fine lattice."""
    net = network(seed, count=4, largest=3, parents=2)
    states, weights = question(net, seed)
    hidden = [v for v in net.variables if v not in states and v.size > 1]
    if not hidden:
        pytest.skip("nothing hidden")
    event = {hidden[0]: hidden[0].states[0]}
    found = pgm.sensitivity(net, event, evidence(states, weights))
    present = float(found.probability)
    for lowest, highest in ((0.9 * present, 1.0), (0.0, 0.5), (0.3, 0.6), (present, present)):
        for cpd in net.cpds:
            own = found[cpd.child]
            lower, upper = own.interval(lowest, highest)
            if lowest <= present <= highest:
                assert (lower <= cpd.table + 1e-9).all()
                assert (upper >= cpd.table - 1e-9).all()
            for theta in np.linspace(0.0, 1.0, 21):
                level = own.probability(theta)
                inside = (lower - 1e-9 <= theta) & (theta <= upper + 1e-9)
                well = (lowest + 1e-7 < level) & (level < highest - 1e-7)
                outside = (level < lowest - 1e-7) | (level > highest + 1e-7)
                assert (inside | ~well).all()
                assert not (
                    inside & outside & (lower + 1e-6 < theta) & (theta < upper - 1e-6)
                ).any()
    nothing = found[hidden[0]].interval(0.0, 1.0)
    assert (nothing[0] == 0.0).all()
    assert_allclose(nothing[1], 1.0)


def test_chan_and_darwiche():
    """Fire or tampering: the example of the paper's kind, by hand (Bayes' rule of two causes)."""
    fire, alarm = (pgm.Discrete(name, ("no", "yes")) for name in ("fire", "alarm"))
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(fire, table=[0.99, 0.01]),
            pgm.TableCPD(alarm, fire, table=[[0.98, 0.02], [0.1, 0.9]]),
        ]
    )
    found = pgm.sensitivity(net, {fire: "yes"}, {alarm: "yes"})
    assert_allclose(found.probability, 0.009 / (0.009 + 0.0198))
    # P(θ) = .009 / (.009 + .99 θ), θ the false alarms: half, where θ is 1/110.
    lower, upper = found[alarm].interval(lowest=0.5)
    assert lower[0, 1] == 0.0
    assert_allclose(upper[0, 1], 1 / 110)
    assert_allclose(found[alarm].derivative[0, 1], -0.009 * 0.99 / 0.0288**2)
    best = found.ranked(2)
    assert [(e.child, e.state) for e in best] == [(fire, "no"), (fire, "yes")]
    third = found.ranked(3)[2]
    assert (third.child, third.state, dict(third.given)) == (alarm, "no", {fire: "no"})
    assert third.value == 0.98
    assert repr(third) == "SensitiveEntry(alarm=no | fire=no: 0.98, derivative 10.7)"
    assert len(found.ranked(100)) == 6


def test_a_batch_equals_its_runs():
    net = network(3, count=6, zeros=0.1)
    v, other, *_ = (each for each in net.variables if each.size > 1)
    whole = pgm.sensitivity(net, {other: 0}, {v: [[0, 1, -1]]})
    assert whole.probability.shape == (1, 3)
    for cpd in net.cpds:
        assert whole[cpd.child].derivative.shape == (1, 3, *cpd.table.shape)
        for run, state in enumerate((0, 1, -1)):
            single = pgm.sensitivity(net, {other: 0}, {v: state} if state >= 0 else {})
            own, alone = whole[cpd.child], single[cpd.child]
            assert_allclose(own.derivative[0, run], alone.derivative, atol=1e-13)
            assert_allclose(own.probability(0.2)[0, run], alone.probability(0.2), atol=1e-13)
            lower, _ = own.interval(0.2, 0.7)
            assert_allclose(lower[0, run], alone.interval(0.2, 0.7)[0], atol=1e-10)
    with pytest.raises(pgm.EvidenceError, match="ranked for one set of evidence"):
        whole.ranked()


def test_an_event_of_probability_zero_that_an_entry_makes_possible():
    zero = pgm.BayesianNetwork(
        [pgm.TableCPD(rain, table=[1, 0]), pgm.TableCPD(wet, rain, table=[[0.7, 0.3], [0.1, 0.9]])]
    )
    found = pgm.sensitivity(zero, {rain: "yes"}, {wet: "yes"})
    assert found.probability == 0.0
    # P(θ) = .9 θ / (.3 (1 − θ) + .9 θ)
    assert_allclose(found[rain].derivative, [-3.0, 3.0])
    assert_allclose(found[rain].probability([0.5, 0.5]), [0.75, 0.75])
    assert (found[wet].derivative == 0.0).all()


def test_parts_of_their_own():
    """An event in two parts: each part's share counts for the entries of the other."""
    net = pgm.BayesianNetwork([*rainy.cpds, *coin.cpds])
    found = pgm.sensitivity(net, {rain: "yes", side: "heads"}, {wet: "yes"})
    alone = pgm.sensitivity(rainy, {rain: "yes"}, {wet: "yes"})
    assert_allclose(found.probability, 0.75 * 0.25)
    assert_allclose(found[wet].derivative, 0.25 * alone[wet].derivative)
    assert_allclose(found[side].derivative, [0.75, -0.75])


def test_a_column_that_is_rounded_keeps_its_sum():
    table = [0.333333, 0.333333, 0.333333]
    three = pgm.Discrete("three", 3)
    net = pgm.BayesianNetwork([pgm.TableCPD(three, table=table)])
    found = pgm.sensitivity(net, {three: 0})
    assert_allclose(found[three].probability(table), 1 / 3, rtol=1e-12)
    assert_allclose(found[three].probability(1.0), [1.0, 0.0, 0.0], atol=1e-12)
    assert_allclose(found[three].interval(0.5)[0], [0.4999995, 0.0, 0.0], atol=1e-12)


def test_a_thousand_children_and_small_numbers():
    """Evidence of e⁻²³⁰⁰ is no matter; the function of the root's entry is Bayes' rule."""
    cause = pgm.Discrete("cause", 2)
    seen = [pgm.Discrete(f"s{k}", 2) for k in range(1000)]
    cpds = [pgm.TableCPD(cause, table=[0.4, 0.6])]
    cpds += [pgm.TableCPD(s, cause, table=[[0.9, 0.1], [0.8997, 0.1003]]) for s in seen]
    found = pgm.sensitivity(pgm.BayesianNetwork(cpds), {cause: 1}, dict.fromkeys(seen, 1))
    ratio = 1.003**1000
    assert_allclose(found.probability, 0.6 * ratio / (0.4 + 0.6 * ratio), rtol=1e-10)
    slope = ratio / (0.4 + 0.6 * ratio) ** 2
    assert_allclose(found[cause].derivative, [-slope, slope], rtol=1e-9)
    odds = 1.5 * ratio
    assert_allclose(found[seen[7]].derivative[1, 1], odds / (1 + odds) ** 2 / 0.1003, rtol=1e-8)


def test_an_entry_so_near_one_that_the_others_are_lost_beside_it():
    """P(θ) of wet=no is by Bayes' rule; the evidence rests on an entry of 10⁻³⁰ alone."""
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(rain, table=[1.0, 1e-30]),
            pgm.TableCPD(wet, rain, table=[[1, 0], [0.5, 0.5]]),
        ]
    )
    found = pgm.sensitivity(net, {wet: "yes"})
    assert_allclose(found.probability, 5e-31)
    assert_allclose(found[rain].derivative, [-0.5, 0.5])
    known = pgm.sensitivity(net, {rain: "yes"}, {wet: "yes"})
    assert_allclose(known.probability, 1.0)
    # P(θ) = 5e-31 / (5e-31 + θ), θ of wet=yes without rain, which is zero.
    assert_allclose(known[wet].derivative[0], [2e30, -2e30], rtol=1e-12)


def test_it_is_a_value():
    found = pgm.sensitivity(rainy, {rain: "yes"}, {wet: "yes"})
    for twin in (copy.deepcopy(found), pickle.loads(pickle.dumps(found))):
        assert_allclose(twin[wet].derivative, found[wet].derivative)
        assert twin.event == {rain: "yes"}
    with pytest.raises(AttributeError):
        found.probability = 1.0
    with pytest.raises(ValueError, match="read-only"):
        found[wet].derivative[0] = 1.0
    with pytest.raises(TypeError):
        list(found)
    assert "wet=yes | rain=yes" in repr(found)


def test_loops_are_no_matter():
    ring = pgm.compile(network(2, count=8), method=pgm.Bethe())
    assert not ring.is_tree
    first = next(v for v in ring.network.variables if v.size > 1)
    one, other = (pgm.sensitivity(net, {first: 0}) for net in (ring, ring.network))
    assert_allclose(one[first].derivative, other[first].derivative)


def test_what_is_refused():
    event = {rain: "yes"}
    with pytest.raises(pgm.GraphError, match="this one is dynamic"):
        pgm.sensitivity(still, event)
    with pytest.raises(pgm.GraphError, match="networks of tables, and this one is"):
        pgm.sensitivity(pair, event)
    with pytest.raises(pgm.GraphError, match="factors without direction"):
        pgm.sensitivity(pgm.MarkovNetwork([pgm.Table(rain, [1.0, 2.0])]), event)
    with pytest.raises(pgm.ModelError, match="takes a network of tables or its compiled graph"):
        pgm.sensitivity(rain, event)
    with pytest.raises(pgm.EvidenceError, match="rain is observed"):
        pgm.sensitivity(rainy, event, {rain: "no"})
    for wrong in ({}, {rain: -1}, {rain: pgm.soft([0.5, 0.5])}, {rain: [0, 1]}):
        with pytest.raises(pgm.EvidenceError, match="the event is one state"):
            pgm.sensitivity(rainy, wrong)
    with pytest.raises(pgm.EvidenceError, match="the event maps variables to states; found str"):
        pgm.sensitivity(rainy, "rain")
    with pytest.raises(pgm.EvidenceError, match="evidence for side"):
        pgm.sensitivity(rainy, {side: 0})
    found = pgm.sensitivity(rainy, event, {wet: "yes"})
    with pytest.raises(pgm.EvidenceError, match="side has no table"):
        found[side]
    with pytest.raises(pgm.ModelError, match="count is how many entries"):
        found.ranked(0)
    for wrong in (1.5, -0.1, np.nan):
        with pytest.raises(pgm.ModelError, match="is a probability, from 0 to 1"):
            found[wet].probability(wrong)
    with pytest.raises(pgm.ModelError, match="must be numbers, not masked ones"):
        found[wet].probability(np.ma.masked_array([0.2, 0.3], [False, True]))
    with pytest.raises(pgm.ModelError, match=r"broadcast to \(2, 2\)"):
        found[wet].probability([0.1, 0.2, 0.3])
    for wrong in ((0.5, 0.4), (-1, 1), (0, 2), ("a", 1)):
        with pytest.raises(pgm.ModelError, match="lowest and highest"):
            found[wet].interval(*wrong)
    sure = pgm.BayesianNetwork(
        [pgm.TableCPD(rain, table=[1, 0]), pgm.TableCPD(wet, rain, table=[[1, 0], [0, 1]])]
    )
    with pytest.raises(pgm.EvidenceError, match="probability zero"):
        pgm.sensitivity(sure, event, {wet: "yes"})
