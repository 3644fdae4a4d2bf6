"""cuthbert's extended Kalman filter and smoother, jitted, in float64; angles as for dynamax."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from cuthbert import filter as run_filter
from cuthbert import smoother as run_smoother
from cuthbert.gaussian import moments

import benchmarks.libraries.float64  # noqa: F401
from benchmarks.libraries.jax_robots import drive, sight
from benchmarks.timing import Contender, compiled
from benchmarks.work.robots import Array, Robots


def smoothing(work: Robots) -> Contender:
    """One run, forward and back: means (T, 3) and covariances.

    The filter is sequential, as it linearises on its way; so is the smoother, which on one core is
    the faster way.
    """
    mean, cov = work.start
    motion_root, sensor_root = (
        jnp.linalg.cholesky(each) for each in (work.motion_cov, work.sensor_cov)
    )

    def dynamics(state: Any, given: Any) -> Any:
        return lambda x: (drive(x, given[0]), motion_root), state.mean

    def observation(state: Any, given: Any) -> Any:
        inputs, reading = given
        return lambda x: (sight(x, inputs), sensor_root), state.mean, reading

    filter_ = moments.build_filter(mean, np.linalg.cholesky(cov), dynamics, observation)
    smoother = moments.build_smoother(dynamics)

    def run(inputs: Any, readings: Any) -> tuple[Any, Any]:
        filtered = run_filter(filter_, (inputs, readings), filter_.init_prepare())
        smoothed = run_smoother(smoother, filtered)
        roots = smoothed.chol_cov[1:]
        return smoothed.mean[1:], roots @ roots.swapaxes(-1, -2)

    jitted = jax.jit(run)

    def call() -> tuple[Array, Array]:
        inputs = np.concatenate([work.controls, work.landmarks[:, 0]], axis=-1)
        means, covs = jitted(inputs, work.readings[0, :, 0])
        return np.asarray(means), np.asarray(covs)

    return compiled(call, work.steps)
