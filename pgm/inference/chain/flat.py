"""A flat prior: δ, the unknown that all means of a careful pass are functions of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.inference.chain.taking import CLEAR, ROUNDING, Belief, variances
from pgm.kernels import twofold
from pgm.kernels.arrays import Array, symmetric
from pgm.kernels.roots import NEGLIGIBLE
from pgm.kernels.twofold import Twofold

# A share of the variances beyond which a negative eigenvalue is visible in float64.
_VISIBLE = 1e-12


class Solved(NamedTuple):
    """An estimate of δ.

    Attributes
    ----------
    weights : Twofold
        (runs, 1 + q, 1): [1 δ] for its mean δ; zero where nothing is known of a component.
    cov : Twofold
        (runs, q, q): of what is known of it.
    open : ndarray
        (runs, q, q): directions in which nothing is known, as columns, or zeros.
    log_weight : ndarray
        (runs,): what integrating δ out adds to the log-density of the readings.
    """

    weights: Twofold
    cov: Twofold
    open: Array
    log_weight: Array

    def between(self, first: Belief, second: Belief) -> Twofold:
        """The share of δ in the covariance of two slices, (runs, n, n)."""
        return first.columns[..., 1:] @ self.cov @ second.columns[..., 1:].mT


def solved(whole: Twofold) -> Solved:
    """The estimate of δ from W = Σ [v V]ᵀ[v V] / S, (runs, 1 + q, 1 + q).

    With M = Σ VᵀV / S and y = Σ Vᵀv / S it is δ = −M⁻¹y; its covariance M⁻¹. Where M is singular,
    its determinant is the product of the eigenvalues that are not zero: the limit of priors κ I.
    """
    runs, size = whole.shape[0], whole.shape[-1] - 1
    weights = Twofold(np.zeros((runs, size + 1, 1)))
    weights.hi[:, 0] = 1.0
    if not size:
        nothing = np.zeros((runs, 0, 0))
        return Solved(weights, Twofold(nothing), nothing, np.zeros(runs))
    unit, pivots = twofold.eliminated(whole[:, 1:, 1:], CLEAR * ROUNDING)
    known = pivots.hi > 0.0
    cov = twofold.inverse(unit, pivots)
    one = Twofold(np.broadcast_to(np.eye(size), unit.shape).copy())
    mean = -(cov @ whole[:, 1:, :1])
    weights[:, 1:] = mean
    level = -(whole[:, :1, 1:] @ mean).hi[:, 0, 0]
    log_det = np.log(np.where(known, pivots.hi, 1.0)).sum(axis=-1)
    if not known.all():
        spanned = np.where(known[:, None, :], unit.hi, 0.0)
        log_det += np.linalg.slogdet(spanned.mT @ spanned + np.eye(size) * ~known[:, None, :])[1]
    open_ = np.where(known[:, None, :], 0.0, twofold.solve_unit(unit, one).mT.hi)
    return Solved(weights, cov, open_, 0.5 * (level - log_det))


def moments(belief: Belief, unknown: Solved) -> tuple[Array, Array]:
    """Mean and covariance; the variance of a component of which nothing is known is infinite."""
    columns, cov, *_ = belief
    mean = (columns @ unknown.weights).hi[..., 0]
    if not unknown.open.shape[-1]:
        return mean, _semidefinite(cov.hi)
    total = _semidefinite((cov + unknown.between(belief, belief)).hi)
    slope = columns.hi[..., 1:]
    reach, size = np.abs(slope @ unknown.open), np.abs(slope) @ np.abs(unknown.open)
    lost = np.any(reach > NEGLIGIBLE * size, axis=-1)
    if lost.any():
        total = np.where(lost[..., None] | lost[..., None, :], 0.0, total)
        diagonal = np.einsum("...ii->...i", total)
        diagonal[lost] = np.inf
    return mean, total


def _semidefinite(cov: Array) -> Array:
    """Covariances without the asymmetry and the negative eigenvalues that rounding has left.

    Eigenvalues are in units of the variances, which are right to a hundredth (`CLEAR`): one that
    is further below zero is no rounding.
    """
    cov = symmetric(cov)
    unit = np.sqrt(np.maximum(variances(cov), 0.0))
    unit = np.where(unit > 0.0, unit, 1.0)
    scaled = cov / unit[..., None] / unit[..., None, :]
    if not np.isfinite(scaled).all():
        return cov
    values, axes = np.linalg.eigh(scaled)
    least = values.min(axis=-1, initial=0.0)
    blurred = (least < -_VISIBLE) & (least > -1.0 / CLEAR)
    if not blurred.any():
        return cov
    kept = (axes * np.maximum(values, 0.0)[..., None, :]) @ axes.mT
    return np.where(blurred[:, None, None], kept * unit[..., None] * unit[..., None, :], cov)
