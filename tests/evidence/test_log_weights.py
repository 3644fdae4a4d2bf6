"""Soft evidence by log-weights, whose exponentials no float may hold: against enumeration."""

from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import logsumexp

import pgm

A, B, C, D = (pgm.Discrete(name, size) for name, size in zip("abcd", (2, 3, 2, 3), strict=True))
VARIABLES = A, B, C, D
# From a common factor that changes nothing to such that no float holds, and that eat digits.
SHIFTS = (0.0, -900.0, 900.0, -1e6, 2.0**60)


def drawn(rng, *shape):
    table = rng.random(shape) + 0.05
    return table / table.sum(axis=-1, keepdims=True)


def networks():
    """The same joint as a Bayesian network, as a Markov network, and its logarithms."""
    rng = np.random.default_rng(5)
    cpds = [
        pgm.TableCPD(A, table=drawn(rng, 2)),
        pgm.TableCPD(B, given=A, table=drawn(rng, 2, 3)),
        pgm.TableCPD(C, given=A, table=drawn(rng, 2, 2)),
        pgm.TableCPD(D, given=(B, C), table=drawn(rng, 3, 2, 3)),
    ]
    joint = np.einsum("a,ab,ac,bcd->abcd", *(cpd.table for cpd in cpds))
    factors = [pgm.Table((*cpd.given, cpd.child), cpd.table) for cpd in cpds]
    return pgm.BayesianNetwork(cpds), pgm.MarkovNetwork(factors), np.log(joint)


DIRECTED, UNDIRECTED, LOGS = networks()
BOTH = pytest.mark.parametrize("network", [DIRECTED, UNDIRECTED], ids=["directed", "undirected"])


def weighted(logs, evidence):
    """The log-joint with log-weights, (sizes...)."""
    for variable, weights in evidence.items():
        shape = [1] * 4
        shape[VARIABLES.index(variable)] = variable.size
        logs = logs + np.reshape(weights, shape)
    return logs


def marginal(logs, variable):
    axes = tuple(k for k, v in enumerate(VARIABLES) if v != variable)
    own = logsumexp(logs, axis=axes)
    return np.exp(own - logsumexp(own))


def soft(evidence, shift=0.0):
    return {v: pgm.soft(np.add(w, shift), log=True) for v, w in evidence.items()}


# A weight of zero among others of ordinary size.
MODERATE = {B: [0.5, -1.5, -np.inf], D: [-2.0, 0.25, 1.0]}
# Weights against one another, none of which is a number beside the largest.
EXTREME = {A: [0.0, -900.0], B: [-901.0, 0.0, -np.inf], C: [-2000.0, 0.0], D: [0.0, -1e5, 1e-3]}


@BOTH
@pytest.mark.parametrize("shift", SHIFTS)
def test_a_common_factor_enters_the_log_evidence_alone(network, shift):
    graph = pgm.compile(network)
    logs = weighted(LOGS, MODERATE)
    # 2⁶⁰ holds no digits behind the point, and the weights then are what floats make of them.
    told = {v: np.add(w, shift) - shift for v, w in MODERATE.items()}
    logs = weighted(LOGS, told)
    due = logsumexp(logs) + 2 * shift
    for _ in range(2):  # the first question, and the next ones, by a plan
        found = pgm.infer(graph, soft(MODERATE, shift))
        assert_allclose(found.log_evidence, due, rtol=1e-14, atol=1e-13)
        for variable in VARIABLES:
            assert_allclose(found[variable].probabilities, marginal(logs, variable), rtol=1e-12)
    joint = np.exp(logsumexp(logs, axis=(1, 2)) - logsumexp(logs))
    assert_allclose(found.joint(A, D).probabilities, joint, rtol=1e-12)
    assert_allclose(pgm.query(network, (A, D), soft(MODERATE, shift)).probabilities, joint)
    for cluster in range(len(graph)):
        own = found.belief(cluster)
        assert_allclose(own.log_scale + np.log(own.values.sum()), due, rtol=1e-12, atol=1e-12)


