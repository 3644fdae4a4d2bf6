"""dynamax's extended and unscented filters and smoothers, jitted, in float64.

Its filters begin with an update, so each first predicts once. It does not wrap angles: the bearing
is written such that it turns over behind the robot, where the work has no landmarks. Its solver
adds 1e-9 to diagonals.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, UKFHyperParams
from dynamax.nonlinear_gaussian_ssm import inference_ekf as ekf
from dynamax.nonlinear_gaussian_ssm import inference_ukf as ukf

import benchmarks.libraries.float64  # noqa: F401
from benchmarks.libraries.jax_robots import drive, sight
from benchmarks.timing import Contender, compiled
from benchmarks.work.robots import Array, Robots

HYPER = UKFHyperParams(alpha=(5.0 / 3.0) ** 0.5, beta=2.0, kappa=0.0)
KEPT = ["filtered_means", "filtered_covariances"]
Moments = tuple[Any, Any]
Step = Callable[..., Moments]


def _params(work: Robots, mean: Any, cov: Any) -> ParamsNLGSSM:
    return ParamsNLGSSM(mean, cov, drive, work.motion_cov, sight, work.sensor_cov)


def _inputs(work: Robots, run: int = 0) -> Array:
    """Control and landmark of each step, (T, 4)."""
    return np.concatenate([work.of(run), work.landmarks[:, 0]], axis=-1)


def _predict(rule: str, work: Robots) -> Step:
    if rule == "taylor":
        slope = jax.jacfwd(drive)
        return lambda mean, cov, u: ekf._predict(mean, cov, drive, slope, work.motion_cov, u)
    total, weights = _weights()
    parts = drive, work.motion_cov, total, *weights
    return lambda mean, cov, u: ukf._predict(mean, cov, *parts, u)[:2]


def _update(rule: str, work: Robots) -> Step:
    if rule == "taylor":
        terms = sight, jax.jacfwd(sight), work.sensor_cov
        return lambda mean, cov, u, y: ekf._condition_on(mean, cov, *terms, u, y, 1)
    total, weights = _weights()
    parts = sight, work.sensor_cov, total, *weights
    return lambda mean, cov, u, y: ukf._condition_on(mean, cov, *parts, u, y)[1:]


def _weights() -> tuple[float, tuple[Any, Any]]:
    total = HYPER.alpha**2 * (3 + HYPER.kappa) - 3
    return total, ukf._compute_weights(3, HYPER.alpha, HYPER.beta, total)


def _step(rule: str, work: Robots) -> Step:
    """One prediction and one update, of dynamax's own parts."""
    predict, update = _predict(rule, work), _update(rule, work)
    return lambda mean, cov, u, y: update(*predict(mean, cov, u), u, y)


def one_step(rule: str, work: Robots) -> Contender:
    """One step of every run: means (runs, 1, 3) and covariances."""
    start = work.start
    step = jax.jit(jax.vmap(partial(_step(rule, work), *start)))

    def call() -> tuple[Array, Array]:
        landmarks = np.broadcast_to(work.landmarks[0, 0], (work.runs, 2))
        inputs = np.concatenate([work.controls[:, 0], landmarks], axis=-1)
        means, covs = step(inputs, work.readings[:, 0, 0])
        return np.asarray(means)[:, None], np.asarray(covs)[:, None]

    return compiled(call, work.runs)


def filtering(rule: str, work: Robots) -> Contender:
    """All runs in one call: means (runs, T, 3) and covariances."""
    predict = _predict(rule, work)

    def run(readings: Any, inputs: Any) -> Moments:
        params = _params(work, *predict(*work.start, inputs[0]))
        if rule == "taylor":
            found = ekf.extended_kalman_filter(params, readings, inputs, output_fields=KEPT)
        else:
            found = ukf.unscented_kalman_filter(params, readings, HYPER, inputs, output_fields=KEPT)
        return found.filtered_means, found.filtered_covariances

    jitted = jax.jit(jax.vmap(run, in_axes=(0, None)))

    def call() -> tuple[Array, Array]:
        means, covs = jitted(work.readings[:, :, 0], _inputs(work))
        return np.asarray(means), np.asarray(covs)

    return compiled(call, work.runs * work.steps)


def smoothing(rule: str, work: Robots) -> Contender:
    """One run, forward and back: means (T, 3) and covariances."""
    predict = _predict(rule, work)

    def run(readings: Any, inputs: Any) -> Moments:
        params = _params(work, *predict(*work.start, inputs[0]))
        if rule == "taylor":
            found = ekf.extended_kalman_smoother(params, readings, inputs=inputs)
        else:
            found = ukf.unscented_kalman_smoother(params, readings, HYPER, inputs)
        return found.smoothed_means, found.smoothed_covariances

    jitted = jax.jit(run)

    def call() -> tuple[Array, Array]:
        means, covs = jitted(work.readings[0, :, 0], _inputs(work))
        return np.asarray(means), np.asarray(covs)

    return compiled(call, work.steps)


def online(rule: str, work: Robots) -> Contender:
    """One jitted step in a Python loop: means (T, 3) and covariances."""
    step = jax.jit(_step(rule, work))

    def call() -> tuple[Array, Array]:
        means, covs = np.empty((work.steps, 3)), np.empty((work.steps, 3, 3))
        mean, cov = (jnp.asarray(each) for each in work.start)
        inputs = _inputs(work)
        for k in range(work.steps):
            mean, cov = step(mean, cov, inputs[k], work.readings[0, k, 0])
            means[k], covs[k] = mean, cov
        return means, covs

    return compiled(call, work.steps)
