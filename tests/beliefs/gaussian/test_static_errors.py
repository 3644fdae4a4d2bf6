"""What is refused of a static Gaussian network: evidence, questions, schedules."""

import numpy as np
import pytest
from textbooks import refusal

import pgm
from pgm import EvidenceError, GraphError, ModelError

a, b, c, d, other = pgm.variables("a b c d other")
p = pgm.Variable("p", ("east", "north"))
rain = pgm.Discrete("rain", states=("no", "yes"))
NET = pgm.BayesianNetwork(
    [
        pgm.GaussianCPD(a, 0.0, 1.0),
        pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0),
        pgm.LinearGaussianCPD(c, {b: 1.0}, cov=1.0),
        pgm.LinearGaussianCPD(p, {c: [[1.0], [0.0]]}, cov=np.eye(2)),
        pgm.LinearGaussianCPD(d, {a: 1.0}, cov=1.0),
    ]
)
TREE = pgm.ClusterGraph(NET, [{a, b}, {b, c}, {c, p}, {a, d}])
POSTERIOR = pgm.infer(TREE, {p: [1.0, 0.0]})
SQUARE = pgm.BayesianNetwork(
    [
        pgm.GaussianCPD(a, 0.0, 1.0),
        pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0),
        pgm.LinearGaussianCPD(c, {b: 1.0}, cov=1.0),
        pgm.LinearGaussianCPD(d, {c: 1.0, a: 1.0}, cov=1.0),
    ]
)
LOOP = pgm.ClusterGraph(
    SQUARE,
    [{a, b}, {b, c}, {a, c, d}],
    {(0, 1): {b}, (1, 2): {c}, (0, 2): {a}},
)


def evidence_row(name, evidence, *words, **attributes):
    return refusal(name, lambda: pgm.infer(TREE, evidence), EvidenceError, *words, **attributes)


def infer_row(name, call, error, *words):
    return refusal(name, call, error, *words)


EVIDENCE = [
    evidence_row(
        "an unknown variable", {other: 1.0}, "other", "does not have", "a", variable=other
    ),
    evidence_row("a discrete variable", {rain: "yes"}, "rain", "does not have", variable=rain),
    evidence_row("a name", {"a": 1.0}, "'a'", "no variable", "use the variable itself, a"),
    evidence_row("a state", {a: "yes"}, "a", "numbers", "str", variable=a),
    evidence_row(
        "weights of states", {a: pgm.soft([0.5, 0.5])}, "a", "discrete variables", variable=a
    ),
    evidence_row("complex", {a: 1j}, "a", "numbers", variable=a),
    evidence_row("ragged", {p: [[1.0], [1.0, 2.0]]}, "p", "numbers", variable=p),
    evidence_row("a number for a vector", {p: 1.0}, "p", "()", "(..., 2)", variable=p),
    evidence_row(
        "three for two", {p: [1.0, 2.0, 3.0]}, "p", "(3,)", "('east', 'north')", variable=p
    ),
    evidence_row("runs of a scalar", {a: [1.0, 2.0]}, "a", "(2,)", "value[..., None]", variable=a),
    evidence_row("infinity", {a: np.inf}, "a", "infinite", variable=a),
    evidence_row("infinity in a part", {p: [np.nan, np.inf]}, "p", "infinite", variable=p),
    evidence_row(
        "sightings", {a: pgm.sightings([[1.0]], step=[0])}, "a", "dynamic networks", variable=a
    ),
    evidence_row("no runs", {a: np.zeros((0, 1))}, "(0,)", "no run"),
    evidence_row(
        "runs that do not fit",
        {a: np.zeros((2, 1)), p: np.zeros((3, 2)), d: 1.0},
        "do not broadcast",
        "a (2,)",
        "p (3,)",
    ),
]


def runs_of_the_model():
    net = NET.replace(pgm.GaussianCPD(a, np.zeros((4, 1)), 1.0))
    return pgm.infer(pgm.compile(net), {d: np.zeros((3, 1))})


