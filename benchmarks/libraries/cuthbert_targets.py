"""cuthbert's square-root smoother, parallel in time, jitted, in float64."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from cuthbert import filter as run_filter
from cuthbert import smoother as run_smoother
from cuthbert.gaussian import kalman

import benchmarks.libraries.float64  # noqa: F401
from benchmarks.timing import Contender, compiled
from benchmarks.work.targets import Array, Tracking


def smoothing(work: Tracking) -> Contender:
    """Means (T, 4) and covariances."""
    p = work.parameters
    root = np.linalg.cholesky
    start = p.mean, root(p.cov)
    motion = p.F, np.zeros(4), root(p.motion_cov)
    sensor = p.H, np.zeros(2), root(p.sensor_cov)

    def run(start: Any, motion: Any, sensor: Any, readings: Any) -> tuple[Any, Any]:
        filter_ = kalman.build_filter(*start, lambda y: motion, lambda y: (*sensor, y))
        smoother = kalman.build_smoother(lambda y: motion)
        filtered = run_filter(filter_, readings, filter_.init_prepare(), parallel=True)
        smoothed = run_smoother(smoother, filtered, parallel=True)
        roots = smoothed.chol_cov[1:]
        return smoothed.mean[1:], roots @ roots.swapaxes(-1, -2)

    jitted = jax.jit(run)

    def call() -> tuple[Array, Array]:
        means, covs = jitted(start, motion, sensor, work.readings)
        return np.asarray(means), np.asarray(covs)

    return compiled(call, work.steps)
