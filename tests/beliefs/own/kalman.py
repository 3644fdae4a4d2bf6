"""The exact Kalman filter and smoother of the walk, as a user would write them, of many runs."""

import numpy as np

import pgm


class Kalman(pgm.BeliefFamily):
    """Means (runs, 1) and variances (runs, 1, 1) of x ← x + N(0, 1), seen with noise N(0, 2)."""

    beliefs = "Kalman beliefs"

    def begin(self, at):
        return np.zeros((at.runs, 1)), np.ones((at.runs, 1, 1))

    def predict(self, at, belief):
        return belief[0], belief[1] + 1.0

    def take(self, at, belief):
        mean, cov = belief
        total = np.zeros(at.runs)
        for seen in at.measurements:
            missing, spread = np.isnan(seen.value), cov[..., 0] + 2.0
            residual = np.where(missing, 0.0, seen.value - mean)
            gain = np.where(missing, 0.0, cov[..., 0] / spread)
            mean, cov = mean + gain * residual, (1.0 - gain)[..., None] * cov
            log_density = -0.5 * (residual**2 / spread + np.log(2.0 * np.pi * spread))
            total += np.where(missing, 0.0, log_density)[:, 0]
        return (mean, cov), total

    def back(self, at, known, predicted, later):
        gain = known[1] / predicted[1]
        mean = known[0] + gain[..., 0] * (later[0] - predicted[0])
        return mean, known[1] + gain**2 * (later[1] - predicted[1])

    def moments(self, belief):
        return belief