@BOTH
def test_runs_of_different_sizes(network):
    rng = np.random.default_rng(1)
    shift = np.array([0.0, -900.0, 1e4, -40.0])
    weights = rng.normal(size=(4, 3)) + shift[:, None]
    weights[3] = [0.0, -900.0, -np.inf]
    graph = pgm.compile(network)
    found = pgm.infer(graph, {D: pgm.soft(weights, log=True), C: [0, 1, -1, 1]})
    asked = pgm.query(network, A, {D: pgm.soft(weights, log=True), C: [0, 1, -1, 1]})
    best = pgm.most_probable(graph, {D: pgm.soft(weights, log=True), C: [0, 1, -1, 1]})
    for run, state in enumerate((0, 1, None, 1)):
        known = {} if state is None else {C: np.where(np.arange(2) == state, 0.0, -np.inf)}
        logs = weighted(LOGS, {D: weights[run], **known})
        assert_allclose(found.log_evidence[run], logsumexp(logs), rtol=1e-14, atol=1e-13)
        for variable in (A, B, D):
            own = found[variable].probabilities[run]
            assert_allclose(own, marginal(logs, variable), rtol=1e-11)
        assert_allclose(asked.probabilities[run], marginal(logs, A), rtol=1e-11)
        assert_allclose(best.log_probability[run], logs.max(), rtol=1e-14, atol=1e-13)


@BOTH
def test_ratios_that_no_float_holds(network):
    graph = pgm.compile(network)
    logs = weighted(LOGS, EXTREME)
    for _ in range(2):
        found = pgm.infer(graph, soft(EXTREME))
        assert_allclose(found.log_evidence, logsumexp(logs), rtol=1e-14)
        for variable in VARIABLES:
            own = found[variable].probabilities
            assert_allclose(own, marginal(logs, variable), rtol=1e-10)
            assert_allclose(pgm.query(network, variable, soft(EXTREME)).probabilities, own)
    # What is left of A's second state is all there is where the first one is excluded.
    told = soft({A: EXTREME[A]}) | {B: 0}
    only = weighted(LOGS, {A: [-np.inf, -900.0]})[:, 0]
    found = pgm.infer(graph, told | {A: pgm.soft([-np.inf, -900.0], log=True)})
    assert_allclose(found.log_evidence, logsumexp(only), rtol=1e-14)
    assert_allclose(found[A].probabilities, [0, 1])
    # As a number, what is e^−900 of the rest is 0.
    assert pgm.infer(graph, told)[A].probabilities[1] == 0.0


def test_what_evidence_leaves_of_a_state_is_its_small_weight():
    """The child excludes the state of the large weight: e^−900 is all that there is."""
    copy = pgm.TableCPD(B, given=A, table=[[1.0, 0.0, 0.0], [0.0, 0.5, 0.5]])
    network = pgm.BayesianNetwork([pgm.TableCPD(A, table=[0.6, 0.4]), copy])
    evidence = {A: pgm.soft([0.0, -900.0], log=True), B: "1"}
    due = np.log(0.4 * 0.5) - 900
    for _ in range(2):
        found = pgm.infer(pgm.compile(network), evidence)
        assert_allclose(found.log_evidence, due, rtol=1e-15)
        assert_allclose(found[A].probabilities, [0, 1])
    assert_allclose(pgm.query(network, A, evidence).probabilities, [0, 1])
    best = pgm.most_probable(pgm.compile(network), evidence)
    assert best.assignment[A] == "1"
    assert_allclose(best.log_probability, due, rtol=1e-15)
    only = pgm.most_probable(pgm.compile(network), evidence, variables=A)
    assert only.assignment == {A: "1"}
    assert_allclose(only.log_probability, due, rtol=1e-15)
    impossible = evidence | {A: pgm.soft([-900.0, -np.inf], log=True)}
    for ask in (pgm.infer, pgm.most_probable):
        with pytest.raises(pgm.EvidenceError, match="probability zero"):
            ask(pgm.compile(network), impossible)
    allowed = pgm.infer(pgm.compile(network), impossible, impossible="allow")
    assert allowed.log_evidence == -np.inf


