"""An ensemble Kalman filter, as a user would write it."""

import numpy as np

import pgm


def spread(points):
    """The deviations of points (runs, n, d) from their mean, angles aside."""
    return points - points.mean(axis=1, keepdims=True)


def product(a, b):
    """The covariance of deviations (runs, n, i) with (runs, n, j), (runs, i, j)."""
    return a.swapaxes(1, 2) @ b / (a.shape[1] - 1)


class EnsembleKalman(pgm.BeliefFamily):
    """n members, moved by the model and corrected by their own covariance.

    Each member is given a measurement with noise of its own (Burgers et al., 1998); back in time
    members are regressed on those of the step after (Evensen & van Leeuwen, 2000).
    """

    beliefs = "ensembles"
    warns = {"members": pgm.Threshold(10, below=True, remedy="take more")}  # noqa: RUF012

    def __init__(self, n, seed=0):
        self.n, self.seed = n, seed

    def begin(self, at):
        return at.prior(self.n, at.generators(self.seed))

    def predict(self, at, belief):
        return at.moved(belief, at.generators(self.seed))

    def take(self, at, belief):
        total, generators = np.zeros(at.runs), at.generators(self.seed)
        for seen in at.measurements:
            drawn, missing = seen.draw(belief, generators), np.isnan(seen.value)[:, None]
            # About one member, lest angles turn; what a run has not measured moves nothing in it.
            off = np.where(missing, 0.0, spread(seen.residual(drawn, drawn[:, :1])))
            residual = np.where(missing, 0.0, seen.residual(seen.value[:, None], drawn))
            cov = product(off, off) + missing * np.eye(missing.shape[-1])
            gain = np.linalg.solve(cov, product(off, spread(belief)))
            belief = belief + residual @ gain
            middle = residual.mean(axis=1)
            whitened = np.linalg.solve(cov, middle[..., None])[..., 0]
            total -= 0.5 * (np.sum(middle * whitened, axis=-1) + np.linalg.slogdet(cov)[1])
            total -= 0.5 * np.log(2.0 * np.pi) * np.sum(~missing[:, 0], axis=-1)
        return belief, total

    def back(self, at, known, predicted, later):
        off = spread(predicted)
        cov = np.linalg.pinv(product(off, off), rcond=1e-10, hermitian=True)
        return known + (later - predicted) @ (cov @ product(off, spread(known)))

    def points(self, belief):
        return belief, None

    def numbers(self, belief):
        return {"members": self.n}
