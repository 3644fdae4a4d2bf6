"""Guided proposals against exact beliefs, and against the weights that theory gives."""

import numpy as np
import pytest
from clouds import cart, mark, move, pose, robot, robot_evidence, seen, x, z
from scipy.stats import multivariate_normal

import pgm

STEP, COV = np.array([[1.0, 0.5], [0.0, 0.9]]), np.array([[0.2, 0.05], [0.05, 0.1]])


def guided(n=400, **named):
    return pgm.Particles(n, proposal=pgm.Taylor(), **{"threshold": 0.0, **named})


def test_linear_particles_weigh_as_their_parents_predict():
    """The proposal is optimal: w = p(z | x of the step before), wherever x is drawn."""
    values = np.array([[0.8], [1.3], [1.7]])
    posterior = pgm.filter(cart(0.01), {z: values}, belief=guided())
    before = posterior[x][0].states
    total = np.zeros(len(before))
    for step in (1, 2, 3):
        mean, spread = before @ STEP[0], COV[0, 0] + 0.01
        total += multivariate_normal(0.0, spread).logpdf(values[step - 1] - mean)
        weights = np.exp(total - total.max())
        np.testing.assert_allclose(posterior[x][step].weights, weights / weights.sum(), atol=1e-12)
        before = posterior[x][step].states


@pytest.mark.parametrize("lineariser", [pgm.Taylor(), pgm.Unscented(), pgm.GaussHermite(3)])
def test_guided_filters_are_exact_within_monte_carlo_errors(lineariser):
    values = np.array([[0.8], [1.3], [1.7], [np.nan], [2.0]])
    exact = pgm.filter(cart(0.01), {z: values})
    found = [
        pgm.filter(cart(0.01), {z: values}, belief=pgm.Particles(1000, seed=k, proposal=lineariser))
        for k in range(40)
    ]
    ratios = np.exp([f.log_evidence - exact.log_evidence for f in found])
    assert abs(ratios.mean() - 1.0) < 3.0 * ratios.std() / np.sqrt(40)
    means = np.stack([f[x].mean for f in found])
    error = np.abs(means.mean(axis=0) - exact[x].mean)
    assert (error < 4.0 * means.std(axis=0) / np.sqrt(40)).all()


def test_precise_measurements_leave_guided_particles_their_weight():
    values = np.array([[0.8], [1.3], [1.7]])
    with pytest.warns(pgm.ParticleWarning):
        free = pgm.filter(cart(1e-5), {z: values}, belief=pgm.Particles(200, threshold=1.0))
    led = pgm.filter(cart(1e-5), {z: values}, belief=guided(200, threshold=1.0))
    assert (free.status.effective[1:] < 20).all()
    assert (led.status.effective[1:] > 80).all()


def test_a_robot_and_its_bootstrap_agree():
    evidence = robot_evidence(6)
    free = pgm.filter(robot(), evidence, belief=pgm.Particles(60_000, seed=1))
    led = pgm.filter(robot(), evidence, belief=guided(60_000, threshold=0.5))
    assert led.status.effective[1:].mean() > free.status.effective[1:].mean()
    for step in range(1, 7):
        error = np.abs(led[pose][step].mean - free[pose][step].mean)
        assert (error < 5.0 * free[pose][step].std / np.sqrt(free.status.effective[step])).all()
        np.testing.assert_allclose(led[pose][step].std, free[pose][step].std, rtol=0.03)
    np.testing.assert_allclose(led.log_evidence, free.log_evidence, atol=0.05)


def test_hidden_controls_move_states_without_noise_of_their_own():
    """The transition of the state is singular: its noise is that of the control."""
    push = pgm.Variable("push")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, mean=[0.0, 1.0], cov=[[1.0, 0.3], [0.3, 0.5]])],
        transition=[
            pgm.GaussianCPD(push, mean=0.2, cov=0.3),
            pgm.LinearGaussianCPD(
                x, given={x.previous: STEP, push: [[0.5], [1.0]]}, cov=np.zeros((2, 2))
            ),
        ],
        observation=[pgm.LinearGaussianCPD(z, given={x: [[1.0, 0.0]]}, cov=0.01)],
    )
    values = np.array([[0.8], [1.3], [1.7], [2.0]])
    exact = pgm.filter(model, {z: values})
    found = pgm.filter(model, {z: values}, belief=guided(40_000))
    for variable in (x, push):
        np.testing.assert_allclose(found[variable].mean, exact[variable].mean, atol=0.02)
        np.testing.assert_allclose(found[variable].std, exact[variable].std, rtol=0.03)
    np.testing.assert_allclose(found.log_evidence, exact.log_evidence, atol=0.03)
    moved = found[x].states[:-1] @ STEP.T + found[push].states * [0.5, 1.0]
    np.testing.assert_allclose(found[x].states[1:], moved, atol=1e-12)


