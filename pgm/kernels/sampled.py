"""Moments estimated from independent groups of weighted draws, and the error of a divergence.

Draws x of n components come in G groups that are independent and alike: the parts of one sample, or
the runs of a simulation with other seeds. Group c has the *mass* M_c, the sum of its weights, and
the weighted sums O_c of offsets δ = x − a from a place a, and S_c of δ δᵀ. Together they estimate

    m = Σ O_c / M,   P = Σ S_c / M − m mᵀ,   M = Σ M_c,

and the part of group c in their errors, to first order, is

    m_c = (O_c − M_c m) / M,   P_c = (S_c − O_c mᵀ − m O_cᵀ + M_c (m mᵀ − P)) / M,

with sums of zero: the covariance of (m, P) is about G/(G − 1) Σ_c (m_c, P_c)(m_c, P_c)ᵀ
(Efron & Stein, The jackknife estimate of variance, 1981).

KL(N(m, P) ‖ q) in nats, q = N(μ, Q), has the gradients Q⁻¹(m − μ) and ½ (Q⁻¹ − P⁻¹), and the second
derivatives Q⁻¹ and ½ P⁻¹ ⊗ P⁻¹. With the group's terms

    g_c = m_cᵀ Q⁻¹ (m − μ) + ½ tr (Q⁻¹ − P⁻¹) P_c,
    h_cd = m_cᵀ Q⁻¹ m_d + ½ tr P⁻¹ P_c P⁻¹ P_d

it is too large by ½ tr Ŝ on average, Ŝ being the matrix of G/(G − 1) h_cd. Let S be that of
infinitely many groups. Where gradients are exact, the variance is G/(G − 1) Σ g_c² + ½ tr S²; those
at the estimated moments add tr S² to the first part, so that the variance is estimated by

    max(G/(G − 1) Σ g_c² − ½ tr S², ½ tr S²).

The second is left alone where q has the exact moments: the estimate is a χ² then, off by
n (n + 3)/4N of N draws. With ν = G − 1, as of a Wishart matrix,

    tr S² ≈ ν²/((ν − 1)(ν + 2)) (tr Ŝ² − (tr Ŝ)²/ν).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import roots, solving
from pgm.kernels.arrays import Array, symmetric, transpose


class Spread(NamedTuple):
    """The parts m_c and P_c that each group has in the errors of estimated moments.

    mean: (G, ..., n).
    cov: (G, ..., n, n).
    """

    mean: Array
    cov: Array


class Terms(NamedTuple):
    """The parts that groups have in the error of estimated divergences.

    first: g_c √(G/(G − 1)), (G, ...).
    second: h_cd G/(G − 1), (G, G, ...).
    """

    first: Array
    second: Array

    @property
    def bias(self) -> Array:
        """How much too large the divergences are on average, (...)."""
        return np.asarray(0.5 * np.einsum("cc...->...", self.second))

    @property
    def variance(self) -> Array:
        """Their variances, (...)."""
        return variance((self.first**2).sum(axis=0), self.curvature)

    @property
    def curvature(self) -> Array:
        """Tr S², (...), which is not negative."""
        return curvature(self.second)


def variance(slope: Array, curve: Array) -> Array:
    """The variance of an estimate from G/(G − 1) Σ g_c² and tr S², (...) each."""
    return np.asarray(np.maximum(slope - 0.5 * curve, 0.5 * curve))


def curvature(second: Array) -> Array:
    """Tr S², (...), estimated from Ŝ, (G, G, ...), of four groups or more; zero at the least."""
    freedom = len(second) - 1.0
    square, trace = (second**2).sum(axis=(0, 1)), np.einsum("cc...->...", second)
    scale = freedom**2 / ((freedom - 1.0) * (freedom + 2.0))
    return np.asarray(np.maximum(scale * (square - trace**2 / freedom), 0.0))


def spread(mass: Array, first: Array, second: Array, mean: Array, cov: Array) -> Spread:
    """The parts of groups in the errors of m and P.

    mass: M_c, (G, ...).
    first, second: O_c, (G, ..., n), and S_c, (G, ..., n, n).
    mean, cov: m and P of all groups, (..., n) and (..., n, n), offsets from the same place.
    """
    total = mass.sum(axis=0)
    each, whole = mass[..., None], total[..., None]
    outer = first[..., :, None] * mean[..., None, :]
    about = mean[..., :, None] * mean[..., None, :] - cov
    squares = second - outer - transpose(outer) + each[..., None] * about
    return Spread((first - each * mean) / whole, symmetric(squares) / whole[..., None])


def terms(offset: Array, cov: Array, other: Array, found: Spread) -> Terms:
    """The terms of the error of KL(N(m, P) ‖ N(μ, Q)), of regular covariances.

    offset: m − μ, (..., n), angles wrapped.
    cov, other: P and Q, (..., n, n).
    found: The parts of the groups in the errors of m and P.
    """
    lower, own = roots.root(other), roots.root(cov)
    white = solving.whiten(lower, offset)
    means = solving.whiten(np.broadcast_to(lower, found.cov.shape), found.mean)
    by_other, by_own = _whitened(lower, found.cov), _whitened(own, found.cov)
    slope = (means * white).sum(axis=-1)
    slope += 0.5 * (_trace(by_other) - _trace(by_own))
    curve = np.einsum("c...i,d...i->cd...", means, means)
    curve += 0.5 * np.einsum("c...ij,d...ij->cd...", by_own, by_own)
    groups = len(means)
    scale = groups / (groups - 1.0)
    return Terms(np.sqrt(scale) * slope, scale * curve)


def _whitened(lower: Array, each: Array) -> Array:
    """L⁻¹ P_c L⁻ᵀ, (G, ..., n, n), of a root L, (..., n, n)."""
    wide = np.broadcast_to(lower, each.shape)
    return solving.solve_lower(wide, transpose(solving.solve_lower(wide, each)))


def _trace(matrices: Array) -> Array:
    return np.asarray(np.einsum("...ii->...", matrices))


def worth(found: Spread, cov: Array) -> Array:
    """How many independent draws would leave the mean as uncertain as the groups do, (...).

    It is n / tr P⁻¹V with the covariance V of the mean m, and infinite where groups agree.
    """
    lower, groups = roots.root(cov), len(found.mean)
    wide = np.broadcast_to(lower, (groups, *lower.shape))
    white = solving.whiten(wide, found.mean)
    ratio = (white**2).sum(axis=(0, -1)) * groups / (groups - 1.0)
    some = ratio > 0.0
    size = cov.shape[-1]
    return np.where(some, size / np.where(some, ratio, 1.0), np.inf)
