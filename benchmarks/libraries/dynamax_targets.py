"""dynamax's linear smoothers, parallel in time and not, jitted, in float64."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from dynamax.linear_gaussian_ssm import inference, parallel_inference

import benchmarks.libraries.float64  # noqa: F401
from benchmarks.timing import Contender, compiled
from benchmarks.work.targets import Array, Tracking

SMOOTHERS = {
    "parallel": parallel_inference.lgssm_smoother,
    "sequential": inference.lgssm_smoother,
}


def smoothing(kind: str, work: Tracking) -> Contender:
    """Means (T, n) and covariances."""
    p = work.parameters
    # It begins with an update: the first prediction is ours.
    params = inference.make_lgssm_params(
        p.F @ p.mean,
        p.F @ p.cov @ p.F.T + p.motion_cov,
        p.F,
        p.motion_cov,
        p.H,
        p.sensor_cov,
    )
    smoother = SMOOTHERS[kind]

    def run(params: Any, readings: Any) -> tuple[Any, Any]:
        found = smoother(params, readings)
        return found.smoothed_means, found.smoothed_covariances

    jitted = jax.jit(run)

    def call() -> tuple[Array, Array]:
        means, covs = jitted(params, work.readings)
        return np.asarray(means), np.asarray(covs)

    return compiled(call, work.steps)
