"""The textbook against enumeration, dense conditioning, and numbers worked out by hand."""

from functools import partial
from itertools import product

import numpy as np
import pytest

import pgm
from experiments.textbook import (
    Belief,
    bayes_filter,
    discrete_bayes_filter,
    discrete_smoother,
    extended_kalman_filter,
    kalman_filter,
    log_normal,
    low_variance_sampler,
    particle_filter,
    rts_smoother,
    sigma_points,
    unscented_kalman_filter,
)

A = np.array([[1.0, 0.4], [-0.2, 0.9]])
B = np.array([[0.5], [1.0]])
C = np.array([[1.0, 0.3]])
NOISE = {
    "process_noise": np.array([[0.3, 0.1], [0.1, 0.2]]),
    "sensor_noise": np.array([[0.4]]),
}
INITIAL = Belief(np.array([1.0, -2.0]), np.array([[0.5, 0.2], [0.2, 0.7]]))
CONTROLS = np.array([[0.3], [-1.0], [0.7], [0.1]])
READINGS = np.array([[0.5], [1.1], [-0.8], [0.2]])
FILTERS = {
    "kalman": partial(kalman_filter, A=A, B=B, C=C, **NOISE),
    "extended": partial(
        extended_kalman_filter,
        g=lambda x, u: A @ x + B @ u,
        G=lambda x, u: A,
        h=lambda x: C @ x,
        H=lambda x: C,
        **NOISE,
    ),
    "unscented": partial(
        unscented_kalman_filter, g=lambda x, u: A @ x + B @ u, h=lambda x: C @ x, **NOISE
    ),
}


def dense(seen):
    """Means and covariances of x_0..x_T given the first readings, and their log-density."""
    steps = len(CONTROLS)
    total = np.linalg.inv(np.eye(2 * steps + 2) - np.kron(np.eye(steps + 1, k=-1), A))
    offset = np.concatenate([INITIAL.mean, *(B @ u for u in CONTROLS)])
    noise = np.kron(np.eye(steps + 1), NOISE["process_noise"])
    noise[:2, :2] = INITIAL.cov
    mean, cov = total @ offset, total @ noise @ total.T
    H = np.kron(np.eye(steps + 1)[1 : seen + 1], C)
    S = H @ cov @ H.T + NOISE["sensor_noise"] * np.eye(seen)
    residual = READINGS[:seen, 0] - H @ mean
    gain = np.linalg.solve(S, H @ cov).T
    mean, cov = mean + gain @ residual, cov - gain @ H @ cov
    blocks = [slice(2 * k, 2 * k + 2) for k in range(steps + 1)]
    return [Belief(mean[k], cov[k, k]) for k in blocks], log_normal(residual, S)


def assert_belief(found, due):
    np.testing.assert_allclose(found.mean, due.mean, atol=1e-12)
    np.testing.assert_allclose(found.cov, due.cov, atol=1e-12)


@pytest.mark.parametrize("name", FILTERS)
def test_filters_and_smoother_condition_a_linear_model(name):
    steps = bayes_filter(FILTERS[name], INITIAL, CONTROLS, READINGS)
    for k, step in enumerate(steps, start=1):
        assert_belief(step.predicted, dense(k - 1)[0][k])
        assert_belief(step.filtered, dense(k)[0][k])
    due, log_density = dense(len(READINGS))
    assert sum(step.log_density for step in steps) == pytest.approx(log_density, abs=1e-12)
    smoothed = rts_smoother(INITIAL, steps)
    assert len(smoothed) == len(due)
    for found, belief in zip(smoothed, due, strict=True):
        assert_belief(found, belief)


def test_one_step_by_hand():
    """A prior N(0, 1), no motion, a reading of 1 with variance 1: half way, half the variance."""
    one = np.eye(1)
    step = kalman_filter(
        Belief(np.zeros(1), one),
        np.zeros(1),
        np.ones(1),
        A=one,
        B=one,
        C=one,
        process_noise=0.0 * one,
        sensor_noise=one,
    )
    assert step.filtered == (0.5, 0.5)
    assert step.log_density == pytest.approx(-0.25 - 0.5 * np.log(4.0 * np.pi))


