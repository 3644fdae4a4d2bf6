"""Many runs at once are what each run is by itself."""

import copy
import itertools
import pickle

import numpy as np
import pytest
from discrete.enumeration import Enumeration, network

import pgm
from models.discrete import asia, bronchitis, cancer, dyspnoea, either, smoking, xray
from pgm.beliefs.discrete import run_pieces, tree_passes, tree_plan
from pgm.evidence import bind_discrete
from pgm.schedules import limits

RUNS = 5


def batch(net, seed, runs=RUNS):
    """Draw evidence of each kind: by run, missing in some runs, one for all, weights."""
    rng = np.random.default_rng(seed)
    found = {}
    for variable in net.variables:
        kind = rng.integers(8)
        if kind == 0:
            found[variable] = rng.integers(-1, variable.size, runs)
        elif kind == 1:
            found[variable] = rng.integers(0, variable.size, runs)
        elif kind == 2:
            found[variable] = int(rng.integers(variable.size))
        elif kind == 3:
            found[variable] = pgm.soft(rng.random((runs, variable.size)))
        elif kind == 4:
            found[variable] = pgm.soft(rng.random(variable.size))
    # One run at least differs.
    found[net.variables[0]] = np.arange(runs) % (net.variables[0].size + 1) - 1
    return found


def one(evidence, run):
    """The evidence of one run."""
    found = {}
    for variable, value in evidence.items():
        if isinstance(value, int):
            found[variable] = value
        elif isinstance(value, np.ndarray):
            found[variable] = int(value[run])
        else:
            weights = value.weights
            found[variable] = pgm.soft(weights[run] if weights.ndim == 2 else weights)
    return found


