"""An extended Kalman filter in JAX, as dynamax writes it, for many robots on a card, in float64.

A scan over the steps, mapped over the runs and jitted; without dynamax's 1e-9 on diagonals. It does
not wrap angles, of which the robots' readings have no need.
Source: dynamax 1.0, ``nonlinear_gaussian_ssm/inference_ekf.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import benchmarks.libraries.float64  # noqa: F401
from benchmarks.libraries.jax_robots import drive, sight
from benchmarks.work.robots import Robots

# Means (T, runs, 3), covariances (T, runs, 3, 3) and log-evidence (runs,).
Found = tuple[Any, Any, Any]


def filtering(work: Robots, device: Any = None) -> Callable[[], Found]:
    """The filter of all runs, with its numbers on a device, the first card unless given.

    Each call ends when its results lie there. Raises a RuntimeError where JAX has no card.
    """
    there = device or jax.devices("gpu")[0]
    inputs = np.concatenate([work.controls, work.landmarks[:, 0]], axis=-1)
    given = tuple(jax.device_put(each, there) for each in (work.readings[:, :, 0], inputs))
    mean, cov = (jax.device_put(each, there) for each in work.start)
    motion, noise = jnp.asarray(work.motion_cov), jnp.asarray(work.sensor_cov)
    slope, matrix = jax.jacfwd(drive), jax.jacfwd(sight)

    def step(belief: Any, row: Any) -> Any:
        m, p, total = belief
        y, u = row
        f = slope(m, u)
        m, p = drive(m, u), f @ p @ f.T + motion
        h = matrix(m, u)
        s = h @ p @ h.T + noise
        root = jnp.linalg.cholesky(s)
        gain = jax.scipy.linalg.cho_solve((root, True), h @ p).T
        off = y - sight(m, u)
        white = jax.scipy.linalg.solve_triangular(root, off, lower=True)
        halves = jnp.log(jnp.diagonal(root)).sum() + 0.5 * len(y) * jnp.log(2.0 * jnp.pi)
        p = p - gain @ s @ gain.T
        m, p, total = m + gain @ off, 0.5 * (p + p.T), total - 0.5 * white @ white - halves
        return (m, p, total), (m, p)

    def run(readings: Any, inputs: Any) -> Found:
        (_, _, total), (means, covs) = jax.lax.scan(step, (mean, cov, 0.0), (readings, inputs))
        return means, covs, total

    jitted = jax.jit(jax.vmap(run, in_axes=(0, None), out_axes=(1, 1, 0)))

    def call() -> Found:
        found: Found = jax.block_until_ready(jitted(*given))
        return found

    return call