@BOTH
@pytest.mark.parametrize("shift", SHIFTS[:4])
def test_the_best_assignments(network, shift):
    graph, evidence = pgm.compile(network), soft(MODERATE, shift)
    logs = weighted(LOGS, MODERATE)
    states = list(product(*(range(v.size) for v in VARIABLES)))
    order = sorted((s for s in states if logs[s] > -np.inf), key=lambda s: -logs[s])
    found = pgm.most_probable(graph, evidence, count=7)
    ranked = [[int(found.assignment[v][k]) for v in VARIABLES] for k in range(7)]
    assert ranked == [list(s) for s in order[:7]]
    due = np.array([logs[s] for s in order[:7]]) + 2 * shift
    assert_allclose(found.log_probability, due, rtol=1e-14, atol=1e-13)
    best = pgm.most_probable(graph, evidence)
    assert_allclose(best.log_probability, due[0], rtol=1e-14, atol=1e-13)
    some = pgm.most_probable(graph, evidence, variables=(A, B))
    summed = logsumexp(logs, axis=(2, 3))
    assert_allclose(some.log_probability, summed.max() + 2 * shift, rtol=1e-14, atol=1e-13)
    place = np.unravel_index(summed.argmax(), summed.shape)
    assert [some.assignment[A], some.assignment[B]] == [
        v.states[k] for v, k in zip((A, B), place, strict=True)
    ]


def test_the_best_assignments_of_extreme_ratios():
    logs = weighted(LOGS, EXTREME)
    found = pgm.most_probable(pgm.compile(DIRECTED), soft(EXTREME), count=30)
    due = np.sort(logs[logs > -np.inf])[::-1]
    assert len(due) == 24
    assert_allclose(found.log_probability, due, rtol=1e-14)


@pytest.mark.parametrize("schedule", [pgm.Flooding(), pgm.Sequential(), pgm.Residual()])
def test_messages_round_loops(schedule):
    """The Bethe value has the constant, and the beliefs do not change."""
    graph = pgm.compile(UNDIRECTED, method=pgm.Bethe())
    due = pgm.infer(graph, soft(MODERATE), schedule=schedule)
    found = pgm.infer(graph, soft(MODERATE, -900.0), schedule=schedule)
    assert_allclose(found.log_evidence, due.log_evidence - 1800.0, rtol=1e-13)
    for variable in VARIABLES:
        assert_allclose(found[variable].probabilities, due[variable].probabilities, rtol=1e-10)


def test_draws_of_runs():
    graph = pgm.compile(DIRECTED)
    evidence = {D: pgm.soft([[-900.0, -np.inf, -np.inf], [0.0, -900.0, -np.inf]], log=True)}
    assert (pgm.infer(graph, evidence).sample(20, rng=0)[D] == 0).all()


# Over time.

X = pgm.Discrete("x", 2)
Z = pgm.Discrete("z", 3)
SENSOR = np.array([[0.5, 0.3, 0.2], [0.0, 0.4, 0.6]])
STEP = np.array([[0.9, 0.1], [0.2, 0.8]])
FIRST = np.array([0.7, 0.3])
CHAIN = pgm.DynamicBayesianNetwork(
    prior=[pgm.TableCPD(X, table=FIRST)],
    transition=[pgm.TableCPD(X, given=X.previous, table=STEP)],
    observation=[pgm.TableCPD(Z, given=X, table=SENSOR)],
)


def paths(weights):
    """The log-joint of each path x_0..T and the weights of Z at steps 1..T, and the paths."""
    count = len(weights)
    with np.errstate(divide="ignore"):
        seen = logsumexp(np.log(SENSOR)[None] + weights[:, None, :], axis=2)
    every = np.array(list(product(range(2), repeat=count + 1)))
    logs = np.log(FIRST)[every[:, 0]] + np.log(STEP)[every[:, :-1], every[:, 1:]].sum(axis=1)
    return logs + seen[np.arange(count), every[:, 1:]].sum(axis=1), every


def smoothed(logs, every):
    total = logsumexp(logs)
    return np.array(
        [
            [np.exp(logsumexp(logs[every[:, t] == k]) - total) for k in range(2)]
            for t in range(every.shape[1])
        ]
    )


def readings():
    rng = np.random.default_rng(2)
    weights = 2 * rng.normal(size=(5, 3))
    return {
        "shifted": weights - 900.0,
        "far": weights + np.array([0.0, -900.0, 1e6, -1e6, 3.0])[:, None],
        # Step 2 says that x is 0 or else e^−900; step 3 excludes what is likely then.
        "extreme": np.array(
            [[0, 0, 0], [0, -np.inf, -900], [-np.inf, -905, -900], [-900, 0, 0], [1, 2, -800.0]]
        ),
        "only": np.array([[-900.0, -np.inf, -np.inf]] + [[-np.inf, -900.0, -2000.0]] * 4),
    }


