"""Discrete dynamic networks against the enumeration of all paths."""

import copy
import pickle

import numpy as np
import pytest
from markov.worlds import WORLDS
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.beliefs.markov import run

EQUAL = {"rtol": 1e-12, "atol": 1e-15}


@pytest.fixture(params=list(WORLDS), scope="module")
def world(request):
    return WORLDS[request.param](np.random.default_rng(5))


@pytest.fixture(params=["numbers", "logarithms"])
def arithmetic(request, monkeypatch):
    """Plain numbers, or logarithms from the start."""
    if request.param == "logarithms":
        monkeypatch.setattr(run, "TINY", 2.0)


def hidden(world):
    """List the hidden variables at their steps."""
    for v in world.slices:
        for t in range(0 if v in world.model.states else 1, world.steps + 1):
            yield v.at(t)


@pytest.mark.usefixtures("arithmetic")
def test_a_smoother(world):
    posterior = pgm.smooth(world.model, world.evidence, steps=world.steps)
    for variable in hidden(world):
        due, total = world.marginal(variable)
        assert_allclose(posterior[variable].values, due, **EQUAL)
    assert_allclose(posterior.log_evidence, np.log(total), **EQUAL)
    x = world.slices[-1]
    stacked = posterior[x].values
    assert stacked.shape == (world.steps + 1, x.size)
    assert_allclose(stacked[2], posterior[x.at(2)].values, rtol=0, atol=0)
    assert str(posterior.kind) == "smoothed"


@pytest.mark.usefixtures("arithmetic")
@pytest.mark.parametrize("lag", [0, 2, 9])
def test_a_filter_and_a_fixed_lag(world, lag):
    if lag:
        posterior = pgm.smooth(world.model, world.evidence, steps=world.steps, lag=lag)
    else:
        posterior = pgm.filter(world.model, world.evidence, steps=world.steps)
    for variable in hidden(world):
        due, _ = world.marginal(variable, until=variable.step + lag)
        assert_allclose(posterior[variable].values, due, **EQUAL)
        due, _ = world.marginal(variable, until=variable.step)
        assert_allclose(posterior.filtered[variable].values, due, **EQUAL)
        due, _ = world.marginal(variable, until=variable.step - 1)
        assert_allclose(posterior.predicted[variable].values, due, **EQUAL)


@pytest.mark.usefixtures("arithmetic")
@pytest.mark.parametrize("lag", [None, 0, 1])
def test_joints(world, lag):
    if lag is None:
        posterior = pgm.smooth(world.model, world.evidence, steps=world.steps)
    else:
        posterior = pgm.infer(
            pgm.compile(world.model, world.steps), world.evidence, schedule=pgm.FixedLag(lag)
        )
    x, y = world.slices[0], world.slices[-1]
    for scope in [(y.at(1), y.at(2)), (y.at(3), x.at(1)), (y.at(0), x.at(2), y.at(3))]:
        latest = max(v.step for v in scope)
        until = None if lag is None else latest + lag
        due, _ = world.marginal(*scope, until=until)
        found = posterior.joint(*scope)
        assert found.scope == scope
        assert_allclose(found.values, due, **EQUAL)


@pytest.mark.usefixtures("arithmetic")
def test_messages_and_beliefs_of_clusters(world):
    posterior = pgm.smooth(world.model, world.evidence, steps=world.steps)
    graph, total = posterior.graph, np.exp(posterior.log_evidence)
    for cluster in graph.clusters:
        belief = posterior.belief(cluster)
        due, _ = world.marginal(*belief.scope)
        assert_allclose(belief.values * np.exp(belief.log_scale), due * total, **EQUAL)
    for i in range(len(graph) - 1):
        product = posterior.message(i, i + 1) * posterior.message(i + 1, i)
        assert product.scope == graph.sepsets[i, i + 1]
        due, _ = world.marginal(*product.scope)
        assert_allclose(product.values * np.exp(product.log_scale), due * total, **EQUAL)
    filtered = pgm.filter(world.model, world.evidence, steps=world.steps)
    belief = filtered.belief(2)
    due, total = world.marginal(*belief.scope, until=2)
    assert_allclose(belief.values * np.exp(belief.log_scale), due * total, **EQUAL)
    with pytest.raises(pgm.GraphError, match="was not sent"):
        filtered.message(2, 1)


def test_the_most_probable_path(world):
    found = pgm.most_probable(pgm.compile(world.model, world.steps), world.evidence)
    path, probability = world.best()
    assert_allclose(found.log_probability, np.log(probability), **EQUAL)
    for variable in hidden(world):
        v = variable.template
        first = 0 if v in world.model.states else 1
        assert found.assignment[v][variable.step - first] == path[v.name][variable.step]
    assert found.states(v).shape == found.assignment[v].shape