def same(whole, single, run):
    for variable in whole.graph.network.variables:
        try:
            values = whole[variable].values[run]
        except pgm.EvidenceError:
            continue
        try:
            due = single[variable].values
        except pgm.EvidenceError:  # observed in this run
            due = np.eye(variable.size)[values.argmax()]
        np.testing.assert_allclose(values, due, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(whole.log_evidence[run], single.log_evidence, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("schedule", [None, pgm.Flooding()])
@pytest.mark.parametrize("seed", range(8))
def test_a_batch_equals_its_runs(seed, schedule):
    net = network(seed, count=7)
    graph = pgm.compile(net)
    evidence = batch(net, seed)
    whole = pgm.infer(graph, evidence, schedule=schedule)
    assert whole.log_evidence.shape == whole.status.converged.shape == (RUNS,)
    for run in range(RUNS):
        same(whole, pgm.infer(graph, one(evidence, run), schedule=schedule), run)


@pytest.mark.parametrize("seed", range(4))
def test_joints_beliefs_and_messages_of_a_batch(seed):
    net = network(20 + seed, count=7, parents=2)
    graph = pgm.compile(net)
    evidence = batch(net, seed)
    whole = pgm.infer(graph, evidence)
    hidden = [v for v in net.variables if v not in evidence]
    for run in range(RUNS):
        single = pgm.infer(graph, one(evidence, run))
        for pair in itertools.pairwise(hidden):
            values = whole.joint(*pair).values
            assert values.shape == (RUNS, pair[0].size, pair[1].size)
            np.testing.assert_allclose(values[run], single.joint(*pair).values, atol=1e-14)
        for tables in (
            [(whole.belief(k), single.belief(k)) for k in range(len(graph))],
            [(whole.message(*edge), single.message(*edge)) for edge in graph.sepsets],
        ):
            for wide, narrow in tables:
                total = wide.marginal(*narrow.scope)
                assert total.log_scale.shape == (RUNS,)
                np.testing.assert_allclose(total.log_total[run], narrow.log_total, atol=1e-13)
                np.testing.assert_allclose(
                    total.probabilities[run], narrow.probabilities, atol=1e-13
                )


def test_leading_axes_are_those_of_the_evidence():
    evidence = {xray: [[0, 1, -1], [1, 1, 0]], dyspnoea: "yes"}
    posterior = pgm.infer(pgm.compile(asia()), evidence)
    assert posterior[smoking].values.shape == (2, 3, 2)
    assert posterior[xray].values.shape == (2, 3, 2)
    assert posterior.joint(smoking, bronchitis).values.shape == (2, 3, 2, 2)
    assert posterior.log_evidence.shape == (2, 3)
    assert posterior.status.residuals.shape == (0, 2, 3)
    assert "runs (2, 3)" in repr(posterior)
    alone = pgm.infer(pgm.compile(asia()), {xray: [[1]]})
    assert alone[smoking].values.shape == (1, 1, 2)
    assert alone.message(0, alone.graph.neighbours(0)[0]).log_scale.shape == (1, 1)


def test_a_variable_observed_in_some_runs_has_a_marginal_in_all():
    posterior = pgm.infer(pgm.compile(asia()), {xray: [1, -1, 0]})
    values = posterior[xray].values
    assert values[0].tolist() == [0.0, 1.0]
    assert values[2].tolist() == [1.0, 0.0]
    np.testing.assert_allclose(values[1], Enumeration(asia()).marginal(xray), atol=1e-15)


@pytest.mark.parametrize("large", [1, 12, 2**9])
@pytest.mark.parametrize("small", [0, 2**12])
@pytest.mark.parametrize("seed", range(4))
def test_tables_of_a_batch_that_are_used_where_they_stand(seed, small, large, monkeypatch):
    monkeypatch.setattr(tree_plan, "LARGE_OF_MANY", large)
    monkeypatch.setattr(tree_passes, "SMALL", small)
    net = network(40 + seed, count=8)
    graph = pgm.compile(net)
    evidence = batch(net, seed)
    whole, best = pgm.infer(graph, evidence), pgm.most_probable(graph, evidence)
    for run in range(RUNS):
        same(whole, pgm.infer(graph, one(evidence, run)), run)
        probability = pgm.most_probable(graph, one(evidence, run)).log_probability
        np.testing.assert_allclose(best.log_probability[run], probability, atol=1e-13)


def test_tables_of_a_batch_that_are_too_large_to_be_kept_for_the_next(monkeypatch):
    monkeypatch.setattr(tree_passes, "HELD", 0)
    net = network(41, count=8)
    evidence = batch(net, 3)
    whole = pgm.infer(pgm.compile(net), evidence)
    monkeypatch.undo()
    for run in range(RUNS):
        same(whole, pgm.infer(pgm.compile(net), one(evidence, run)), run)


@pytest.mark.parametrize("few", [1, 64])
@pytest.mark.parametrize("kept", [0, 2**24])
@pytest.mark.parametrize("at_once", [1, 100, 300])
def test_runs_that_do_not_fit_at_once(at_once, kept, few, monkeypatch):
    monkeypatch.setattr(run_pieces, "FEW", few)
    net = network(5, count=8)
    graph = pgm.compile(net)
    rng = np.random.default_rng(0)
    first, second, third = net.variables[0], net.variables[3], net.variables[5]
    evidence = {first: rng.integers(-1, first.size, 7), second: rng.integers(0, second.size, 7)}
    whole = pgm.infer(graph, evidence)
    edges = [*graph.sepsets, *((j, i) for i, j in graph.sepsets)]
    messages = [whole.message(*edge) for edge in edges]
    best = pgm.most_probable(graph, evidence)
    monkeypatch.setattr(limits, "BATCH", at_once * sum(graph.sizes) // 50)
    monkeypatch.setattr(limits, "KEPT", kept)
    parts = pgm.infer(graph, evidence)
    for variable in (first, third):
        np.testing.assert_allclose(parts[variable].values, whole[variable].values, atol=1e-15)
    np.testing.assert_allclose(parts.log_evidence, whole.log_evidence, rtol=1e-15)
    wanted = third, first, net.variables[-1]
    np.testing.assert_allclose(parts.joint(*wanted).values, whole.joint(*wanted).values, atol=1e-15)
    np.testing.assert_allclose(parts.belief(0).values, whole.belief(0).values, atol=1e-15)
    for edge, due in zip(edges, messages, strict=True):
        found = parts.message(*edge)
        np.testing.assert_allclose(found.values, due.values, rtol=1e-13)
        np.testing.assert_allclose(found.log_scale, due.log_scale, rtol=1e-13, atol=1e-13)
    again = pgm.most_probable(graph, evidence)
    for variable in net.variables:
        assert np.array_equal(again.assignment[variable], best.assignment[variable])


def repeated(net, seed, runs):
    """Evidence by run of every variable but two, few states of which make many runs equal."""
    rng = np.random.default_rng(seed)
    found = {}
    for variable in net.variables[:-2]:
        few = rng.integers(-1, variable.size, 2)
        found[variable] = few[rng.integers(0, 2 if rng.random() < 0.4 else 1, runs)]
    return found


@pytest.mark.parametrize("codes", [8, 2**62])
@pytest.mark.parametrize("kept", [0, 2**24])
@pytest.mark.parametrize("seed", range(4))
def test_equal_runs_are_computed_once(seed, kept, codes, monkeypatch):
    monkeypatch.setattr(run_pieces, "CODES", codes)
    monkeypatch.setattr(limits, "KEPT", kept)
    net = network(60 + seed, count=6, parents=2)
    graph = pgm.compile(net)
    evidence = repeated(net, seed, 40)
    rows = np.array(list(evidence.values()))
    bound = bind_discrete(net.variables, evidence)
    found = run_pieces.Distinct.of(bound)
    assert found.evidence.runs == len(np.unique(rows, axis=1).T) < 40
    whole = pgm.infer(graph, evidence)
    best = pgm.most_probable(graph, evidence)
    pair, edge = net.variables[-2:], next(iter(graph.sepsets), None)
    for run in range(0, 40, 7):
        alone = one(evidence, run)
        single = pgm.infer(graph, alone)
        same(whole, single, run)
        joint = whole.joint(*pair).values
        np.testing.assert_allclose(joint[run], single.joint(*pair).values, atol=1e-14)
        np.testing.assert_allclose(
            whole.belief(0).log_total[run], single.belief(0).log_total, atol=1e-13
        )
        if edge:
            wide, narrow = whole.message(*edge), single.message(*edge)
            total = wide.marginal(*narrow.scope).log_total[run]
            np.testing.assert_allclose(total, narrow.log_total, atol=1e-13)
        probability = pgm.most_probable(graph, alone).log_probability
        np.testing.assert_allclose(best.log_probability[run], probability, rtol=1e-14)


def test_runs_that_are_all_equal_or_have_weights_of_their_own():
    graph, truth = pgm.compile(asia()), Enumeration(asia(), {xray: 1})
    posterior = pgm.infer(graph, {xray: [[1, 1], [1, 1]]})
    assert posterior[smoking].values.shape == (2, 2, 2)
    for row in posterior[smoking].values.reshape(-1, 2):
        np.testing.assert_allclose(row, truth.marginal(smoking), atol=1e-15)
    assert posterior.joint(smoking, dyspnoea).values.shape == (2, 2, 2, 2)
    weights = pgm.soft([[0.2, 0.8], [0.2, 0.8], [0.8, 0.2]])
    uneven = pgm.infer(graph, {xray: [1, 1, 1], dyspnoea: weights})[smoking].values
    assert np.array_equal(uneven[0], uneven[1])
    assert not np.allclose(uneven[0], uneven[2])


def test_the_run_that_is_named_is_one_of_those_given():
    with pytest.raises(pgm.EvidenceError, match=r"probability zero \(first in run 3\)"):
        pgm.infer(pgm.compile(asia()), {cancer: [0, 0, 0, 1], either: [0, 1, 0, 0]})


@pytest.mark.parametrize("schedule", [None, pgm.Flooding()])
def test_posteriors_are_copied(schedule):
    posterior = pgm.infer(pgm.compile(asia()), {xray: [1, -1]}, schedule=schedule)
    for twin in (copy.deepcopy(posterior), pickle.loads(pickle.dumps(posterior))):
        assert np.array_equal(twin[smoking].values, posterior[smoking].values)
        assert np.array_equal(twin.log_evidence, posterior.log_evidence)