@pytest.mark.parametrize(("n", "variance"), [(1, 2.0), (3, 16 / 3), (6, 67 / 6)])
def test_sigma_points_of_the_report(n, variance):
    """Mean and covariance are kept; x² has mean 1, and the variance that λ = n − 1 gives it."""
    points, w_m, w_c = sigma_points(Belief(np.zeros(n), np.eye(n)))
    assert len(points) == 2 * n + 1
    np.testing.assert_allclose(w_m @ points, 0.0, atol=1e-15)
    np.testing.assert_allclose((w_c[:, None] * points).T @ points, np.eye(n), atol=1e-15)
    squares = points[:, -1] ** 2
    assert w_m @ squares == pytest.approx(1.0)
    assert w_c @ (squares - w_m @ squares) ** 2 == pytest.approx(variance)


def test_a_nonlinear_step_differs_by_rule():
    """A quadratic motion moves the mean by the variance, which only sigma points see."""
    parts = {"g": lambda x, u: x**2, "h": lambda x: x}
    noise = {"process_noise": np.eye(1), "sensor_noise": np.eye(1)}
    belief, nothing = Belief(np.ones(1), np.array([[0.25]])), np.zeros(1)
    slopes = {"G": lambda x, u: 2.0 * np.diag(x), "H": lambda x: np.eye(1)}
    extended = extended_kalman_filter(belief, nothing, nothing, **parts, **slopes, **noise)
    unscented = unscented_kalman_filter(belief, nothing, nothing, **parts, **noise)
    assert extended.predicted == (1.0, 2.0)
    assert unscented.predicted.mean == pytest.approx(1.25)
    assert unscented.predicted.cov == pytest.approx(2.0 + 2.0 * 0.25**2)


def test_controls_and_readings_go_together():
    with pytest.raises(ValueError, match="shorter"):
        bayes_filter(FILTERS["kalman"], INITIAL, CONTROLS, READINGS[:-1])


PRIOR = np.array([0.2, 0.5, 0.0, 0.3])
MOTION = np.array(
    [
        [[0.1, 0.9, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]],
        [[0.0, 0.2, 0.8, 0.0], [0.5, 0.25, 0.25, 0.0]],
        [[0.0, 0.0, 1.0, 0.0], [0.1, 0.2, 0.3, 0.4]],
        [[1e-9, 1.0 - 1e-9, 0.0, 0.0], [0.0, 0.7, 0.0, 0.3]],
    ]
)
SENSOR = np.array([[0.7, 0.2, 0.1], [0.0, 0.5, 0.5], [0.3, 0.3, 0.4], [1.0, 0.0, 0.0]])
ACTIONS, SEEN = [0, 1, 1, 0, 1], [1, 2, -1, 1, 0]


def enumerated(seen):
    """Beliefs of x_0..x_T given the first readings, of all paths, and the readings' log-density."""
    beliefs, total = np.zeros((len(ACTIONS) + 1, len(PRIOR))), 0.0
    for path in product(range(len(PRIOR)), repeat=len(ACTIONS) + 1):
        p = PRIOR[path[0]]
        for t, (u, z) in enumerate(zip(ACTIONS, SEEN, strict=True), start=1):
            p *= MOTION[path[t - 1], u, path[t]]
            p *= SENSOR[path[t], z] if t <= seen and z >= 0 else 1.0
        beliefs[range(len(path)), path] += p
        total += p
    return beliefs / total, np.log(total)


def test_the_discrete_filter_and_smoother_are_enumeration():
    one_step = partial(discrete_bayes_filter, motion=MOTION, sensor=SENSOR)
    steps = bayes_filter(one_step, PRIOR, ACTIONS, SEEN)
    for t, step in enumerate(steps, start=1):
        np.testing.assert_allclose(step.predicted, enumerated(t - 1)[0][t], atol=1e-14)
        np.testing.assert_allclose(step.filtered, enumerated(t)[0][t], atol=1e-14)
    due, log_density = enumerated(len(SEEN))
    assert sum(step.log_density for step in steps) == pytest.approx(log_density, abs=1e-13)
    np.testing.assert_allclose(discrete_smoother(PRIOR, steps), due, atol=1e-14)


def test_without_steps_the_smoother_knows_the_prior():
    np.testing.assert_array_equal(discrete_smoother(PRIOR, []), [PRIOR])


def test_an_impossible_reading_has_no_normaliser():
    known = np.array([0.0, 0.0, 0.0, 1.0])
    stay = np.eye(4)[:, None]
    with pytest.raises(ValueError, match="the reading 1 is impossible given those before"):
        discrete_bayes_filter(known, 0, 1, motion=stay, sensor=SENSOR)


