"""The Bayes, Kalman and particle filters as textbooks print them, and smoothers, in NumPy alone.

One run at a time, and nothing of the engine, whose results are compared with these. Names follow
Thrun, Burgard and Fox (Probabilistic Robotics, 2005, chapters 2 to 4) and the report's Algorithms
1 to 4, misprints corrected: μ and Σ are the last belief's, μ̄ and Σ̄ the predicted one's. Beliefs of
finitely many states are arrays of probabilities (K,), those of particles arrays of states (M, n).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Function = Callable[[Array], Array]


class Belief(NamedTuple):
    """A Gaussian belief bel(x): mean (n,), covariance (n, n)."""

    mean: Array
    cov: Array


class Step(NamedTuple):
    """The result of one call of a filter, all given the readings so far.

    Attributes
    ----------
    predicted : Belief
        Of x_t, before its reading.
    filtered : Belief
        Of x_t.
    cross : ndarray
        (n, n): covariance of x_{t−1} and x_t before the reading, which the smoother needs.
    log_density : float
        ln p(z_t | readings before).
    """

    predicted: Belief
    filtered: Belief
    cross: Array
    log_density: float


class DiscreteStep(NamedTuple):
    """The result of one call of the discrete Bayes filter, all given the readings so far.

    Attributes
    ----------
    predicted, filtered : ndarray
        (K,): of x_t, before its reading and after.
    joint : ndarray
        (K, K): of x_{t−1} and x_t before the reading, which the smoother needs.
    log_density : float
        ln p(z_t | readings before).
    """

    predicted: Array
    filtered: Array
    joint: Array
    log_density: float


class ParticleStep(NamedTuple):
    """The result of one call of the particle filter, all given the readings so far.

    Attributes
    ----------
    predicted, filtered : ndarray
        (M, n): particles of x_t, before its reading, and drawn anew after it.
    weights : ndarray
        (M,): those of the predicted particles given the reading, of sum one.
    log_density : float
        ln p(z_t | readings before), estimated.
    """

    predicted: Array
    filtered: Array
    weights: Array
    log_density: float


Known = TypeVar("Known", Belief, Array)
Found = TypeVar("Found", Step, DiscreteStep, ParticleStep)
Given = TypeVar("Given")


def bayes_filter(
    one_step: Callable[[Known, Given, Given], Found],
    initial: Known,
    controls: Iterable[Given],
    readings: Iterable[Given],
) -> list[Found]:
    """Algorithm 1: each belief from the one before, the control and the reading."""
    steps: list[Found] = []
    belief: Any = initial
    for u, z in zip(controls, readings, strict=True):
        steps.append(one_step(belief, u, z))
        belief = steps[-1].filtered
    return steps


def discrete_bayes_filter(
    belief: Array, u: int, z: int, *, motion: Array, sensor: Array
) -> DiscreteStep:
    """Algorithm 1 of finitely many states: sum over the state before, weigh, normalise.

        bel⁻(x) = Σ_x' p(x | u, x') bel(x'),    bel(x) = η p(z | x) bel⁻(x)

    Parameters
    ----------
    belief : ndarray
        (K,), of x_{t−1}.
    u, z : int
        Numbers of the control and of the reading; a reading of −1 was not taken.
    motion : ndarray
        (K, actions, K): p(x_t | x_{t−1}, u), the last axis being x_t.
    sensor : ndarray
        (K, readings): p(z | x).

    Raises
    ------
    ValueError
        If the reading is impossible given those before: there is no η.
    """
    joint = belief[:, None] * motion[:, u]
    predicted = joint.sum(axis=0)
    weighed = predicted * sensor[:, z] if z >= 0 else predicted
    likelihood = weighed.sum()
    if likelihood <= 0.0:
        raise ValueError(f"the reading {z} is impossible given those before")
    return DiscreteStep(predicted, weighed / likelihood, joint, float(np.log(likelihood)))


def discrete_smoother(initial: Array, steps: Sequence[DiscreteStep]) -> list[Array]:
    """Smooth what the discrete Bayes filter found, from the last step back to the initial belief.

        belˢ(x_{t−1}) = Σ_x p(x_{t−1}, x_t) belˢ(x_t) / bel⁻(x_t)

    The joint is that before the reading of x_t; x_t that cannot be are left out. It is Rauch, Tung
    and Striebel's recursion with sums for their Gaussians (Särkkä, Bayesian Filtering and
    Smoothing, 2013, theorem 8.1).
    """
    smoothed = [steps[-1].filtered if steps else initial]
    for step in reversed(steps):
        possible = step.predicted > 0.0
        ratio = smoothed[-1][possible] / step.predicted[possible]
        smoothed.append(step.joint[:, possible] @ ratio)
    return smoothed[::-1]


def kalman_filter(
    belief: Belief,
    u: Array,
    z: Array,
    *,
    A: Array,
    B: Array,
    C: Array,
    process_noise: Array,
    sensor_noise: Array,
) -> Step:
    """Algorithm 2: x_t = A x_{t−1} + B u_t + noise and z_t = C x_t + noise."""
    mu, sigma = belief
    mu_bar = A @ mu + B @ u  # line 2
    sigma_bar = A @ sigma @ A.T + process_noise
    S = C @ sigma_bar @ C.T + sensor_noise
    K = sigma_bar @ C.T @ np.linalg.inv(S)  # line 4
    innovation = z - C @ mu_bar
    filtered = Belief(mu_bar + K @ innovation, (np.eye(mu.size) - K @ C) @ sigma_bar)
    return Step(Belief(mu_bar, sigma_bar), filtered, sigma @ A.T, log_normal(innovation, S))


def extended_kalman_filter(
    belief: Belief,
    u: Array,
    z: Array,
    *,
    g: Callable[[Array, Array], Array],
    G: Callable[[Array, Array], Array],
    h: Function,
    H: Function,
    process_noise: Array,
    sensor_noise: Array,
) -> Step:
    """Algorithm 3: x_t = g(x_{t−1}, u_t) + noise and z_t = h(x_t) + noise, with Jacobians G and H.

    G is taken at the last mean, H at the predicted one.
    """
    mu, sigma = belief
    slope = G(mu, u)
    mu_bar = g(mu, u)  # line 2
    sigma_bar = slope @ sigma @ slope.T + process_noise
    C = H(mu_bar)
    S = C @ sigma_bar @ C.T + sensor_noise
    K = sigma_bar @ C.T @ np.linalg.inv(S)  # line 4
    innovation = z - h(mu_bar)
    filtered = Belief(mu_bar + K @ innovation, (np.eye(mu.size) - K @ C) @ sigma_bar)
    return Step(Belief(mu_bar, sigma_bar), filtered, sigma @ slope.T, log_normal(innovation, S))


def sigma_points(belief: Belief) -> tuple[Array, Array, Array]:
    """Points (2n + 1, n) and their weights for means and for covariances, (4.27) to (4.33).

    With λ = n − 1, κ = 0 and β = 2, so that α² = (n + λ) / (n + κ) = (2n − 1) / n.
    """
    n = belief.mean.size
    spread, beta = n - 1.0, 2.0  # the first is λ
    alpha_squared = (n + spread) / n
    columns = np.linalg.cholesky((n + spread) * belief.cov).T
    points = belief.mean + np.vstack([np.zeros(n), columns, -columns])
    mean_weights = np.full(2 * n + 1, 0.5 / (n + spread))
    mean_weights[0] = spread / (n + spread)
    cov_weights = mean_weights.copy()
    cov_weights[0] += 1.0 - alpha_squared + beta
    return points, mean_weights, cov_weights


def unscented_kalman_filter(
    belief: Belief,
    u: Array,
    z: Array,
    *,
    g: Callable[[Array, Array], Array],
    h: Function,
    process_noise: Array,
    sensor_noise: Array,
) -> Step:
    """Algorithm 4: the same model with sigma points, drawn anew from the predicted belief."""
    points, w_m, w_c = sigma_points(belief)  # line 2
    moved = np.array([g(point, u) for point in points])
    mu_bar = w_m @ moved
    sigma_bar = _covariance(w_c, moved - mu_bar, moved - mu_bar) + process_noise
    cross = _covariance(w_c, points - belief.mean, moved - mu_bar)
    redrawn, _, _ = sigma_points(Belief(mu_bar, sigma_bar))  # line 6
    seen = np.array([h(point) for point in redrawn])
    z_hat = w_m @ seen
    S = _covariance(w_c, seen - z_hat, seen - z_hat) + sensor_noise
    K = _covariance(w_c, redrawn - mu_bar, seen - z_hat) @ np.linalg.inv(S)  # lines 10, 11
    filtered = Belief(mu_bar + K @ (z - z_hat), sigma_bar - K @ S @ K.T)
    return Step(Belief(mu_bar, sigma_bar), filtered, cross, log_normal(z - z_hat, S))


def rts_smoother(initial: Belief, steps: Sequence[Step]) -> list[Belief]:
    """Smooth what a filter found, from the last step back to the initial belief.

    With the filtered μ, Σ of x_t and the predicted μ̄, Σ̄ of x_{t+1}, the gain is
    J = Cov(x_t, x_{t+1}) Σ̄⁻¹, and (Rauch, Tung and Striebel, 1965)

        μˢ_t = μ + J (μˢ_{t+1} − μ̄),    Σˢ_t = Σ + J (Σˢ_{t+1} − Σ̄) Jᵀ.

    The covariance is Σ Aᵀ or Σ Gᵀ, or that of the sigma points: one smoother for three filters.
    """
    before = [initial, *(step.filtered for step in steps)]
    smoothed = [before.pop()]
    for (mu, sigma), step in zip(reversed(before), reversed(steps), strict=True):
        J = step.cross @ np.linalg.inv(step.predicted.cov)
        mean = mu + J @ (smoothed[-1].mean - step.predicted.mean)
        cov = sigma + J @ (smoothed[-1].cov - step.predicted.cov) @ J.T
        smoothed.append(Belief(mean, cov))
    return smoothed[::-1]


def particle_filter(
    particles: Array,
    u: Array,
    z: Array,
    *,
    sample: Callable[[Array, Array, np.random.Generator], Array],
    density: Callable[[Array, Array], float],
    rng: np.random.Generator,
) -> ParticleStep:
    """Particle_filter and Monte Carlo localisation (tables 4.3 and 8.2): sample, weigh, resample.

    Parameters
    ----------
    particles : ndarray
        (M, n), of x_{t−1}.
    u, z : ndarray
    sample : callable
        ``sample(x, u, rng)`` draws x_t of p(x_t | u, x_{t−1} = x).
    density : callable
        ``density(z, x)``, p(z | x).
    rng : numpy.random.Generator

    Raises
    ------
    ValueError
        If no particle explains the reading: there is nothing to draw.
    """
    moved, weights = np.empty_like(particles), np.empty(len(particles))
    for m, x in enumerate(particles):
        moved[m] = sample(x, u, rng)  # line 4
        weights[m] = density(z, moved[m])  # line 5, the importance factor
    likelihood = weights.mean()
    if likelihood <= 0.0:
        raise ValueError(f"no particle explains the reading {z}")
    chosen = low_variance_sampler(weights, rng)  # lines 8 to 11
    weights /= weights.sum()
    return ParticleStep(moved, moved[chosen], weights, float(np.log(likelihood)))


def low_variance_sampler(weights: Array, rng: np.random.Generator) -> list[int]:
    """Table 4.4: M teeth of a comb, 1/M apart, fall on the particles laid end to end by weight.

    One random number sets the comb; a particle has ⌊M w⌋ or ⌈M w⌉ of the teeth (Madow 1949).
    """
    ends, M = np.cumsum(weights), len(weights)
    i, chosen = 0, []
    shift = 1.0 - rng.random()  # in (0, 1]: no tooth at 0, where a particle may have no weight
    for m in range(M):
        while ends[i] < ends[-1] * ((m + shift) / M):
            i += 1
        chosen.append(i)
    return chosen


def log_normal(offset: Array, cov: Array) -> float:
    """The log-density of N(0, cov) at an offset."""
    _, log_determinant = np.linalg.slogdet(2.0 * np.pi * cov)
    return float(-0.5 * (offset @ np.linalg.solve(cov, offset) + log_determinant))


def _covariance(weights: Array, a: Array, b: Array) -> Array:
    """Σ w a bᵀ over the points."""
    return (weights[:, None] * a).T @ b
