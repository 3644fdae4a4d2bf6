"""Impossible evidence in some of many runs: refused with the run, or allowed."""

import itertools

import numpy as np
import pytest

import pgm

a, b, c, d = (pgm.Discrete(name, size) for name, size in (("a", 2), ("b", 2), ("c", 3), ("d", 2)))
TABLES = {
    a: np.array([0.3, 0.7]),
    b: np.array([[1.0, 0.0], [0.4, 0.6]]),
    c: np.array([[0.5, 0.5, 0.0], [0.0, 0.2, 0.8]]),
    d: np.array([[0.9, 0.1], [0.0, 1.0], [0.5, 0.5]]),
}
NET = pgm.BayesianNetwork(
    [
        pgm.TableCPD(a, table=TABLES[a]),
        pgm.TableCPD(b, a, table=TABLES[b]),
        pgm.TableCPD(c, b, table=TABLES[c]),
        pgm.TableCPD(d, c, table=TABLES[d]),
    ]
)
GRAPH = pgm.compile(NET)
# Every state of a, c and d, each of them not observed too.
RECORDS = np.array(list(itertools.product((-1, 0, 1), (-1, 0, 1, 2), (-1, 0, 1))))
EVIDENCE = {a: RECORDS[:, 0], c: RECORDS[:, 1], d: RECORDS[:, 2]}


def by_enumeration(record):
    """p(evidence), and p(b, evidence), summed over the joint table."""
    joint = np.einsum("a,ab,bc,cd->abcd", *TABLES.values())
    i, k, m = (slice(None) if state < 0 else slice(state, state + 1) for state in record)
    joint = joint[i, :, k, m]
    return joint.sum(), joint.sum(axis=(0, 2, 3))


DUE = [by_enumeration(record) for record in RECORDS]
LOST = np.array([total == 0.0 for total, _ in DUE])


def test_some_are_impossible_and_some_are_not():
    assert 3 < LOST.sum() < len(LOST) - 3


@pytest.mark.parametrize("evidence", [EVIDENCE, {v: s.reshape(4, 9) for v, s in EVIDENCE.items()}])
@pytest.mark.parametrize("memory", [None, 4096])
def test_the_others_have_their_answers(evidence, memory):
    found = pgm.infer(GRAPH, evidence, impossible="allow", memory=memory)
    lead = next(iter(evidence.values())).shape
    assert found.log_evidence.shape == lead
    log_evidence, beliefs = found.log_evidence.ravel(), found[b].probabilities.reshape(-1, 2)
    assert np.isneginf(log_evidence[LOST]).all()
    assert np.isnan(beliefs[LOST]).all()
    for k in np.flatnonzero(~LOST):
        total, joint = DUE[k]
        assert log_evidence[k] == pytest.approx(np.log(total), abs=1e-12)
        np.testing.assert_allclose(beliefs[k], joint / total, atol=1e-12)
    pair = found.joint(b, d).values.reshape(-1, 2, 2)
    assert np.isnan(pair[LOST]).all()
    np.testing.assert_allclose(pair[~LOST].sum(axis=-1), beliefs[~LOST], atol=1e-12)
    asked = pgm.query(NET, b, evidence, impossible="allow").values.reshape(-1, 2)
    np.testing.assert_allclose(asked, beliefs, atol=1e-12)
    of_graph = pgm.query(GRAPH, b, evidence, impossible="allow").values.reshape(-1, 2)
    np.testing.assert_allclose(of_graph, beliefs, atol=1e-12)


def test_beliefs_of_clusters_are_zero_where_the_evidence_is_impossible():
    """Unnormalised they sum to p(evidence)."""
    found = pgm.infer(GRAPH, EVIDENCE, impossible="allow")
    for cluster in range(len(GRAPH)):
        belief = found.belief(cluster)
        sums = np.nansum(belief.values.reshape(len(RECORDS), -1), axis=1)
        total = sums * np.exp(belief.log_scale)
        np.testing.assert_allclose(total, [total for total, _ in DUE], atol=1e-12)
        assert found.potential(cluster).values.shape[0] in (1, len(RECORDS))


@pytest.mark.parametrize(
    "evidence",
    [
        {a: 0, c: [2, 0, 2], d: 1},
        {a: 0, c: pgm.soft([[0.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 2.0]]), d: 1},
        {a: ["0"] * 3, c: ["2", "0", "2"], d: ["1"] * 3},
    ],
)
def test_states_that_all_runs_share_and_weights(evidence):
    found = pgm.infer(GRAPH, evidence, impossible="allow")
    assert np.isneginf(found.log_evidence).tolist() == [True, False, True]
    np.testing.assert_allclose(found[b].probabilities[1], [1.0, 0.0])


def test_a_single_run_and_runs_that_are_all_impossible():
    single = pgm.infer(GRAPH, {a: 0, c: 2}, impossible="allow")
    assert np.isneginf(single.log_evidence)
    assert np.isnan(single[b].probabilities).all()
    assert "-inf" in repr(single)
    every = pgm.infer(GRAPH, {a: 0, c: [2, 2]}, impossible="allow")
    assert np.isneginf(every.log_evidence).all()
    assert np.isnan(pgm.query(NET, b, {a: 0, c: 2}, impossible="allow").values).all()


@pytest.mark.parametrize("asked", [lambda e: pgm.infer(GRAPH, e), lambda e: pgm.query(NET, b, e)])
def test_a_refusal_names_the_run_and_the_way_out(asked):
    with pytest.raises(pgm.EvidenceError, match=r'first in run 2\).*impossible="allow"') as caught:
        asked({a: [1, 0, 0], c: [2, 0, 2]})
    assert caught.value.run == 2
    with pytest.raises(pgm.EvidenceError) as caught:
        asked({a: 0, c: 2})
    assert caught.value.run is None
    assert "allow" not in str(caught.value)


def test_the_most_probable_states_of_impossible_evidence_are_refused():
    with pytest.raises(pgm.EvidenceError, match=r"first in run 1\)") as caught:
        pgm.most_probable(GRAPH, {a: [1, 0], c: [2, 2]})
    assert caught.value.run == 1
    assert "allow" not in str(caught.value)


def test_a_refusal_of_a_chain_names_the_run():
    s, o = pgm.Discrete("s", 2), pgm.Discrete("o", 2)
    chain = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(s, table=[1.0, 0.0])],
        [pgm.TableCPD(s, s.previous, table=np.eye(2))],
        [pgm.TableCPD(o, s, table=np.eye(2))],
    )
    with pytest.raises(pgm.EvidenceError, match=r"at step 2 .*first in run 1") as caught:
        pgm.filter(chain, {o: [[0, 0], [0, 1]]})
    assert (caught.value.run, caught.value.step) == (1, 2)


def test_where_it_is_not_for():
    with pytest.raises(pgm.ModelError, match='"raise" or "allow", not None'):
        pgm.infer(GRAPH, {}, impossible=None)
    loopy = pgm.compile(NET, method=pgm.Bethe())
    with pytest.raises(pgm.GraphError, match="two passes over a tree"):
        pgm.infer(loopy, {}, schedule=pgm.Flooding(), impossible="allow")