@pytest.mark.parametrize("kind", list(readings()))
def test_a_chain(kind):
    weights = readings()[kind]
    logs, every = paths(weights)
    evidence = {Z: pgm.soft(weights, log=True)}
    found = pgm.smooth(CHAIN, evidence)
    assert_allclose(found.log_evidence, logsumexp(logs), rtol=1e-12)
    assert_allclose(found[X].probabilities, smoothed(logs, every), rtol=1e-9, atol=1e-300)
    filtered = pgm.filter(CHAIN, evidence)
    robot = pgm.OnlineFilter(CHAIN)
    belief, total = robot.initial(), 0.0
    for step, row in enumerate(weights, 1):
        before, _ = paths(weights[:step])
        due = smoothed(before, np.array(list(product(range(2), repeat=step + 1))))[-1]
        assert_allclose(filtered[X].probabilities[step], due, rtol=1e-9, atol=1e-300)
        belief = robot.predict(belief)
        belief = robot.update(belief, {Z: pgm.soft(row, log=True)})
        assert_allclose(belief[X].probabilities, due, rtol=1e-9, atol=1e-300)
        total = logsumexp(before)
        assert_allclose(belief.log_evidence, total, rtol=1e-12, atol=1e-12)
    graph = pgm.compile(CHAIN, len(weights))
    best = pgm.most_probable(graph, evidence)
    assert_allclose(best.log_probability, logs.max(), rtol=1e-12)
    assert_allclose(best.assignment[X], every[logs.argmax()])


def test_chains_of_many_runs_and_sightings():
    every = list(readings().values())
    found = pgm.smooth(CHAIN, {Z: pgm.soft(np.stack(every), log=True)})
    twice = pgm.soft(np.repeat(np.stack(every), 2, axis=1) / 2, log=True)
    step = np.repeat(np.arange(1, 6), 2)
    sighted = pgm.smooth(CHAIN, {Z: pgm.sightings(twice, step=step)}, steps=5)
    for run, weights in enumerate(every):
        logs, states = paths(weights)
        assert_allclose(found.log_evidence[run], logsumexp(logs), rtol=1e-12)
        due = smoothed(logs, states)
        assert_allclose(found[X].probabilities[run], due, rtol=1e-9, atol=1e-300)
        alone = pgm.sightings(pgm.soft(np.repeat(weights, 2, axis=0) / 2, log=True), step=step)
        own = pgm.smooth(CHAIN, {Z: alone}, steps=5)
        assert_allclose(sighted.log_evidence[run], own.log_evidence, rtol=1e-13)
        assert_allclose(sighted[X].probabilities[run], own[X].probabilities, atol=1e-12)


@pytest.mark.filterwarnings("ignore::pgm.errors.ConvergenceWarning")
def test_learning_from_them():
    """Counts are shared by ratios of which no number tells the smaller ones."""
    weights = np.log(np.random.default_rng(3).random((6, 3)) + 0.1)
    learnt = {"learn": {Z: pgm.learning.Table()}, "iterations": 3, "accelerate": False}
    due = pgm.fit(CHAIN, {Z: pgm.soft(weights, log=True)}, **learnt)
    found = pgm.fit(CHAIN, {Z: pgm.soft(weights - 900.0, log=True)}, **learnt)
    table = found.model.observation[0].table
    assert_allclose(table, due.model.observation[0].table, rtol=1e-10)
    assert_allclose(found.log_evidence, np.subtract(due.log_evidence, 6 * 900.0), rtol=1e-12)
    # All weight but e^−900 lies where the sensor's table has a zero.
    excluded = np.array([[0.0, -np.inf, -900.0]] * 4)
    sure = CHAIN.replace(
        prior=[pgm.TableCPD(X, table=[0.0, 1.0])],
        transition=[pgm.TableCPD(X, given=X.previous, table=np.eye(2))],
    )
    found = pgm.fit(sure, {Z: pgm.soft(excluded, log=True)}, **{**learnt, "iterations": 1})
    assert_allclose(found.model.observation[0].table[1], [0.0, 0.0, 1.0], atol=1e-12)


