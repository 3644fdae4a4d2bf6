"""Messages and beliefs of balanced trees, against a plain pass on the same clusters."""

from functools import reduce
from operator import mul

import numpy as np
import pytest
from plain import (
    assert_form,
    assert_plain,
    evidence_of,
    linear_cpd,
    linear_network,
    plain_pass,
    plain_potentials,
    vacuous,
)
from textbooks import assert_log, assert_same

import pgm

SMOOTHING, FILTERING = pgm.Smoothing(), pgm.Filtering()


def on_a_tree(model, evidence, steps, schedule=SMOOTHING):
    return pgm.infer(pgm.compile(model, steps, pgm.Balanced()), evidence, schedule=schedule)


def cut(steps):
    """The linear network up to a step."""
    model, _, inputs, readings = linear_network()
    inputs = {variable: rows[:steps] for variable, rows in inputs.items()}
    readings = [row for row in readings if row[1] <= steps]
    return (model, steps, inputs, readings), evidence_of(inputs, readings)


@pytest.mark.parametrize("steps", [0, 1, 2, 3, 4, 5])
def test_all_messages_and_beliefs_of_a_smoothing(steps):
    network, evidence = cut(steps)
    posterior = on_a_tree(network[0], evidence, steps)
    assert_plain(posterior, plain_potentials(*network, linear_cpd))


def test_they_are_those_of_a_tree_made_by_hand():
    """The unrolled network's own engine, which knows nothing of time."""
    (model, steps, inputs, readings), _ = cut(5)
    singly = list({(row[0], row[1]): row for row in readings}.values())
    tree = on_a_tree(model, evidence_of(inputs, singly), steps)
    graph = tree.graph
    silent = {v.at(t) for v in model.sensors for t in range(steps + 1)}
    silent -= {sensor.at(step) for sensor, step, _, _ in singly}
    unrolled = model.unroll(steps)
    network = pgm.BayesianNetwork([cpd for cpd in unrolled.cpds if cpd.child not in silent])
    scopes = [[v for v in cluster.scope if v not in silent] for cluster in graph]
    plain = pgm.ClusterGraph(network, scopes, graph.sepsets)
    values = {sensor.at(step): value for sensor, step, value, _ in singly}
    for variable, rows in inputs.items():
        values |= {variable.at(k + 1): row for k, row in enumerate(rows)}
    due = pgm.infer(plain, values)
    for i, j in [edge[::way] for edge in graph.sepsets for way in (1, -1)]:
        message = due.message(i, j)
        assert_form(tree.message(i, j), message, 1e-8, tree.joint(*message.scope).std)
    assert_log(tree.log_evidence, due.log_evidence)


@pytest.mark.parametrize("steps", [0, 1, 4, 5])
def test_after_filtering_nobody_knows_what_comes_later(steps):
    """Up go the segments, down what was read up to their beginning."""
    network, evidence = cut(steps)
    posterior = on_a_tree(network[0], evidence, steps, FILTERING)
    graph = posterior.graph
    potentials = plain_potentials(*network, linear_cpd)
    up, _ = plain_pass(potentials, graph)
    ahead, _ = plain_pass(potentials, pgm.compile(network[0], steps))
    incoming = {i: [] for i in range(len(graph))}
    for child in range(len(graph)):
        parent, (first, last) = graph.parent(child), graph.segment(child)
        if parent is None:
            continue
        found = posterior.message(child, parent)
        assert_form(found, up[child, parent], 1e-9, posterior.joint(*found.scope).std)
        incoming[parent].append(found)
        if not child:
            with pytest.raises(pgm.GraphError, match=rf"{parent} to 0 was not sent") as caught:
                posterior.message(parent, 0)
            assert caught.value.cluster == parent
            continue
        found = posterior.message(parent, child)
        due = ahead[first, first + 1] * vacuous(graph.states_at(last))
        assert_form(found, due, 1e-9, posterior.joint(*found.scope).std)
        incoming[child].append(found)
    known = np.cumsum(posterior._outcome._forward.log_density)
    for i, messages in incoming.items():
        found = posterior.belief(i)
        scale = posterior.joint(*found.scope).std
        assert_form(found, reduce(mul, [*potentials[i : i + 1], *messages]), 1e-9, scale)
        assert_log(found.log_integral, known[graph.segment(i)[1]])


def test_runs_of_a_batch():
    network, evidence = cut(5)
    posterior = on_a_tree(network[0], evidence, 5)
    (command,) = network[2]
    batch = {**evidence, command: np.stack([evidence[command] + k for k in (3.0, 0.0)])}
    found = on_a_tree(network[0], batch, 5)
    for ask in (lambda p: p.message(8, 7), lambda p: p.message(7, 8), lambda p: p.belief(9)):
        form, due = ask(found), ask(posterior)
        assert form.g.shape == (2,)
        one = pgm.CanonicalForm(form.scope, form.K[1], form.h[1], form.g[1])
        assert_form(one, due)
        assert abs(form.g[0] - due.g) > 0.1


