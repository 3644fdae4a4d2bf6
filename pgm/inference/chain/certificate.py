"""Whether float64 has digits enough for a linearised chain, or its passes need twice the digits.

float64 rounds a sum to ε = 2.2·10⁻¹⁶ of its largest summand. If the sum is smaller than its
summands by a factor κ, it keeps a relative accuracy of κ ε only. Three differences of a Kalman
filter and smoother can cancel so, and each has its ratio κ:

- A belief's covariance P, before and after measurements. Component i, given the components before
  it, has the variance L_ii² (P = L Lᵀ, L lower triangular), and κ = P_ii / L_ii². This is large
  where two components are almost the same.
- A measurement's reduction of a variance, P − G S Gᵀ with its gain G. Per component κ = P_ii
  before the measurements of a step over P_ii after them, or after a smoother's later ones, too. A
  variance that falls to exactly zero loses nothing.
- An innovation's covariance S = H P Hᵀ + R where the sensor has no noise. The part that the
  readings before it leave open is its pivot L_jj² (S = L Lᵀ), and κ = (Σ_i |h_i| σ_i)² / L_jj².

Every κ must stay below `MODERATE`, 2·10⁷, which leaves κ ε ≤ 4.4·10⁻⁹. The segments that a
balanced tree composes multiply such losses, hence their limit is lower, `GENTLE`, 4·10⁶.

Means have a test of their own. A mean is rounded to ε times the largest number that it came from,
which may stand at another step: a start of 10⁸ m, say, for a state that is known to 1 mm later. The
rounding ε |m| / σ, in standard deviations, is carried along the chain. It counts where it is more
than 3·10⁻⁸ and 30 times the rounding that the mean has by its own size.

A smoothed covariance is tested for the rounding of the reversed conditionals, too; see
`reversal_rounding`.

Where one test fails, the passes are done again in pairs of float64 (`careful`).
"""

from __future__ import annotations

import numpy as np

from pgm.inference.chain import reversal_rounding
from pgm.inference.chain.forward import Filtered, Forward
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.vector import stacks
from pgm.kernels import along_runs, last_place, roots
from pgm.kernels.arrays import Array, apply, deviation, sandwich, variances

# The largest ratio at which float64 leaves all the digits that are promised.
MODERATE = 2e7
# A stricter ratio, for covariances from which segments of a balanced tree are composed.
GENTLE = 4e6
# Standard deviations of a mean's rounding that count elsewhere, where they are so many times more
# than the rounding of the mean there.
_COUNTS, _FARTHER = 3e-8, 30.0
# The standard deviations that a mean's rounding may be, if its belief is to go on in float64.
_TOLD = 1e-8
_EPS = float(np.finfo(np.float64).eps)
# The same for a mean that an online filter steps from: mean² is then at most FAR variances.
SHARE = 1e-5
FAR = (SHARE / _EPS) ** 2


def is_flat(plan: ChainPlan) -> bool:
    """Whether the prior has an infinite variance."""
    return any(np.isinf(link.family.own_noise).any() for link in plan.prior)


def is_ordinary(mean: Array, cov: Array, share: float = _TOLD) -> bool:
    """Whether float64 has digits enough for beliefs of means (..., n), covariances (..., n, n).

    They are enough if covariances are finite, each component keeps over 1 / `MODERATE` of its
    variance given those before it, and the rounding ε |m| of each mean is at most the part `share`
    of its standard deviation, 10⁻⁸ unless given.
    """
    if not np.isfinite(cov).all() or not roots.is_regular(cov, 1.0 / MODERATE):
        return False
    return bool((share * deviation(cov) >= _EPS * np.abs(mean)).all())


def suffices(plan: ChainPlan, swept: Forward | Filtered, smoothed: Array | None = None) -> bool:
    """Whether a forward pass, and the covariances that a smoother made of it, kept their digits.

    `smoothed` are the smoothed covariances (T+1, runs, n, n), or None after a filter; the plan is
    as it was linearised for the pass. A `Filtered` is a pass that kept no predicted covariances.
    Only its means are judged, and its `closest`: the smallest 1/κ of the module's first two
    ratios κ, as recorded during the pass.
    """
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
    """Whether segments of a chain with these covariances compose without a loss of digits.

    `predicted` and `known` are the covariances before and after measurements, (T+1, runs, n, n).
    Segments compose if the measurements of no step leave less than 1 / `limit` of a variance, other
    than zero, and each component keeps over 1 / `limit` of its variance, given the components
    before it in the vector.
    """
    with np.errstate(all="ignore"):
        stands = _hold(predicted, known, limit)
        return stands and _is_regular(predicted, limit) and _is_regular(known, limit)


def _means_sink(swept: Forward | Filtered, *, both: bool) -> bool:
    """Whether the rounding of a mean that is large at one step counts at another one.

    Rounding moves a mean by ε |m| / σ standard deviations. The error is carried to later steps, and
    by a smoother, which `both` says, to earlier ones; it is taken for as many standard deviations
    there, which bounds it. At another step it counts where it is over 3·10⁻⁸, and over 30 times
    the rounding of that step's own means.
    """
    mean, left = swept.mean, variances(swept.cov)
    if not last_place.may_count(mean, left, _COUNTS):
        return False
    mean, known = np.abs(mean), left <= 0.0
    parts = _EPS * np.where(known, 0.0, mean / np.sqrt(np.where(known, 1.0, left))).max(axis=-1)
    largest = parts.max(axis=0) if both else np.maximum.accumulate(parts, axis=0)
    return bool(((largest > _COUNTS) & (largest > _FARTHER * parts)).any())


def _is_regular(cov: Array, limit: float) -> bool:
    """Whether each component keeps over 1 / `limit` of its variance given those before it.

    `cov` are covariances (T+1, runs, n, n); it must be so in all of them.
    """
    size = cov.shape[-1]
    last = np.moveaxis(cov, (-2, -1), (0, 1)).reshape(size, size, -1)
    if np.shares_memory(last, cov):
        last = last.copy()
    return along_runs.open_share(last) * limit > 1.0


def _hold(before: Array, after: Array, limit: float) -> bool:
    """Whether no variance falls to less than 1 / `limit` from before measurements to after them.

    `before` and `after` are covariances (T+1, runs, n, n), the latter maybe smoothed. A variance
    that falls to zero is known exactly, which loses nothing, so that it passes; one that falls
    below zero is rounding, and does not.
    """
    left = variances(after)
    fallen = limit * left < variances(before)
    return not fallen.any() or not (fallen & (left != 0.0)).any()


def _told_apart(plan: ChainPlan, swept: Forward) -> bool:
    """Whether innovations of sensors with singular noise keep enough digits of their variances.

    The variance of component j given those before it, its pivot L_jj² in H P Hᵀ + R = L Lᵀ with a
    lower triangle L, may be `MODERATE` times smaller than (Σ_i |H_ji| σ_i)² + R_jj, which bounds
    the summands of the differences that it is found from.
    """
    exact = [s for s in plan.sensors if s.exact and s.family.step.size]
    for steps, matrix, _, noise, _ in stacks(plan, exact, swept.predicted_mean) if exact else []:
        cov = swept.predicted_cov[steps]
        pivots = variances(roots.root(sandwich(matrix, cov) + noise)) ** 2
        size = apply(np.abs(matrix), deviation(cov)) ** 2 + variances(noise)
        if not ((MODERATE * pivots > size) | (size == 0.0)).all():
            return False
    return True
