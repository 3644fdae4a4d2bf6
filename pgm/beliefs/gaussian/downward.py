"""Moments of a block of components on the way down a tree, from those that it shares with another.

Of a block's components the pivots x are given by its separators s, which a block above it holds,
as x = gain s + offset + v with cov v = noise. V is the number of covariances and N the number of
columns of means that go with each; a batch is of B blocks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import dense, step
from pgm.kernels.arrays import Array, apply, deviation, transpose

# Variances below this, in units of the prior's, are rounding of what exact relations determine.
CERTAIN = 1e-28


class Regression(NamedTuple):
    """The pivots of a batch of blocks given their separators.

    gain: (V, B, p, s).
    offset: (V, B, p, N).
    noise: (V, B, p, p).
    """

    gain: Array
    offset: Array
    noise: Array


class Moments(NamedTuple):
    """Means (V, B, n, N) and covariances (V, B, n, n) of blocks' components, pivots first."""

    mean: Array
    cov: Array


def moments(given: Regression, mean: Array, cov: Array, *, exact: bool) -> Moments:
    """The moments of blocks, from means (V, B, s, N) and covariances (V, B, s, s) of separators.

    `exact` says that relations without noise may determine some pivots.
    """
    parts = dense.Stack(cov, True), dense.Stack(given.gain), dense.Stack(given.noise)
    cross, own = (each.array for each in step.crossed(*parts))
    if exact:
        own = certain(own)
        cross = np.where((np.diagonal(own, axis1=-2, axis2=-1) > 0.0)[..., None], cross, 0.0)
    drop = own.shape[-1]
    means = np.concatenate([given.gain @ mean + given.offset, mean], axis=2)
    covs = np.empty((*means.shape[:3], means.shape[2]))
    covs[..., :drop, :drop], covs[..., drop:, drop:] = own, cov
    covs[..., :drop, drop:], covs[..., drop:, :drop] = cross, transpose(cross)
    return Moments(means, covs)


def magnified(given: Regression, cov: Array, found: Array) -> float:
    """How much larger the summands of a pivot's variance are than itself, at the most.

    `cov` (V, B, s, s) are the separators' covariances, `found` (V, B, n, n) those of the blocks.
    """
    summands = apply(np.abs(given.gain), deviation(cov))
    return float((summands / deviation(found)[..., : summands.shape[-1]]).max(initial=1.0)) ** 2


def certain(cov: Array) -> Array:
    """Covariances (..., n, n) in which variances of at most 10⁻²⁸, mere rounding, are set to zero.

    Variances are in units of the prior's. The covariances of such a component are set to zero, too.
    """
    open_ = np.diagonal(cov, axis1=-2, axis2=-1) > CERTAIN
    if open_.all():
        return cov
    return np.where(open_[..., None] & open_[..., None, :], cov, 0.0)