line = pgm.Variable("line", components=("place", "speed"))
fix = pgm.Variable("fix")
PUSH = np.array([[0.25, 0.5], [0.5, 1.0]])


def rolling(cov, noise=0.2, prior=None, start=0.0):
    """A cart that is pushed: its noise may be of rank one, or none."""
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(line, [start, 0.5], np.eye(2) if prior is None else prior)],
        transition=[pgm.LinearGaussianCPD(line, {line.previous: [[1, 1], [0, 1]]}, cov=cov)],
        observation=[pgm.LinearGaussianCPD(fix, {line: [[1.0, 0]]}, cov=noise)],
    )


def seen(steps, start=0.0):
    every = np.arange(1, steps + 1, 3)
    return {fix: pgm.sightings(start + np.sin(every)[:, None] + 0.5 * every[:, None], step=every)}


@pytest.mark.parametrize("noise", [0.2, 0.0])
def test_two_messages_over_a_sepset_make_its_marginal(noise):
    """Noise of rank one makes forms of segments of two steps and more."""
    posterior = on_a_tree(rolling(PUSH, noise), seen(48), 48)
    graph = posterior.graph
    checked = 0
    for child in range(graph.steps + 1, len(graph)):
        parent = graph.parent(child)
        first, last = graph.segment(child)
        # After an exact reading it takes two steps until there is a form again.
        if parent is None or (noise == 0.0 and (first % 3 == 1 or last % 3 != 0)):
            continue
        product = posterior.message(child, parent) * posterior.message(parent, child)
        assert_log(product.log_integral, posterior.log_evidence)
        assert_same(product.gaussian(), posterior.joint(*product.scope), 1e-8)
        checked += 1
    assert checked > 3


@pytest.mark.parametrize(
    ("asked", "cluster", "exists"),
    [
        (lambda p: p.message(3, 11), 3, lambda p: p.message(11, 3)),
        (lambda p: p.belief(3), 3, lambda p: p.belief(12)),
        (lambda p: p.belief(9), 9, lambda p: p.belief(10)),
    ],
    ids=["a single step", "a leaf", "two steps"],
)
def test_forms_that_do_not_exist(asked, cluster, exists):
    """States of three steps in a row have noise of rank four, of every second step rank six."""
    posterior = on_a_tree(rolling(PUSH), seen(8), 8)
    with pytest.raises(pgm.NumericalError, match=rf"cluster {cluster}\b.*canonical") as caught:
        asked(posterior)
    assert caught.value.cluster == cluster
    assert caught.value.step == (3 if cluster == 3 else None)
    assert np.isfinite(exists(posterior).g)


def test_the_chain_of_slices_has_the_same_marginals_and_leaves():
    """A hundred steps, of which the tree knows nothing else than the chain."""
    model, steps = rolling(0.1 * np.eye(2)), 100
    tree = on_a_tree(model, seen(steps), steps)
    chain = pgm.smooth(model, seen(steps), steps=steps)
    assert_same(tree[line], chain[line])
    for step in (0, 1, 64, 65, 100):
        found = tree.belief(step)
        assert_form(found, chain.belief(step), 1e-9, tree.joint(*found.scope).std)
    belief = tree.belief(tree.graph.root)
    assert_log(belief.log_integral, chain.log_evidence)
    assert_same(belief.gaussian(), chain.joint(line.at(0), line.at(64), line.at(100)), 1e-8)


def test_large_coordinates_cost_few_digits():
    """A map grid's 5 · 10⁶ m: a segment's element is the same but for where it is."""
    far = 5e6
    here = on_a_tree(rolling(0.1 * np.eye(2)), seen(16), 16)
    there = on_a_tree(rolling(0.1 * np.eye(2), start=far), seen(16, far), 16)
    source = 16 + 12
    one, other = (p.message(source, p.graph.parent(source)) for p in (here, there))
    np.testing.assert_allclose(other.K, one.K, rtol=1e-9)
    shift = np.array([far, 0.0, far, 0.0])
    np.testing.assert_allclose(other.h - one.h, one.K @ shift, atol=1e-3)


def test_clusters_by_value_and_strangers():
    posterior = on_a_tree(rolling(np.eye(2)), seen(6), 6)
    assert repr(posterior).splitlines()[0] == "Posterior(smoothed, steps 0..6)"
    clusters = posterior.graph.clusters
    assert_form(posterior.belief(clusters[10]), posterior.belief(10), 0.0)
    assert_form(posterior.message(clusters[8], clusters[10]), posterior.message(8, 10), 0.0)
    with pytest.raises(pgm.GraphError, match="not joined"):
        posterior.message(1, 2)
    with pytest.raises(pgm.GraphError, match=r"clusters are 0\.\.11"):
        posterior.belief(12)
