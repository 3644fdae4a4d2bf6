"""Unrolled networks: the same joint density, with concrete variables."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from tests.dense import linear_joint, unrolled

X = pgm.Variable("x", components=("position", "speed"))
Y, U, COMMAND, Z, W, PLACE = pgm.variables("y u command z w place")
STEPS = 4


def model_of():
    """Two states, a hidden control, a sensor with an input, and one of the hidden control."""
    return pgm.DynamicBayesianNetwork(
        prior=[
            pgm.LinearGaussianCPD(Y, {X: [[0.5, 1.0]]}, offset=2.0, cov=0.4),
            pgm.GaussianCPD(X, [1.0, -1.0], [[1.0, 0.3], [0.3, 0.5]]),
        ],
        transition=[
            pgm.LinearGaussianCPD(
                X,
                {X.previous: [[1.0, 0.4], [0.0, 0.9]], U: [[0.1], [1.0]]},
                offset=[0.1, 0.0],
                cov=[[0.2, 0.1], [0.1, 0.05]],
            ),
            pgm.LinearGaussianCPD(Y, {Y.previous: 0.7, X: [[0.0, 1.0]]}, cov=0.3),
            pgm.LinearGaussianCPD(U, {COMMAND: 2.0}, cov=0.6),
        ],
        observation=[
            pgm.LinearGaussianCPD(Z, {X: [[1.0, 0.0]], PLACE: 1.0}, offset=0.5, cov=0.1),
            pgm.LinearGaussianCPD(W, {Y: 1.0, U: 1.0}, cov=0.2),
        ],
    )


def test_the_joint_is_that_of_the_dynamic_network():
    rng = np.random.default_rng(0)
    commands, places = rng.normal(size=(STEPS, 1)), rng.normal(size=(STEPS + 1, 1))
    known = {COMMAND.at(t): commands[t - 1] for t in range(1, STEPS + 1)}
    known |= {PLACE.at(t): places[t] for t in range(STEPS + 1)}
    net = model_of().unroll(STEPS)
    assert set(net.inputs) == set(known)
    nodes = []
    for cpd in net.cpds:
        shift = sum(cpd.matrices[p] @ known[p] for p in cpd.given if p in known)
        hidden = {p: cpd.matrices[p] for p in cpd.given if p not in known}
        nodes.append((cpd.child, hidden, cpd.offset + shift, cpd.cov))
    found = linear_joint(nodes)
    sightings = [(Z, t, {PLACE: places[t]}) for t in range(STEPS + 1)]
    sightings += [(W, t, {}) for t in range(1, STEPS + 1)]
    due = unrolled(model_of(), STEPS, {COMMAND: commands}, sightings)
    labels = [label for label in due.places if isinstance(label, pgm.Variable)]
    labels += [(sensor, k) for k, (sensor, _, _) in enumerate(sightings)]
    same = [v if isinstance(v, pgm.Variable) else v[0].at(sightings[v[1]][1]) for v in labels]
    assert set(same) == {cpd.child for cpd in net.cpds}
    for one, other in zip(found.marginal(*same), due.marginal(*labels), strict=True):
        assert_allclose(one, other, atol=1e-12)


def test_the_graph_is_that_of_the_dynamic_network():
    model = model_of()
    for steps in (0, 1, 3):
        graph, due = model.unroll(steps).to_networkx(), model.to_networkx(steps)
        assert set(graph) == set(due)
        assert set(graph.edges) == set(due.edges)


def test_copies_know_where_they_come_from():
    model = model_of()
    net = model.unroll(2)
    prior, transition = {c.child: c for c in model.prior}, {c.child: c for c in model.transition}
    assert net.cpd(X.at(0)).origin is prior[X]
    assert net.cpd(X.at(1)).origin is net.cpd(X.at(2)).origin is transition[X]
    assert net.cpd(X.at(2)).given == (X.at(1), U.at(2))
    assert net.cpd(Z.at(0)).origin is model.observation[0]
    assert W.at(0) not in net.variables  # its parent u is not there at step 0


def test_slices_stand_one_after_another():
    net = model_of().unroll(300)
    steps = [cpd.child.step for cpd in net.cpds]
    assert steps == sorted(steps)
    for step in (1, 300):
        at = [cpd.child.template for cpd in net.cpds if cpd.child.step == step]
        assert at == [U, X, Y, Z, W]
    assert [cpd.child.template for cpd in net.cpds[:3]] == [X, Y, Z]


def test_functions_derivatives_and_noise_go_along():
    x, u = pgm.Variable("x"), pgm.Variable("u")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 3.0, 0.0)],
        [
            pgm.NonlinearGaussianCPD(
                x,
                (x.previous, u),
                lambda x, u: x * np.exp(u),
                pgm.noise(lambda u: 0.0 * u[..., None], u),
                jacobian={x.previous: lambda x, u: np.exp(u)[..., None]},
            )
        ],
    )
    net = model.unroll(3)
    assert set(net.cpd(x.at(2)).jacobian) == {x.at(1)}
    assert net.cpd(x.at(2)).noise_given == (u.at(2),)
    rates = np.log([2.0, 3.0, 5.0])
    drawn = net.sample(2, inputs={u.at(t): rates[t - 1] for t in (1, 2, 3)}, rng=0)
    assert_allclose(np.hstack([drawn[x.at(t)] for t in range(4)]), [[3.0, 6.0, 18.0, 90.0]] * 2)


def test_runs_of_the_model_stay():
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(Y, [[1.0], [2.0]], 0.0)],
        [pgm.LinearGaussianCPD(Y, {Y.previous: 2.0}, cov=0.0)],
    )
    net = model.unroll(2)
    assert net.lead == (2,)
    assert_array_equal(net.sample(rng=0)[Y.at(2)], [[4.0], [8.0]])


@pytest.mark.parametrize("steps", [-1, 2.0, "3", None, True])
def test_steps_are_a_whole_number(steps):
    with pytest.raises(pgm.ModelError, match=r"slices 0\.\.T; give T, 0 or more"):
        model_of().unroll(steps)
    assert model_of().unroll(np.int64(1)).variables == model_of().unroll(1).variables
