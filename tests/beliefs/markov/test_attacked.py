"""Discrete dynamic networks at their edges: odd structures, numbers out of range, refusals."""

import numpy as np
import pytest
from markov.test_long import model
from markov.worlds import drawn
from numpy.testing import assert_allclose

import pgm
from pgm.beliefs.markov import run
from pgm.beliefs.markov.plan import SlicePlan
from pgm.resources import require_memory

X, Z = pgm.Discrete("x", 2), pgm.Discrete("z", 2)
SEEN = np.array([[0.9, 0.1], [0.2, 0.8]])
STILL = model(X, Z, np.array([0.5, 0.5]), np.eye(2), SEEN)


def unrolled(network, evidence, steps):
    """Infer by the junction tree of the unrolled network, from evidence by step."""
    return pgm.infer(pgm.compile(network.unroll(steps)), evidence)


def test_a_mapping_whose_second_parent_is_hidden():
    """The matrices are those of the hidden parent's states, and the input their rows."""
    x, u = pgm.Discrete("x", 3), pgm.Discrete("u", 3)
    full = drawn(np.random.default_rng(0), 3, 3, 3)
    prior = [pgm.TableCPD(x, table=[0.2, 0.3, 0.5])]
    parents = u, x.previous
    table = {k: full[:, k] for k in range(3)}
    mapped = pgm.DynamicBayesianNetwork(prior, [pgm.TableCPD(x, given=parents, table=table)])
    plain = pgm.DynamicBayesianNetwork(prior, [pgm.TableCPD(x, given=parents, table=full)])
    evidence = {u: [0, 2, 1]}
    found, due = pgm.filter(mapped, evidence)[x], pgm.filter(plain, evidence)[x]
    assert_allclose(found.values, due.values, rtol=1e-14)


@pytest.mark.parametrize("tiny", [0.0, 2.0])
@pytest.mark.parametrize("runs", [(), (2,)])
def test_states_that_do_not_depend_on_their_past(monkeypatch, tiny, runs):
    """Smoothing with a state that no table of the transition has as a parent."""
    if tiny:
        monkeypatch.setattr(run, "TINY", tiny)
    rng = np.random.default_rng(1)
    a, b = pgm.Discrete("a", 3), pgm.Discrete("b", 2)
    network = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.TableCPD(a, table=drawn(rng, 3)),
            pgm.TableCPD(b, given=a, table=SEEN[[0, 1, 0]]),
        ],
        transition=[
            pgm.TableCPD(a, table=drawn(rng, 3)),
            pgm.TableCPD(b, given=(b.previous, a), table=drawn(rng, 2, 3, 2)),
        ],
        observation=[pgm.TableCPD(Z, given=b, table=SEEN)],
    )
    posterior = pgm.smooth(network, {Z: np.broadcast_to([1, 0, 1], (*runs, 3))})
    due = unrolled(network, {Z.at(1): 1, Z.at(2): 0, Z.at(3): 1}, 3)
    for step in range(4):
        for v in (a, b):
            found = posterior[v.at(step)].values.reshape(-1, v.size)
            assert_allclose(found, [due[v.at(step)].values] * len(found), rtol=1e-12)
    product = posterior.message(1, 2) * posterior.message(2, 1)
    total = np.log(product.values.sum(axis=(-1, -2))) + product.log_scale
    assert_allclose(total, np.broadcast_to(due.log_evidence, runs), rtol=1e-12)


@pytest.mark.parametrize("size", [1e300, 1e-300, 5e-320])
@pytest.mark.parametrize("steps", [3, 100])
def test_soft_weights_of_any_size(size, steps):
    """A factor of the weights changes the evidence alone."""
    due_rows = np.full((2 * steps, 2), [1.0, 0.5])
    step = np.repeat(np.arange(1, steps + 1), 2)
    posteriors = [
        pgm.smooth(STILL, {Z: pgm.sightings(pgm.soft(rows), step=step)}, steps=steps)
        for rows in (due_rows, due_rows * size)
    ]
    due, found = posteriors
    assert_allclose(found[X].values, due[X].values, rtol=1e-9, atol=1e-300)
    expected = due.log_evidence + 2 * steps * np.log(size)
    assert_allclose(found.log_evidence, expected, rtol=1e-12)


def test_soft_weights_of_both_ends_in_a_row():
    sharp = model(X, Z, np.array([0.5, 0.5]), np.eye(2), np.eye(2))
    weights = np.array([[1e200, 1e-140], [1e-140, 1e200]])
    posterior = pgm.smooth(sharp, {Z: pgm.soft(weights)})
    assert_allclose(posterior[X].values, np.full((3, 2), 0.5), rtol=1e-9)
    assert_allclose(posterior.log_evidence, 60 * np.log(10.0), rtol=1e-12)