M = 150  # particles
x, v, y = pgm.Variable("x", components=("a", "b")), pgm.Variable("v"), pgm.Variable("y")
NETWORK = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(x, mean=INITIAL.mean, cov=INITIAL.cov)],
    transition=[
        pgm.LinearGaussianCPD(x, given={x.previous: A, v: B}, cov=NOISE["process_noise"]),
    ],
    observation=[pgm.LinearGaussianCPD(y, given={x: C}, cov=NOISE["sensor_noise"])],
)


def textbook_particles(seed):
    """Weighted means (T, n) of the linear model, and the log-density of all readings."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(NOISE["process_noise"])
    variance = NOISE["sensor_noise"].item()
    one_step = partial(
        particle_filter,
        sample=lambda x, u, rng: A @ x + B @ u + root @ rng.standard_normal(2),
        density=lambda z, x: (
            np.exp(-0.5 * ((z - C @ x) ** 2).item() / variance) / np.sqrt(2.0 * np.pi * variance)
        ),
        rng=rng,
    )
    initial = rng.multivariate_normal(INITIAL.mean, INITIAL.cov, size=M)
    steps = bayes_filter(one_step, initial, CONTROLS, READINGS)
    means = np.array([step.weights @ step.predicted for step in steps])
    return means, sum(step.log_density for step in steps)


def engine_particles(seed):
    evidence = {v: CONTROLS, y: READINGS}
    found = pgm.filter(NETWORK, evidence, belief=pgm.Particles(M, seed=seed, threshold=1.0))
    return found[x].mean[1:], float(found.log_evidence)


def test_particles_of_textbook_and_engine_are_exact_within_monte_carlo_errors():
    """Over seeds each has a mean and a spread; the means are the Kalman filter's, both spreads are.

    A mean over seeds has a bias of order 1/M, far below its standard error of 1/√(80 M).
    """
    due = np.array(
        [
            step.filtered.mean
            for step in bayes_filter(FILTERS["kalman"], INITIAL, CONTROLS, READINGS)
        ]
    )
    spreads = []
    for particles in (textbook_particles, engine_particles):
        means, log_densities = zip(*map(particles, range(80)), strict=True)
        spread = np.std(means, axis=0, ddof=1)
        off = (np.mean(means, axis=0) - due) * np.sqrt(80) / spread
        assert np.abs(off).max() < 3.7  # of eight numbers, and t₇₉
        ratio = np.exp(np.array(log_densities) - dense(len(READINGS))[1])  # unbiased
        assert abs(ratio.mean() - 1.0) < 3.5 * ratio.std(ddof=1) / np.sqrt(80)
        spreads.append(spread)
    np.testing.assert_allclose(spreads[0], spreads[1], rtol=0.35)  # each known to 8 %


def test_a_step_of_particles_keeps_them_by_weight():
    """Without motion, the density its own weight: each of the four is there 4 w times."""
    particles = np.array([[0.5], [0.25], [0.25], [0.0]])
    step = particle_filter(
        particles,
        np.zeros(1),
        np.zeros(1),
        sample=lambda x, u, rng: x,
        density=lambda z, x: 3.0 * x.item(),
        rng=np.random.default_rng(0),
    )
    assert step.weights == pytest.approx(particles[:, 0])
    assert step.filtered[:, 0].tolist() == [0.5, 0.5, 0.25, 0.25]
    assert step.log_density == pytest.approx(np.log(3.0 / 4.0))
    with pytest.raises(ValueError, match="no particle explains the reading"):
        particle_filter(
            particles,
            np.zeros(1),
            np.zeros(1),
            sample=lambda x, u, rng: x,
            density=lambda z, x: 0.0,
            rng=np.random.default_rng(0),
        )


@pytest.mark.parametrize("offset", [0.0, 0.5, 1.0 - 2.0**-53])
def test_the_comb_falls_on_weights_alone(offset):
    """A particle of weight w has M w teeth, rounded either way, and none without weight."""

    class Fixed:
        random = staticmethod(lambda: offset)

    weights = np.random.default_rng(0).random(10_007)
    weights[[0, -1]] = 0.0
    counts = np.bincount(low_variance_sampler(weights, Fixed()), minlength=len(weights))
    assert counts.sum() == len(weights)
    assert counts[0] == counts[-1] == 0
    assert (np.abs(counts - len(weights) * weights / weights.sum()) < 1.0 + 1e-6).all()


def test_the_comb_is_unbiased():
    weights, rng = np.array([0.1, 0.2, 0.3, 0.4]), np.random.default_rng(1)
    counts = [np.bincount(low_variance_sampler(weights, rng), minlength=4) for _ in range(2000)]
    np.testing.assert_allclose(np.mean(counts, axis=0), 4.0 * weights, atol=0.05)
