r"""Laws of modes, adapted by weighed draws of their own mixture.

A mode's part of the weights, f = (y/Ẑ) w_k N_k/q, has the mode's share of the exact density: its
mean is the mode's next weight, and its moments are those of its next law. Where the mixture q is
near the exact density, f is near w_k c with c = N_k/r, of which the moments are known: those of the
law itself. So c is a control variate,

.. math:: E[f g(x)] ≈ \operatorname{mean}((f - β c) g(x)) + β E_{N_k}[g(x)],

with the slope β of the regression of f on c, for g(x) = 1, x and x xᵀ. Near a Gaussian the error is
some ten times smaller than without.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pgm.beliefs.modes.laws import Laws, Target
from pgm.beliefs.modes.pool import BLOCKS, Pool, Weighed, effective, heights_of, slope_of
from pgm.errors import BeliefWarning, levels_to_user
from pgm.kernels import roots
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Mask, quiet, symmetric, transpose
from pgm.kernels.semirings import log_sum
from pgm.schedules.limits import require_runs

ROUNDS = 3
# Draws of fewer effective ones give a warning.
ENOUGH = 100.0
# With N effective draws of p components a law moves N / (N + 4 p) of the way to their moments.
_OWN = 4.0


class Adapted(NamedTuple):
    """The laws that the last draws adapt, and how many these are worth.

    log_evidence: ln of the mean weight of all draws, (runs,).
    effective: The effective number of all draws, (runs,).
    """

    laws: Laws
    log_evidence: Array
    effective: Array


@quiet()
def adapt(target: Target, laws: Laws, draws: int) -> Adapted:
    """The laws of modes, adapted by so many draws a run in each of three rounds.

    Raises
    ------
    NumericalError
        If a law has no density: of CPDs without noise beside exact measurements.
    GraphError
        If the draws would not fit in memory.
    """
    size = (laws.mean.shape[1] + 1) * (target.before + laws.mean.shape[-1])
    of = f"draws={draws:,}, as many of all hidden variables a run,"
    require_runs(draws * size, laws.weights.shape[1], of)
    rng, pool = np.random.default_rng(0), Pool(target)
    part = -(-draws // BLOCKS) * BLOCKS
    for _ in range(ROUNDS):
        pool.draw(laws, part, rng)
        weighed = Weighed(pool, laws)
        laws = moved(pool, laws, weighed)
    return Adapted(laws, weighed.log_evidence, weighed.effective)


def warn_of_few(effective: Array, draws: int) -> None:
    """Warn of draws of which too few are effective, (runs,)."""
    least = float(effective.min(initial=ENOUGH))
    if least < ENOUGH:
        warnings.warn(
            f"draws={draws}: they are worth {least:.0f} equally weighted ones in the worst run "
            "(status.effective), too few to adapt modes by: give more draws, or fewer variables or "
            "steps, or leave draws out",
            BeliefWarning,
            stacklevel=levels_to_user(),
        )


class Moments(NamedTuple):
    """Estimated moments of modes: by mode their mass, (K, runs), and means and covariances.

    Offsets are from the laws' means, (K, steps, runs, p).
    """

    mass: Array
    offsets: tuple[Array, ...]
    covs: tuple[Array, ...]


def moved(pool: Pool, laws: Laws, weighed: Weighed) -> Laws:
    """The laws that draws adapt: moved part of the way to the moments of a mode's own draws.

    With N the effective number of a mode's draws, p that of components and λ = N / (N + 4 p), it is
    λ of the way.
    """
    count = effective(weighed.by_mode)
    found = _of_pool(pool, laws, weighed)
    return _laws(laws, found, lambda size: count / (count + _OWN * size))


def corrected(pool: Pool, laws: Laws, weighed: Weighed) -> Laws:
    """The laws whose moments are those that all draws estimate."""
    found = _of_pool(pool, laws, weighed)
    return _whole(laws, found)


def uncorrected(pool: Pool, laws: Laws, weighed: Weighed) -> Laws:
    """The laws whose moments are those that all draws estimate without control variates."""
    shares = weighed.by_mode
    return _whole(laws, _moments(pool.target, pool.values, laws, shares, np.zeros_like(shares)))


def of_trajectories(target: Target, laws: Laws, values: Array) -> Laws:
    """The laws with the moments of draws of the posterior, (T+1, runs, S, m + n), of equal weights.

    Draws are shared among the modes by their densities.
    """
    with np.errstate(divide="ignore"):  # a mode that a run does not have
        logs = np.log(laws.weights)[..., None] + heights_of(target, laws, values).gaussian
    shares = np.exp(logs - log_sum(logs, 0))
    return _whole(laws, _moments(target, values, laws, shares, np.zeros_like(shares)))


def _whole(laws: Laws, found: Moments) -> Laws:
    """The laws moved the whole way to moments."""
    whole = np.ones_like(found.mass)
    return _laws(laws, found, lambda _: whole)


def _laws(laws: Laws, found: Moments, part_of: Callable[[int], Array]) -> Laws:
    """The laws moved a part of the way to moments, by the number of components."""
    parts = []
    for k, (mean, cov) in enumerate(((laws.first, laws.spread), (laws.mean, laws.cov))):
        part = part_of(mean.shape[-1])[:, None, :, None]
        parts.append(mean + part * found.offsets[k])
        parts.append(cov + part[..., None] * (found.covs[k] - cov))
    return Laws(found.mass / found.mass.sum(axis=0), *parts)


def _of_pool(pool: Pool, laws: Laws, weighed: Weighed) -> Moments:
    """The moments of all modes by the draws of a pool."""
    return _moments(pool.target, pool.values, laws, weighed.by_mode, weighed.controls)


def _moments(target: Target, values: Array, laws: Laws, shares: Array, controls: Array) -> Moments:
    """The moments of all modes, with controls where these give covariances.

    `shares` are the modes' parts of the weights of draws, and `controls` the control variates,
    (K, runs, S); `values` are the draws, (T+1, runs, S, m + n).
    """
    slope = slope_of(shares, controls)
    mass = (shares - slope[..., None] * controls).mean(axis=-1) + slope
    slope = np.where(mass > 0.0, slope, 0.0)
    total, offsets, covs = _controlled(target, values, laws, shares, controls, slope)
    proper = _proper(total, covs)
    if not proper.all():
        slope = np.where(proper, slope, 0.0)
        total, offsets, covs = _controlled(target, values, laws, shares, controls, slope)
        proper = _proper(total, covs)  # else a mode without draws, whose law stays
        at = proper[:, None, :, None]
        offsets = tuple(np.where(at, each, 0.0) for each in offsets)
        olds = (laws.spread, laws.cov)
        covs = tuple(np.where(at[..., None], new, old) for new, old in zip(covs, olds, strict=True))
    return Moments(np.where(laws.weights > 0.0, np.maximum(total, 0.0), 0.0), offsets, covs)


def _controlled(
    target: Target, values: Array, laws: Laws, shares: Array, controls: Array, slope: Array
) -> tuple[Array, tuple[Array, ...], tuple[Array, ...]]:
    """The masses, offsets and covariances of modes, by slopes (K, runs) of their controls."""
    weights = shares - slope[..., None] * controls
    total = weights.mean(axis=-1) + slope
    scale = 1.0 / np.where(total > 0.0, total, 1.0)
    before, angles = target.before, target.angles
    first = values[:1][..., before:][..., target.states]
    groups = (
        (first, laws.first, laws.spread, angles[before:][target.states]),
        (values[1:], laws.mean, laws.cov, angles),
    )
    offsets, covs = [], []
    for drawn, mean, cov, turning in groups:
        found = [
            sums(own, drawn, centre, turning) for own, centre in zip(weights, mean, strict=True)
        ]
        shift = np.stack([each[0] for each in found]) * scale[:, None, :, None]
        square = np.stack([each[1] for each in found]) + slope[:, None, :, None, None] * cov
        square = square * scale[:, None, :, None, None]
        offsets.append(shift)
        covs.append(symmetric(square - shift[..., :, None] * shift[..., None, :]))
    return total, tuple(offsets), tuple(covs)


def sums(weights: Array, values: Array, mean: Array, angles: Mask) -> tuple[Array, Array]:
    """The weighed means of offsets of values (steps, runs, S, p), and of their squares."""
    off = difference(values, mean[:, :, None], angles)
    weighed = off * (weights / weights.shape[-1])[..., None]
    return weighed.sum(axis=2), transpose(weighed) @ off


def _proper(total: Array, covs: tuple[Array, ...]) -> Mask:
    """Where masses are positive and covariances semidefinite at all steps, (K, runs)."""
    found = total > 0.0
    for cov in covs:
        pivots = np.diagonal(roots.root(cov), axis1=-2, axis2=-1)
        found = found & np.isfinite(pivots).all(axis=(1, 3))
    return found