@pytest.mark.parametrize("size", [1e-100, 1e100])
def test_many_measurements_of_a_step_online_and_a_lag(size):
    """Their product is no number of double precision, and the lag needs it all the same."""
    robot = pgm.OnlineFilter(STILL, lag=2)
    beliefs = {}
    for factor in (1.0, size):
        belief = robot.initial()
        for _ in range(4):
            belief = robot.predict(belief)
            for _ in range(4):
                belief = robot.update(belief, {Z: pgm.soft([factor, factor / 2])})
        beliefs[factor] = belief
    due, found = beliefs[1.0], beliefs[size]
    assert_allclose(found.lagged[X].values, due.lagged[X].values, rtol=1e-12)
    expected = due.log_evidence + 16 * np.log(size)
    assert_allclose(found.log_evidence, expected, rtol=1e-12)


def test_a_prior_and_a_measurement_whose_product_is_below_the_smallest_number():
    prior, seen = np.array([1.0, 1e-200]), np.array([[1.0, 0.0], [1.0, 1e-140]])
    network = model(X, Z, prior, np.eye(2), seen)
    posterior = pgm.smooth(network, {Z: pgm.sightings([1], step=[0])}, steps=2)
    assert_allclose(posterior[X].values, [[0.0, 1.0]] * 3, rtol=1e-12)
    assert_allclose(posterior.log_evidence, np.log(1e-200) + np.log(1e-140), rtol=1e-12)
    robot = pgm.OnlineFilter(network)
    belief = robot.update(robot.initial(), {Z: 1})
    assert_allclose(belief.log_evidence, posterior.log_evidence, rtol=1e-12)


@pytest.mark.parametrize("states", [[0] * 200, [1] * 5 + [0] * 20, [1] * 50 + [0] * 50])
def test_messages_and_beliefs_where_an_impossible_state_is_far_likelier(states):
    """They were NaN."""
    prior, seen = np.array([0.0, 1.0]), np.array([[1.0, 0.0], [1e-40, 1.0 - 1e-40]])
    posterior = pgm.smooth(model(X, Z, prior, np.eye(2), seen), {Z: states})
    for step in (0, 1, len(states) - 1):
        belief = posterior.belief(step)
        assert_allclose(belief.values.sum(), 1.0, rtol=1e-12)
        assert_allclose(belief.log_scale, posterior.log_evidence, rtol=1e-12)
        product = posterior.message(step, step + 1) * posterior.message(step + 1, step)
        found = np.log(product.values.sum()) + product.log_scale
        assert_allclose(found, posterior.log_evidence, rtol=1e-12)


@pytest.mark.parametrize("steps", [10, 100])
def test_impossible_measurements_are_refused_and_nothing_else_is_said(steps):
    sharp = model(X, Z, np.array([1.0, 0.0]), np.eye(2), np.eye(2))
    states = np.zeros((3, steps), dtype=int)
    states[1, 5] = 1
    with pytest.raises(pgm.EvidenceError, match="z at step 6 has probability zero") as caught:
        pgm.smooth(sharp, {Z: states[1]})
    assert caught.value.step == 6
    with pytest.raises(pgm.EvidenceError, match=r"at step 6 .*first in run 1"):
        pgm.smooth(sharp, {Z: states})


def test_refusals():
    still = pgm.TableCPD(X, given=X.previous, table=np.eye(2))
    y = pgm.Discrete("y", 2)
    called = pgm.TableCPD(y, given=y.previous, inputs=X, table=lambda s: np.eye(2))
    prior = [pgm.TableCPD(v, table=[0.5, 0.5]) for v in (X, y)]
    with pytest.raises(pgm.ModelError, match="x is hidden, so no table can be a function of it"):
        pgm.DynamicBayesianNetwork(prior, [still, called])
    with pytest.raises(pgm.GraphError, match="memory= and executor= are for networks without"):
        pgm.most_probable(pgm.compile(STILL, 2), {Z: [0, 1]}, memory=2**30)
    with pytest.raises(pgm.EvidenceError, match=r"7 \(first in row 1\)"):
        pgm.filter(STILL, {Z: [0, 7]})
    with pytest.raises(pgm.EvidenceError, match=r"zero \(first in row 1 of run 2\)"):
        pgm.filter(STILL, {Z: pgm.soft([[[1, 1]] * 2] * 2 + [[[1, 1], [0, 0]]])})
    with pytest.raises(pgm.EvidenceError, match=r"give z an array \(..., T\) of steps"):
        pgm.filter(STILL, {Z.at(1): 0})


def test_tables_on_the_way_that_would_not_fit_are_refused(monkeypatch):
    """Three variables that all depend on all before, each way from step to step 40 ** 5 entries."""
    variables = [pgm.Discrete(name, 40) for name in "abc"]
    before = tuple(v.previous for v in variables)
    table = np.full((40,) * 4, 1 / 40)
    network = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(v, table=np.full(40, 1 / 40)) for v in variables],
        [pgm.TableCPD(v, given=before, table=table) for v in variables],
    )
    graph = pgm.compile(network, 1)
    assert SlicePlan(graph.layout).onward.largest == 40**5
    asked = []
    monkeypatch.setattr(run, "require_memory", lambda n, *_, **__: asked.append(n))
    run.require_beliefs(
        SlicePlan(graph.layout), pgm.evidence.bind(network.transition, (), {}, 1), 1
    )
    assert asked[0] == 40**5
    with pytest.raises(pgm.GraphError, match="would take"):
        require_memory(10**15, "it", "take less", error=pgm.GraphError)


