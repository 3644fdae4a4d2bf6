"""What `pgm.query` refuses, by name."""

import dags
import pytest
import templates
from discrete.enumeration import network

import pgm
from models.discrete import asia, cancer, either, smoking, tuberculosis, visit, xray
from pgm.schedules import limits


def test_observed_and_unknown_variables():
    net = asia()
    with pytest.raises(pgm.EvidenceError, match="xray is observed: its value is its") as caught:
        pgm.query(net, (visit, xray), {xray: "yes"})
    assert caught.value.variable == xray
    with pytest.raises(pgm.EvidenceError, match="xray is observed"):
        pgm.query(net, xray, {xray: ["yes", "no"]})
    assert pgm.query(net, xray, {xray: ["yes", -1]}).values[0].tolist() == [0.0, 1.0]
    stranger = pgm.Discrete("stranger", 2)
    with pytest.raises(pgm.EvidenceError, match="query of stranger, which the network does not"):
        pgm.query(net, stranger)
    with pytest.raises(pgm.EvidenceError, match="'visit', which is no variable; use the variable"):
        pgm.query(net, "visit")
    with pytest.raises(pgm.EvidenceError, match="'visit', which is no variable; use the variable"):
        pgm.query(net, [xray, "visit"])
    with pytest.raises(pgm.EvidenceError, match=r"query of \[xray\], which is no variable"):
        pgm.query(net, [[xray]])
    with pytest.raises(pgm.EvidenceError, match="takes one or more variables"):
        pgm.query(net, [])
    with pytest.raises(pgm.ModelError, match="holds xray twice"):
        pgm.query(net, [xray, xray])
    for asked in ({xray, visit}, frozenset((xray, visit))):
        with pytest.raises(pgm.ModelError, match="asked for is a set, which has no order; give a"):
            pgm.query(net, asked)
    assert pgm.query(net, {xray}).scope == (xray,)


def test_evidence_that_does_not_fit():
    net = asia()
    with pytest.raises(pgm.EvidenceError, match="evidence for visit is 'maybe'"):
        pgm.query(net, xray, {visit: "maybe"})
    with pytest.raises(pgm.EvidenceError, match=r"found list.*pgm\.records"):
        pgm.query(net, xray, [1])


def test_networks_of_other_kinds():
    with pytest.raises(pgm.ModelError, match="a network without time or its compiled graph, not 3"):
        pgm.query(3, xray)
    with pytest.raises(pgm.GraphError, match=r"is continuous; .*pgm\.infer\(pgm\.compile"):
        pgm.query(dags.continuous(dags.chain(2)), xray)
    with pytest.raises(pgm.GraphError, match=r"is continuous; .*pgm\.infer\(pgm\.compile"):
        pgm.query(pgm.compile(dags.continuous(dags.chain(2))), xray)
    model = pgm.DynamicBayesianNetwork(
        [templates.start(templates.A)],
        [pgm.LinearGaussianCPD(templates.A, {templates.A.previous: 1.0}, cov=1.0)],
    )
    for dynamic in (model, pgm.compile(model, steps=3)):
        with pytest.raises(pgm.GraphError, match=r"is dynamic; .*pgm\.smooth"):
            pgm.query(dynamic, templates.A)


def test_evidence_of_probability_zero():
    net = asia()
    impossible = {tuberculosis: "yes", either: "no", smoking: "yes"}
    for given in (net, pgm.compile(net)):
        with pytest.raises(pgm.EvidenceError, match="the evidence has probability zero: that for"):
            pgm.query(given, xray, {**impossible, either: pgm.soft([1.0, 0.0])})
        batch = {tuberculosis: [0, 1, 1], either: pgm.soft([[1, 0], [1, 1], [1, 0]])}
        with pytest.raises(pgm.EvidenceError, match=r"zero \(first in run 2\)") as caught:
            pgm.query(given, (xray, cancer), batch)
        assert "(tuberculosis, either) contradicts itself" in str(caught.value)
        assert caught.value.variable == tuberculosis
    with pytest.raises(pgm.EvidenceError) as caught:
        pgm.query(net, (xray, cancer), batch)
    assert "for all states of (" in str(caught.value)
    assert "Leave some of it out" in str(caught.value)


def test_tables_that_are_too_large(monkeypatch):
    net = network(2, count=14, largest=3, parents=3)
    wanted = net.variables[:9]
    monkeypatch.setattr(limits, "LIMIT", 2**4)
    with pytest.raises(pgm.GraphError, match=r"needs tables that are too large: .*Ask for fewer"):
        pgm.query(net, wanted)
    monkeypatch.setattr(limits, "LIMIT", 2**10)
    with pytest.raises(
        pgm.GraphError, match=r"for 1000 runs, where .* ask with fewer runs at once"
    ):
        pgm.query(asia(), (xray, cancer), {visit: [0, 1] * 500})
