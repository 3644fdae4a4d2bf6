"""Points that fill a normal law: from which smoothers start, and about which a prior is cut."""

from __future__ import annotations

from pgm.kernels import roots, solving
from pgm.kernels.arrays import Array, apply
from pgm.linearisers.sampled import normal


def white_points(count: int, size: int) -> Array:
    """Points (S, n) of a scrambled Sobol sequence, as N(0, I) has them, the same in each call."""
    from scipy.stats.qmc import Sobol  # here, since scipy.stats is slow to import

    digits = (count - 1).bit_length()  # points that are balanced are a power of two
    return normal(Sobol(size, seed=0).random_base2(digits)[:count])


def cut(mean: Array, lower: Array, pieces: int) -> tuple[Array, Array]:
    """A Gaussian N(μ, L Lᵀ) as equally likely narrower ones: their means, and roots.

    A piece is N(μ + √(1 − β) L s, β L Lᵀ), with points s of mean zero and covariance I, so that all
    together have the Gaussian's mean and covariance. The width is that of a kernel for as many
    points of n components, β = pieces^(−2/(n + 4)) (Scott, Multivariate Density Estimation, 1992):
    with less there are gaps between pieces where the Gaussian is thin. `mean` is (..., n) and
    `lower` (..., n, n); the result is (pieces, ..., n), and roots that all pieces share.
    """
    size = mean.shape[-1]
    white = white_points(pieces, size)
    white = white - white.mean(axis=0)
    white = solving.whiten(roots.root(white.T @ white / pieces), white)
    share = pieces ** (-2.0 / (size + 4.0))
    away = apply(lower, white.reshape(pieces, *(1,) * (mean.ndim - 1), size))
    return mean + (1.0 - share) ** 0.5 * away, share**0.5 * lower
