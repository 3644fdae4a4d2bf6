"""Many runs at once are what each run is by itself."""

import copy
import itertools
import pickle

import numpy as np
import pytest
from discrete.enumeration import Enumeration, network

import pgm
from models.discrete import asia, bronchitis, dyspnoea, smoking, xray
from pgm.inference import limits

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


@pytest.mark.parametrize("kept", [0, 2**24])
@pytest.mark.parametrize("at_once", [1, 100, 300])
def test_runs_that_do_not_fit_at_once(at_once, kept, monkeypatch):
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


@pytest.mark.parametrize("schedule", [None, pgm.Flooding()])
def test_posteriors_are_copied(schedule):
    posterior = pgm.infer(pgm.compile(asia()), {xray: [1, -1]}, schedule=schedule)
    for twin in (copy.deepcopy(posterior), pickle.loads(pickle.dumps(posterior))):
        assert np.array_equal(twin[smoking].values, posterior[smoking].values)
        assert np.array_equal(twin.log_evidence, posterior.log_evidence)