def crowd(count):
    """Two binary variables, with a sensor of both, among many of one state; they and all."""
    rng = np.random.default_rng(2)
    a, b = pgm.Discrete("a", 2), pgm.Discrete("b", 2)
    cpds = [
        pgm.TableCPD(a, given=a.previous, table=drawn(rng, 2, 2)),
        pgm.TableCPD(b, given=(b.previous, a), table=drawn(rng, 2, 2, 2)),
    ]
    prior = [pgm.TableCPD(v, table=drawn(rng, 2)) for v in (a, b)]
    single = [pgm.Discrete(f"s{k}", 1) for k in range(count)]
    network = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(v, table=[1.0]) for v in single] + prior,
        transition=[pgm.TableCPD(v, given=v.previous, table=[[1.0]]) for v in single] + cpds,
        observation=[pgm.TableCPD(Z, given=(a, b), table=drawn(rng, 2, 2, 2))],
    )
    return network, a, b, single


@pytest.mark.parametrize("readings", [[0, 1, 1], [[0, 1, 1], [1, 0, -1]]])
@pytest.mark.parametrize("count", [51, 57])
def test_more_variables_than_einsum_has_letters(count, readings):
    network, a, b, single = crowd(count)
    few, *_ = crowd(0)
    found, due = (pgm.smooth(net, {Z: readings}) for net in (network, few))
    for v in (a, b):
        assert_allclose(found[v].values, due[v].values, rtol=1e-12)
        assert_allclose(found.filtered[v].values, due.filtered[v].values, rtol=1e-12)
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)
    scope = (a.at(3), b.at(2))
    if count < 57:
        assert_allclose(found.joint(*scope).values, due.joint(*scope).values, rtol=1e-12)
    assert found.joint(*(v.at(1) for v in single)).values.size == np.size(due.log_evidence)
    path, best = (pgm.most_probable(pgm.compile(net, 3), {Z: readings}) for net in (network, few))
    assert_allclose(path.log_probability, best.log_probability, rtol=1e-12)
    beliefs = []
    for net in (network, few):
        online = pgm.OnlineFilter(net)
        beliefs.append(online.update(online.predict(online.initial()), {Z: 1})[b].values)
    assert_allclose(*beliefs, rtol=1e-12)


def test_more_variables_than_arrays_have_axes():
    network, a, b, _ = crowd(58)
    too_many = (
        r"to the next over \(.* \(61 in all\)\) is a table of too many axes: NumPy's arrays "
        r"have them for 60 variables; leave variables of one state, \(s0, s1, .*\), out of the"
    )
    for call in (
        lambda: pgm.filter(network, {Z: [0]}),
        lambda: pgm.smooth(network, {Z: [[0], [1]]}, lag=1, steps=1),
        lambda: pgm.most_probable(pgm.compile(network, 1), {Z: [0]}),
        lambda: pgm.OnlineFilter(network),
    ):
        with pytest.raises(pgm.GraphError, match=too_many):
            call()
    network, a, b, _ = crowd(57)
    posterior = pgm.smooth(network, {Z: [0, 1]})
    with pytest.raises(pgm.GraphError, match=r"the joint over .* \(62 in all\).*; ask for fewer"):
        posterior.joint(a.at(1), b.at(1), a.at(2))
    for call in (posterior.belief, posterior.potential):
        with pytest.raises(pgm.GraphError, match=r"the joint of two steps over .* \(118 in all\)"):
            call(2)


@pytest.mark.parametrize("tiny", [0.0, 2.0])
def test_joints_with_controls(monkeypatch, tiny):
    """A control that is asked for stays on the way, although no later slice depends on it."""
    if tiny:
        monkeypatch.setattr(run, "TINY", tiny)
    rng = np.random.default_rng(1)
    x, y, c = pgm.Discrete("x", 3), pgm.Discrete("y", 2), pgm.Discrete("c", 2)
    network = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(x, table=drawn(rng, 3)), pgm.TableCPD(y, x, table=drawn(rng, 3, 2))],
        transition=[
            pgm.TableCPD(c, table=[0.3, 0.7]),
            pgm.TableCPD(x, given=(x.previous, c), table=drawn(rng, 3, 2, 3)),
            pgm.TableCPD(y, given=(y.previous, x), table=drawn(rng, 2, 3, 2)),
        ],
        observation=[pgm.TableCPD(Z, given=y, table=SEEN)],
    )
    posterior = pgm.smooth(network, {Z: [1, 0, 1, 0]})
    due = unrolled(network, {Z.at(k): z for k, z in enumerate((1, 0, 1, 0), 1)}, 4)
    for scope in (
        (x.at(0), c.at(1)),
        (c.at(1), y.at(3), x.at(3), c.at(2)),
        (y.at(0), c.at(4), y.at(4), x.at(0)),
        (c.at(3), y.at(2), c.at(2), x.at(2), y.at(3)),
    ):
        assert_allclose(posterior.joint(*scope).values, due.joint(*scope).values, rtol=1e-12)