def test_a_chain_of_hypotheses():
    """A switching chain, its mode seen by a sensor of a table: against a mode seen in numbers."""
    y = pgm.Variable("y")
    mode = pgm.Discrete("mode", 2)
    seen = pgm.Variable("seen")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(mode, table=FIRST), pgm.GaussianCPD(y, 0.0, 1.0)],
        transition=[
            pgm.TableCPD(mode, given=mode.previous, table=STEP),
            pgm.SwitchingCPD(
                y,
                given=mode,
                cases={
                    k: pgm.LinearGaussianCPD(y, {y.previous: 1.0}, cov)
                    for k, cov in enumerate((0.1, 2.0))
                },
            ),
        ],
        observation=[
            pgm.TableCPD(Z, given=mode, table=SENSOR),
            pgm.LinearGaussianCPD(seen, {y: 1.0}, 0.5),
        ],
    )
    places = np.array([[0.1], [1.0], [1.5]])
    weights = np.log(np.random.default_rng(4).random((3, 3)) + 0.1)
    exact = pgm.Gaussians(64)
    due = pgm.smooth(model, {Z: pgm.soft(np.exp(weights)), seen: places}, belief=exact)
    told = {Z: pgm.soft(weights - 900.0, log=True), seen: places}
    found = pgm.smooth(model, told, belief=exact)
    assert_allclose(found.log_evidence, due.log_evidence - 2700.0, rtol=1e-13)
    assert_allclose(found[mode].probabilities, due[mode].probabilities, rtol=1e-9)
    # The reading that is all but certain is impossible in the second mode, where the prior is.
    sure = model.replace(
        prior=[pgm.TableCPD(mode, table=[0.0, 1.0]), model.prior[1]],
        transition=[pgm.TableCPD(mode, given=mode.previous, table=np.eye(2)), model.transition[1]],
    )
    odd = np.array([[0.0, -900.0, -np.inf]] * 3)
    found = pgm.smooth(sure, {Z: pgm.soft(odd, log=True), seen: places}, belief=exact)
    without = pgm.smooth(sure, {seen: places}, belief=exact)
    due = without.log_evidence + 3 * (np.log(0.4) - 900.0)
    assert_allclose(found.log_evidence, due, rtol=1e-13)
    assert_allclose(found[mode].probabilities, [[0.0, 1.0]] * 4)


# Refused.


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        ([0.0, np.nan, 1.0], r"log-weights that are NaN or \+∞$"),
        ([0.0, np.inf, 1.0], r"log-weights that are NaN or \+∞$"),
        ([[0, 0, 0], [0, np.inf, 1]], r"NaN or \+∞ \(first in run 1\)"),
        ([-np.inf] * 3, "log-weights are all −∞, which is impossible evidence; .* a finite one"),
        ([[0, 0, 0], [-np.inf] * 3], r"all −∞ \(first in run 1\), which is impossible"),
        ([-900.0, -901.0], r"shape \(2,\); the last axis"),
        ({"0": -900.0}, "the weights are a mapping"),
        ([0.0, -1e101, 1.0], r"log-weights of more than 1e\+100, beside which"),
        ([0.0, 1e308, -np.inf], r"log-weights of more than 1e\+100"),
    ],
)
def test_malformed_log_weights_are_refused(weights, words):
    value = pgm.soft(weights, log=True)
    for ask in (
        lambda: pgm.infer(pgm.compile(DIRECTED), {B: value}),
        lambda: pgm.query(DIRECTED, A, {B: value}),
        lambda: pgm.most_probable(pgm.compile(UNDIRECTED), {B: value}),
    ):
        with pytest.raises(pgm.EvidenceError, match=words) as caught:
            ask()
        assert caught.value.variable == B


def test_malformed_log_weights_over_time_are_refused():
    rows = np.array([[-900.0, -900.0, -901.0], [-np.inf] * 3])
    with pytest.raises(pgm.EvidenceError, match=r"all −∞ \(first in row 1\)"):
        pgm.smooth(CHAIN, {Z: pgm.soft(rows, log=True)})
    robot = pgm.OnlineFilter(CHAIN)
    with pytest.raises(pgm.EvidenceError, match="all −∞"):
        robot.update(robot.initial(), {Z: pgm.soft(rows[1], log=True)})


@pytest.mark.parametrize("log", [1, "yes", None, [True]])
def test_log_is_true_or_false(log):
    with pytest.raises(pgm.EvidenceError, match="log says whether the weights are logarithms"):
        pgm.soft([0.0, -1.0], log=log)


def test_its_text():
    assert repr(pgm.soft([0.0, -900.0], log=True)) == "Soft(weights=[0.0, -900.0], log=True)"
    assert repr(pgm.soft([0.2, 0.8], log=False)) == "Soft(weights=[0.2, 0.8])"
