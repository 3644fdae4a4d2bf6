"""Evidence for what a network does not have: what the refusal tells, for networks of each kind."""

import numpy as np
import pytest

import pgm
from pgm import Discrete, EvidenceError

A, B, U = pgm.variables("a b u")
WIDE = pgm.Variable("a", components=("east", "north"))
RAIN, WET = Discrete("rain", states=("no", "yes")), Discrete("wet", 3)
CPDS = [pgm.GaussianCPD(A, 0.0, 1.0), pgm.LinearGaussianCPD(B, {A: 1.0}, cov=1.0)]
CONTINUOUS = pgm.compile(pgm.BayesianNetwork(CPDS))
DISCRETE = pgm.compile(
    pgm.BayesianNetwork(
        [
            pgm.TableCPD(RAIN, table=[0.5, 0.5]),
            pgm.TableCPD(WET, RAIN, table=[[1, 0, 0], [0, 0.5, 0.5]]),
        ]
    )
)
DYNAMIC = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(A, 0.0, 1.0)],
    transition=[pgm.LinearGaussianCPD(A, {A.previous: 1.0, U: 1.0}, cov=1.0)],
    observation=[pgm.LinearGaussianCPD(B, {A: 1.0}, cov=1.0)],
)
UNROLLED = pgm.compile(DYNAMIC.unroll(2))
ITSELF = "which is no variable; use the variable itself, "


@pytest.mark.parametrize(
    ("graph", "key", "words"),
    [
        (CONTINUOUS, "a", f"evidence for 'a', {ITSELF}a"),
        (DISCRETE, "wet", f"evidence for 'wet', {ITSELF}wet"),
        (UNROLLED, "b", f"{ITSELF}b[0], b[1], b[2]"),
        (
            CONTINUOUS,
            "z",
            "'z', which is no variable; the network has the variables a, b",
        ),
        (DISCRETE, 0, "evidence for 0, which is no variable"),
        (CONTINUOUS, U, "evidence for u, which the network does not have; it has a, b"),
        (DISCRETE, A, "evidence for a, which the network does not have; it has rain, wet"),
        (
            CONTINUOUS,
            WIDE,
            "variable of that name is a different one, with components ('a'), angles () where "
            "this one has components ('east', 'north'), angles (); use that one",
        ),
        (
            CONTINUOUS,
            pgm.Variable("a", angles=("a",)),
            "angles () where this one has components ('a'), angles ('a')",
        ),
        (
            DISCRETE,
            Discrete("rain", 2),
            "is a different one, with states ('no', 'yes') where this one has states ('0', '1')",
        ),
        (DISCRETE, pgm.Variable("rain"), "where this one has components ('rain')"),
        (
            UNROLLED,
            B,
            "for b, which the network has only as b[0], b[1], b[2]; name the step, b.at(k)",
        ),
        (UNROLLED, B.at(3), "for b[3], which the network has only as b[0], b[1], b[2]; use what"),
        (CONTINUOUS, A.at(0), "for a[0], which the network has only as a; use what it has"),
        (CONTINUOUS, A.previous, "for a[t-1], which the network has only as a; use what it has"),
    ],
)
def test_what_the_refusal_tells(graph, key, words):
    with pytest.raises(EvidenceError) as caught:
        pgm.infer(graph, {key: 1})
    assert words in str(caught.value)
    assert caught.value.variable == (key if isinstance(key, pgm.Variable) else None)


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("b", f"evidence for 'b', {ITSELF}b"),
        ("z", "'z', which is no variable; the network has the variables a, b, u"),
        (pgm.Variable("z"), "evidence for z, which the network does not have; it has a, b, u"),
        (pgm.Variable("b", ("one", "two")), "is a different one, with components ('b')"),
        (B.at(1), "the single step b[1]; give b an array (..., T, d) of steps 1..T or, where"),
        (A, "evidence for a, which is hidden"),
        (A.at(1), "evidence for a[1], which is hidden"),
        (A.previous, "evidence for a[t-1], which is hidden"),
    ],
)
def test_what_the_refusal_of_a_dynamic_network_tells(key, words):
    rows = np.zeros((2, 1))
    with pytest.raises(EvidenceError) as caught:
        pgm.smooth(DYNAMIC, {U: rows, key: rows})
    assert words in str(caught.value)
    assert caught.value.variable == (key if isinstance(key, pgm.Variable) else None)


@pytest.mark.parametrize("key", ["x", "v1", pgm.Variable("x"), pgm.Variable("v1", ("e", "n"))])
def test_the_refusal_does_not_grow_with_the_network(key):
    many = pgm.variables([f"v{k}" for k in range(700)])
    graph = pgm.compile(pgm.BayesianNetwork(pgm.GaussianCPD(v, 0.0, 1.0) for v in many))
    with pytest.raises(EvidenceError) as caught:
        pgm.infer(graph, {key: 1.0})
    assert len(str(caught.value)) < 250
    assert str(key) != "x" or "v0, v1, v10," in str(caught.value)
    assert str(key) != "x" or "... (700 in all)" in str(caught.value)


def test_a_variable_with_many_states():
    many = Discrete("many", 1000)
    graph = pgm.compile(pgm.BayesianNetwork([pgm.TableCPD(many, table=np.full(1000, 1e-3))]))
    for evidence in (
        {many: "none"},
        {many: 1.5},
        {many: pgm.constant(1)},
        {many: pgm.soft([0.5, 0.5])},
        {many: pgm.soft({"0": 1.0})},
        {Discrete("many", 1001): 0},
    ):
        with pytest.raises(EvidenceError, match=r"'7', \.\.\. \(1000 in all\)") as caught:
            pgm.infer(graph, evidence)
        assert len(str(caught.value)) < 300


def test_as_many_runs_as_do_not_broadcast_are_named():
    many = pgm.variables([f"v{k}" for k in range(40)])
    graph = pgm.compile(pgm.BayesianNetwork(pgm.GaussianCPD(v, 0.0, 1.0) for v in many))
    evidence = {v: np.zeros((3, 1)) for v in many} | {many[-1]: np.zeros((4, 2, 1))}
    with pytest.raises(EvidenceError, match=r"one set of runs: v0 \(3,\), v39 \(4, 2\); give"):
        pgm.infer(graph, evidence)
