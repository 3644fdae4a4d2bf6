"""Whether float64 has digits enough for a linearised chain, or its passes need twice the digits.

float64 rounds a sum to ε = 2.2·10⁻¹⁶ of its largest summand. If the sum is smaller than its
summands by a factor κ, it keeps a relative accuracy of κ ε only. A Kalman filter and smoother have
three kinds of variances that are such differences, each with its ratio κ:

- The variance of a slice's component i given the components before it. With the Cholesky factor L
  of the belief's covariance P = L Lᵀ, before or after measurements, this variance is L_ii², and
  κ = P_ii / L_ii². It is large where two components are almost the same.
- The variance of a slice's component after the measurements of a step, or after a smoother's later
  ones, too. κ is the variance before these measurements over the variance after them. A variance
  that falls to exactly zero loses nothing.
- The variance of a reading's component j given the components before it, where noise is singular.
  A reading z = H x + noise of covariance R has an innovation of covariance S = H P Hᵀ + R. With the
  Cholesky factor M of S = M Mᵀ this variance is M_jj². Let σ_i be the standard deviation of the
  slice's component i; then κ = ((Σ_i |H_ji| σ_i)² + R_jj) / M_jj², whose numerator bounds the
  summands.

Every κ must stay below `MODERATE`, 2·10⁷, which leaves κ ε ≤ 4.4·10⁻⁹. A balanced tree composes
the conditionals of single steps to those of *segments*, of many successive steps. That multiplies
such losses, hence the limit is lower there, `GENTLE`, 4·10⁶.

Means have a test of their own. Let m be a component's mean and σ its standard deviation. float64
rounds the mean by ε |m| / σ standard deviations: its *own rounding*. Other steps inherit it as so
many standard deviations there, even where the mean is small: from a start of 10⁸ m, say, a state
that is known to 1 mm later. An inherited rounding counts where it is more than 3·10⁻⁸, and more
than 30 times the own rounding of the step that inherits it.

A smoothed covariance is tested for the rounding of the reversed conditionals, too; see
`reversal_rounding`.

Where one test fails, the passes are done again in pairs of float64 (`careful`).
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.digits import reversal_rounding
from pgm.beliefs.moments.passes.forward import Filtered, Forward
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.vector import stacks
from pgm.kernels import last_place, moments, roots, shares
from pgm.kernels.arrays import Array, apply, components_first, deviation, variances

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
    variance given those before it, and the rounding ε |m| of each mean m is at most `share` of its
    standard deviation, 10⁻⁸ unless given.
    """
    if not np.isfinite(cov).all() or not roots.is_regular(cov, 1.0 / MODERATE):
        return False
    return bool((share * deviation(cov) >= _EPS * np.abs(mean)).all())


def suffices(
    plan: ChainPlan,
    swept: Forward | Filtered,
    smoothed: Array | None = None,
    *,
    kept: bool = False,
) -> bool:
    """Whether a forward pass, and the covariances that a smoother made of it, kept their digits.

    `smoothed` are the smoothed covariances (T+1, runs, n, n), or None after a filter; of those that
    are known to be `kept`, as of `Beliefs`, only the pass is judged. The plan is as it was
    linearised for the pass. A `Filtered` is a pass that kept no predicted covariances.
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
        if smoothed is not None and not kept and not _hold(known, smoothed, MODERATE):
            return False
        if not (moderate or composes(predicted, known, MODERATE)) or not _told_apart(plan, swept):
            return False
        if smoothed is None or kept:
            return True
        return reversal_rounding.keeps_digits(plan, predicted, known, smoothed)


def composes(predicted: Array, known: Array, limit: float = GENTLE) -> bool:
    """Whether conditionals of a chain's steps compose to those of segments without loss of digits.

    `predicted` and `known` are the slices' covariances before and after measurements,
    (T+1, runs, n, n). Conditionals compose if the first two ratios κ stay below `limit`: at each
    step each component keeps over 1 / `limit` of its variance given the components before it in
    the slice, and measurements leave 1 / `limit` or more of each variance, or exactly zero.
    """
    with np.errstate(all="ignore"):
        stands = _hold(predicted, known, limit)
        return stands and _is_regular(predicted, limit) and _is_regular(known, limit)


def _means_sink(swept: Forward | Filtered, *, both: bool) -> bool:
    """Whether the rounding of a mean that is large at one step counts at another one.

    A step's own rounding is the largest ε |m| / σ of its components; a component of no variance has
    none. A filter's steps inherit the own rounding of earlier steps; if `both`, as after a
    smoother, steps inherit that of later ones, too. In some run and step the inherited rounding
    must be over 3·10⁻⁸, and over 30 times the step's own.
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
    return shares.open_share(components_first(cov, 2)) * limit > 1.0


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

    They do if the module's third ratio κ is below `MODERATE` for each component of the readings of
    these sensors, at all steps and runs, with the predicted covariances P of `swept`. A component
    with H_j = 0 and R_jj = 0 passes.
    """
    exact = [s for s in plan.sensors if s.exact and s.family.step.size]
    for steps, matrix, _, noise, _ in stacks(plan, exact, swept.predicted_mean) if exact else []:
        cov = swept.predicted_cov[steps]
        pivots = variances(roots.root(moments.predict(cov, matrix, noise))) ** 2
        size = apply(np.abs(matrix), deviation(cov)) ** 2 + variances(noise)
        if not ((MODERATE * pivots > size) | (size == 0.0)).all():
            return False
    return True