CALLS = [
    infer_row("runs of the model", runs_of_the_model, EvidenceError, "d (3,)", "the model (4,)"),
    infer_row("a network for a graph", lambda: pgm.infer(NET, {}), GraphError, "pgm.compile("),
    infer_row(
        "a list of evidence", lambda: pgm.infer(TREE, [(a, 1.0)]), EvidenceError, "maps", "list"
    ),
    infer_row("no evidence", lambda: pgm.infer(TREE, None), EvidenceError, "NoneType"),
    infer_row(
        "filtering",
        lambda: pgm.infer(TREE, {}, schedule=pgm.Filtering()),
        GraphError,
        "only a dynamic network is filtered",
        "leave the schedule out",
    ),
    infer_row(
        "a loop without a schedule",
        lambda: pgm.infer(LOOP, {}),
        GraphError,
        "has loops",
        "schedule=pgm.Flooding()",
    ),
    infer_row(
        "calibration of a loop",
        lambda: pgm.infer(LOOP, {}, schedule=pgm.Calibration()),
        GraphError,
        "has loops",
        "Calibration(",
        "pgm.Flooding()",
    ),
    infer_row(
        "smoothing of a loop",
        lambda: pgm.infer(LOOP, {}, schedule=pgm.Smoothing()),
        GraphError,
        "has loops",
    ),
    infer_row(
        "a schedule's name",
        lambda: pgm.infer(TREE, {}, schedule="flooding"),
        ModelError,
        "'flooding' is no schedule",
        "pgm.Flooding()",
    ),
    infer_row(
        "a schedule's class",
        lambda: pgm.infer(TREE, {}, schedule=pgm.Calibration),
        ModelError,
        "is no schedule",
    ),
    infer_row(
        "a lineariser's class",
        lambda: pgm.infer(TREE, {}, lineariser=pgm.Taylor),
        ModelError,
        "is no lineariser",
        "pgm.Taylor()",
    ),
    infer_row(
        "a lineariser's name",
        lambda: pgm.infer(TREE, {}, lineariser="taylor"),
        ModelError,
        "'taylor' is no lineariser",
    ),
    infer_row(
        "no iterations",
        lambda: pgm.Calibration(iterations=0),
        ModelError,
        "iterations",
        "1 or more",
    ),
]


def asked(name, call, error, *words, **attributes):
    return refusal(name, lambda: call(POSTERIOR), error, *words, **attributes)


QUESTIONS = [
    asked("a name", lambda q: q["a"], EvidenceError, "by variable", "'a'"),
    asked("an index", lambda q: q[0], EvidenceError, "by variable"),
    asked("several at once", lambda q: q[a, b], EvidenceError, "joint(a, b)"),
    asked("an observed one", lambda q: q[p], EvidenceError, "p is observed", variable=p),
    asked("an unknown one", lambda q: q[other], EvidenceError, "other", "a, b, c", variable=other),
    asked("one of a step", lambda q: q[a.at(1)], EvidenceError, "a[1]", variable=a.at(1)),
    asked("a joint of nothing", lambda q: q.joint(), EvidenceError, "one or more"),
    asked("a joint with an observed one", lambda q: q.joint(a, p), EvidenceError, "observed"),
    asked("a joint with an unknown one", lambda q: q.joint(a, other), EvidenceError, "other"),
    asked("a joint of names", lambda q: q.joint("a", "b"), ModelError, "'a'"),
    asked("a joint of one twice", lambda q: q.joint(a, a), ModelError, "a", "twice"),
    asked(
        "clusters not joined",
        lambda q: q.message(0, 2),
        GraphError,
        "not joined",
        "(1, 3)",
        cluster=0,
    ),
    asked("a cluster and itself", lambda q: q.message(1, 1), GraphError, "not joined", cluster=1),
    asked("a message from nowhere", lambda q: q.message(7, 0), GraphError, "no cluster 7", "0..3"),
    asked("a message from the end", lambda q: q.message(-1, 0), GraphError, "no cluster -1"),
    asked("a belief of nothing", lambda q: q.belief(4), GraphError, "no cluster 4", cluster=4),
    asked("a belief of a variable", lambda q: q.belief(a), GraphError, "no cluster a"),
]


@pytest.mark.parametrize("row", EVIDENCE + CALLS + QUESTIONS, ids=lambda row: row.name)
def test_refusals(row):
    row.check()


def test_a_joint_across_clusters_of_a_loop():
    """There is no tree between them; within a cluster there is one."""
    posterior = pgm.infer(LOOP, {}, schedule=pgm.Flooding())
    assert posterior.joint(a, d).mean.shape == (2,)
    with pytest.raises(GraphError, match=r"no cluster holds all of \(b, d\).*junction tree"):
        posterior.joint(b, d)


def test_nonlinear_noise_that_is_no_covariance():
    u = pgm.Variable("u")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, {a: 1.0}, cov=pgm.noise(lambda u: u[..., None], given=(u,))),
        ]
    )
    graph = pgm.compile(net)
    assert pgm.infer(graph, {u: 2.0})[b].cov == pytest.approx(3.0)
    with pytest.raises(ModelError, match="noise of the CPD of b") as caught:
        pgm.infer(graph, {u: [[1.0], [-1.0]]})
    assert caught.value.variable == b
    assert caught.value.cpd.child == b