def test_runs_are_single_ones(world):
    rng = np.random.default_rng(0)
    evidence = [world.evidence, {}, {}]
    for v, value in world.evidence.items():
        for k in (1, 2):
            evidence[k][v] = redrawn(rng, world, v, value)
    together = {v: stacked([each[v] for each in evidence]) for v in evidence[0]}
    x = world.slices[-1]
    graph = pgm.compile(world.model, world.steps)
    for schedule in (pgm.Filtering(), pgm.Smoothing(), pgm.FixedLag(1)):
        found = pgm.infer(graph, together, schedule=schedule)
        assert found[x].values.shape == (3, 1, world.steps + 1, x.size)
        for k, each in enumerate(evidence):
            due = pgm.infer(graph, each, schedule=schedule)
            for v in world.slices:
                assert_allclose(found[v].values[k, 0], due[v].values, **EQUAL)
            assert_allclose(found.log_evidence[k, 0], due.log_evidence, **EQUAL)
            pair = x.at(1), world.slices[0].at(3)
            assert_allclose(found.joint(*pair).values[k, 0], due.joint(*pair).values, **EQUAL)
            belief = found.belief(2)
            total = belief.values[k, 0] * np.exp(belief.log_scale[k, 0])
            own = due.belief(2)
            assert_allclose(total, own.values * np.exp(own.log_scale), **EQUAL)
    paths = pgm.most_probable(graph, together)
    for k, each in enumerate(evidence):
        due = pgm.most_probable(graph, each)
        assert_allclose(paths.log_probability[k, 0], due.log_probability, **EQUAL)
        for v in world.slices:
            assert (paths.assignment[v][k, 0] == due.assignment[v]).all()


def redrawn(rng, world, variable, value):
    """Evidence like some other."""
    if hasattr(value, "weights"):
        return pgm.soft(rng.random(value.weights.shape))
    if hasattr(value, "step"):
        read = {variable: pgm.sightings(step=value.step)}
        states = world.model.sample(read, steps=world.steps, rng=rng)[variable]
        return pgm.sightings(np.where(rng.random(states.size) < 0.3, -1, states), value.step)
    if value.dtype.kind == "f":
        return rng.normal(size=value.shape)
    return rng.integers(0, variable.size, value.shape)


def stacked(values):
    """Evidence of several runs, with two axes for them."""
    if hasattr(values[0], "weights"):
        return pgm.soft(np.stack([each.weights for each in values])[:, None])
    if hasattr(values[0], "step"):
        return pgm.sightings([[each.values] for each in values], values[0].step)
    return np.stack(values)[:, None]


def test_what_tables_take_not():
    world = WORLDS["dense"](np.random.default_rng(5))
    graph = pgm.compile(world.model, world.steps)
    with pytest.raises(pgm.ModelError, match=r"tables take pgm.Filtering\(\)"):
        pgm.infer(graph, world.evidence, schedule=pgm.Flooding())
    for schedule in (pgm.Smoothing(iterations=3), pgm.Filtering(damping=0.5)):
        with pytest.raises(pgm.ModelError, match="nothing to iterate or damp"):
            pgm.infer(graph, world.evidence, schedule=schedule)
    balanced = pgm.compile(world.model, world.steps, method=pgm.Balanced())
    for call in (pgm.infer, pgm.most_probable):
        with pytest.raises(pgm.GraphError, match="tables go along a chain of slices"):
            call(balanced, world.evidence)
    with pytest.raises(pgm.EvidenceError, match="a start is for nonlinear CPDs"):
        pgm.infer(graph, world.evidence, start={})
    for named in ({"keep": world.slices}, {"lineariser": pgm.Unscented()}):
        with pytest.raises(pgm.ModelError, match="is for networks of Gaussian CPDs"):
            pgm.infer(graph, world.evidence, **named)


@pytest.mark.usefixtures("arithmetic")
@pytest.mark.parametrize("schedule", [pgm.Filtering(), pgm.FixedLag(1), pgm.Smoothing()])
def test_a_posterior_is_pickled(world, schedule):
    graph = pgm.compile(world.model, world.steps)
    due = pgm.infer(graph, world.evidence, schedule=schedule)
    x, y = world.slices[0], world.slices[-1]
    scope = (y.at(3), x.at(1))
    # Functions within functions are copied, but not pickled.
    called = any(cpd.function is not None for cpd in world.model.transition)
    again = copy.deepcopy if called else lambda value: pickle.loads(pickle.dumps(value))
    fresh = again(due)  # before its beliefs are made
    joint = due.joint(*scope).values
    for found in (fresh, again(due)):
        for variable in hidden(world):
            assert_array_equal(found[variable].values, due[variable].values)
            assert_array_equal(found.filtered[variable].values, due.filtered[variable].values)
        assert_array_equal(found.joint(*scope).values, joint)
        assert found.log_evidence == due.log_evidence
        assert found.belief(2).log_total == due.belief(2).log_total
        assert repr(found) == repr(due)


def test_a_posterior_of_many_runs_is_pickled():
    world = WORLDS["dense"](np.random.default_rng(5))
    (z,) = world.model.sensors
    due = pgm.smooth(world.model, {z: [[0, 1, 2], [1, 0, -1]]})
    found = pickle.loads(pickle.dumps(due))
    x = world.slices[0]
    assert_array_equal(found[x].values, due[x].values)
    assert_array_equal(found.log_evidence, due.log_evidence)
    marginals = pickle.loads(pickle.dumps(due.filtered))
    assert_array_equal(marginals[x].values, due.filtered[x].values)
