"""filterpy's interacting multiple model, one run after the other."""

from __future__ import annotations

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter

from benchmarks.timing import Contender
from benchmarks.work.manoeuvres import Array, Manoeuvres


def filtering(work: Manoeuvres) -> Contender:
    """The probabilities of modes and the means of states, (runs, T, ·)."""

    def call() -> tuple[Array, Array]:
        modes = np.empty((*work.readings.shape[:2], len(work.motions)))
        means = np.empty((*work.readings.shape[:2], 4))
        for run, readings in enumerate(work.readings):
            several = _estimator(work)
            for step, reading in enumerate(readings):
                several.predict()
                several.update(reading[:, None])
                modes[run, step], means[run, step] = several.mu, several.x[:, 0]
        return modes, means

    return Contender(call, work.readings[..., 0].size)


def _estimator(work: Manoeuvres) -> IMMEstimator:
    (mean, cov), (matrix, noise) = work.first, work.sensor
    filters = []
    for motion, own in zip(work.motions, work.noises, strict=True):
        one = KalmanFilter(4, 2)
        one.x, one.P, one.F, one.Q = mean[:, None], cov.copy(), motion, own
        one.H, one.R = matrix, noise
        filters.append(one)
    share = 1.0 / len(filters)
    return IMMEstimator(filters, np.full(len(filters), share), work.table)