def test_online_is_offline():
    given = robot_evidence(5)
    offline = pgm.filter(robot(), given, belief=guided(200, threshold=0.5))
    online = pgm.OnlineFilter(robot(), belief=offline.particles)
    belief = online.initial()
    for step in range(1, 6):
        belief = online.predict(belief, {move: given[move][step - 1]})
        now = np.flatnonzero(given[seen].step == step)
        read = pgm.sightings(given[seen].values[now], given={mark: given[seen].given[mark][now]})
        belief = online.update(belief, {seen: read})
        np.testing.assert_array_equal(belief[pose].states, offline[pose][step].states)
        np.testing.assert_allclose(belief[pose].weights, offline[pose][step].weights, atol=1e-12)
        again = online.update(belief, {seen: read})
        np.testing.assert_array_equal(again[pose].states, belief[pose].states)
    np.testing.assert_allclose(belief.log_evidence, offline.log_evidence, atol=1e-9)


@pytest.mark.filterwarnings("ignore::pgm.ParticleWarning")
def test_runs_of_a_batch_are_runs_by_themselves(monkeypatch):
    evidence = robot_evidence(4, runs=(3,))
    both = pgm.filter(robot(), evidence, belief=guided(200, threshold=0.5))
    one = {
        move: evidence[move],
        seen: pgm.sightings(
            evidence[seen].values[0], step=evidence[seen].step, given=evidence[seen].given
        ),
    }
    alone = pgm.filter(robot(), one, belief=guided(200, threshold=0.5))
    np.testing.assert_allclose(both[pose][0].states, alone[pose].states, atol=1e-12)
    monkeypatch.setattr("pgm.beliefs.points.cloud.BLOCK", 64)
    cut = pgm.filter(robot(), evidence, belief=guided(200, threshold=0.5))
    np.testing.assert_allclose(cut[pose][0].mean, alone[pose].mean, atol=0.3)
    assert (cut.status.effective[0] > 10).all()


def test_densities_weigh_where_gaussian_sensors_guide():
    """A sensor given by its density alone is in the weights and not in the proposal."""
    laplace = pgm.Variable("laplace")
    density = pgm.SampledCPD(
        laplace, given=x, log_density=lambda y, x: -np.abs(y - x[..., 1:])[..., 0] - np.log(2.0)
    )
    plain = cart(0.01)
    model = pgm.DynamicBayesianNetwork(plain.prior, plain.transition, [*plain.observation, density])
    evidence = {z: np.array([[0.8], [1.3]]), laplace: np.array([[0.9], [0.6]])}
    free = pgm.filter(model, evidence, belief=pgm.Particles(200_000))
    led = pgm.filter(model, evidence, belief=guided(50_000))
    np.testing.assert_allclose(led[x].mean, free[x].mean, atol=0.02)
    np.testing.assert_allclose(led.log_evidence, free.log_evidence, atol=0.03)


def test_float32_states():
    values = np.array([[0.8], [1.3], [1.7]])
    found = pgm.filter(cart(0.01), {z: values}, belief=guided(20_000, dtype=np.float32))
    exact = pgm.filter(cart(0.01), {z: values})
    assert found[x].states.dtype == np.float32
    np.testing.assert_allclose(found[x].mean, exact[x].mean, atol=0.03)


def test_what_guides_no_particles():
    with pytest.raises(pgm.ModelError, match=r"is no lineariser"):
        pgm.Particles(10, proposal="taylor")
    jump = pgm.SampledCPD(x, given=x.previous, sample=lambda x, size, rng: x)
    model = pgm.DynamicBayesianNetwork(cart().prior, [jump], cart().observation)
    with pytest.raises(pgm.ModelError, match="proposals of a lineariser"):
        pgm.filter(model, {z: np.zeros((2, 1))}, belief=guided())
    with pytest.raises(pgm.ModelError, match="proposals of a lineariser"):
        pgm.OnlineFilter(model, belief=guided())


def test_a_proposal_without_support_is_refused():
    model = cart()
    sharp = pgm.DynamicBayesianNetwork(
        model.prior,
        model.transition,
        [pgm.LinearGaussianCPD(z, given={x: [[1.0, 1.0]]}, cov=1e-20)],
    )
    with pytest.raises(pgm.NumericalError, match="no support"):
        pgm.filter(sharp, {z: np.zeros((2, 1))}, belief=guided())
