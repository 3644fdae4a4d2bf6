"""Whether float64 has digits enough for a chain: how far apart its standard deviations lie.

A covariance in float64 keeps what is small in it to about 10⁻¹⁶ of what is large. Where every
belief is regular, no variance along any direction is much smaller than its parts, and neither what
a transition nor what a measurement sums up loses digits. These ratios bound what is lost:

- of a belief, before and after measurements: a variance over the share of it that is left open by
the
  components before it;
- of a component: its variance before measurements, at the step or later ones, over that after them;
- of measurements without noise: (Σ_j |h_j| σ_j)² over the share of the variance of an innovation
that
  is left open by those before it.

A mean is rounded to some 10⁻¹⁶ of the largest numbers that it went through. In units of the
standard deviations there, that has to be little, or not much more than the rounding of the mean
itself in units of its own.

Where all ratios are moderate, the passes in float64 are right; where one is not, they are made in
twice the digits.
"""

from __future__ import annotations

import numpy as np

from pgm.inference.chain import reversal_rounding
from pgm.inference.chain.forward import Filtered, Forward
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.vector import stacks
from pgm.kernels import along_runs, roots
from pgm.kernels.arrays import Array, apply, deviation, sandwich, variances

# The largest ratio at which float64 leaves all the digits that are promised.
MODERATE = 2e7
# And that at which composing segments of a balanced tree leaves them too.
GENTLE = 4e6
# Rounding of a mean, in its deviations, that counts where numbers are so many times smaller.
_COUNTS, _FARTHER = 3e-8, 30.0
# The part of a deviation that rounding of a mean may be, of a belief that goes on in float64.
_TOLD = 1e-8
_EPS = float(np.finfo(np.float64).eps)
# And of one that an online filter takes a step from; the square of such a mean, in its variance.
SHARE = 1e-5
FAR = (SHARE / _EPS) ** 2


def is_flat(plan: ChainPlan) -> bool:
    """Whether the prior has an infinite variance."""
    return any(np.isinf(link.family.own_noise).any() for link in plan.prior)


def is_ordinary(mean: Array, cov: Array, share: float = _TOLD) -> bool:
    """Whether float64 can carry beliefs: covariances (..., n, n), and means beside deviations.

    The rounding of a mean may be so large a share of its deviation.
    """
    if not np.isfinite(cov).all() or not roots.is_regular(cov, 1.0 / MODERATE):
        return False
    return bool((share * deviation(cov) >= _EPS * np.abs(mean)).all())


def suffices(plan: ChainPlan, swept: Forward | Filtered, smoothed: Array | None = None) -> bool:
    """Whether a forward pass, and the covariances that a smoother made of it, kept their digits."""
    with np.errstate(all="ignore"):  # a ratio of what is not finite is no moderate one
        if swept.far and _means_sink(swept, both=smoothed is not None):
            return False
        moderate = swept.closest * MODERATE > 1.0
        if isinstance(swept, Filtered):
            return moderate
        predicted, known = swept.predicted_cov, swept.cov
        if smoothed is not None and not _hold(known, smoothed, MODERATE):
            return False
        if not (moderate or composes(predicted, known, MODERATE)) or not _told_apart(plan, swept):
            return False
        if smoothed is None:
            return True
        return reversal_rounding.keeps_digits(plan, predicted, known, smoothed)


def composes(predicted: Array, known: Array, limit: float = GENTLE) -> bool:
    """Whether segments about these covariances, before and after measurements, compose well."""
    with np.errstate(all="ignore"):
        stands = _hold(predicted, known, limit)
        return stands and _is_regular(predicted, limit) and _is_regular(known, limit)


def _means_sink(swept: Forward | Filtered, *, both: bool) -> bool:
    """Whether a mean comes from numbers so large that its last digits count where it is small.

    The error of a mean is ε |mean|: in deviations ε |mean| / σ. It is carried along the chain, and
    stays at most as many deviations at later steps, and with `both` at earlier ones.
    """
    mean, left = swept.mean, variances(swept.cov)
    axes = tuple(range(mean.ndim - 1))
    farthest = np.maximum(mean.max(axis=axes), -mean.min(axis=axes))
    least = left.min(axis=axes)
    if (least > 0.0).all() and (_EPS * farthest <= _COUNTS * np.sqrt(least)).all():
        return False
    mean, known = np.abs(mean), left <= 0.0
    least = np.where(known, np.inf, left).min(axis=axes)
    if (_EPS * farthest <= _COUNTS * np.sqrt(least)).all():
        return False
    parts = _EPS * np.where(known, 0.0, mean / np.sqrt(np.where(known, 1.0, left))).max(axis=-1)
    largest = parts.max(axis=0) if both else np.maximum.accumulate(parts, axis=0)
    return bool(((largest > _COUNTS) & (largest > _FARTHER * parts)).any())


def _is_regular(cov: Array, limit: float) -> bool:
    """Whether in all beliefs (T+1, runs, n, n) each component has a share 1 / `limit` of its own.

    That is, the part of its variance that the components before it leave open.
    """
    size = cov.shape[-1]
    last = np.moveaxis(cov, (-2, -1), (0, 1)).reshape(size, size, -1)
    if np.shares_memory(last, cov):
        last = last.copy()
    return along_runs.open_share(last) * limit > 1.0


def _hold(before: Array, after: Array, limit: float) -> bool:
    """Whether no variance falls to less than 1 / `limit` from before a measurement to after it.

    One that falls to zero is known exactly, which loses nothing; a negative one is rounding.
    """
    left = variances(after)
    fallen = limit * left < variances(before)
    return not fallen.any() or not (fallen & (left != 0.0)).any()


def _told_apart(plan: ChainPlan, swept: Forward) -> bool:
    """Whether innovations of measurements without noise keep enough digits of their variances.

    The variance that the readings before it leave open of one, its pivot in H P Hᵀ + R, is compared
    with (Σⱼ |hⱼ| σⱼ)², the largest summands that it is the difference of.
    """
    exact = [s for s in plan.sensors if s.exact and s.family.step.size]
    for steps, matrix, _, noise, _ in stacks(plan, exact, swept.predicted_mean) if exact else []:
        cov = swept.predicted_cov[steps]
        pivots = variances(roots.root(sandwich(matrix, cov) + noise)) ** 2
        size = apply(np.abs(matrix), deviation(cov)) ** 2 + variances(noise)
        if not ((MODERATE * pivots > size) | (size == 0.0)).all():
            return False
    return True
