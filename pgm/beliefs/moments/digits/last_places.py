"""The rounding of a chain's means to their last place in float64, in standard deviations.

The last place u(m) of a float64 m is the distance from m to the next number. An error e of a mean m
comes from three kinds of rounding:

- A mean that was found in twice the digits is rounded once, at the end: e = ½ u(m) at most.
- A pass in float64 rounds at each step: forward three times (prediction, residual, update), which
  makes e = 1½ u(m) at most; back, in a smoother, four times, e = 2 u(m) at most.
- A nonlinear function is evaluated in float64 in any pass. In one of twice the digits this alone
  is rounded at each step, e = ½ u(m).

Errors are counted in standard deviations σ of the mean: e/σ is the *share* of e. σ is taken to be
at least 10⁻⁹ of the largest deviation that the component had. At step t the largest share of the
components is e_t/σ_t, and √ν_t is the error of the means in standard deviations, with all that
other steps add to it. A pass forward adds the error of step t − 1, of which it forgets a part:

    ν_t = ρ_t ν_{t−1} + (e_t/σ_t)²,
    ρ_t = min(max P_{t−1}/P⁻_t, max (1 − Q_t/P⁻_t)) · max P_t/P⁻_t.

Each "max" is over the components. P⁻_t and P_t are a component's variances before and after the
measurements of step t, and Q_t is the variance of the transition's noise. The first factor of ρ_t
is the part of a predicted variance that is not new, and the second is the part that measurements
leave. A pass back adds the error of step t + 1; with the smoothed variances P′ of the components

    ν_t = ρ′_t ν_{t+1} + (e_t/σ_t)²,
    ρ′_t = min(1, (max P_t/P⁻_{t+1})² · max P′_{t+1}/P′_t).

As long as no ½ u(m)/σ exceeds 10⁻⁶, last places leave enough digits, and the status of the
inference does not mention them.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.digits.close_points import carried, ratio
from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.beliefs.moments.passes.forward import Filtered, Forward
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.kernels import last_place
from pgm.kernels.arrays import Array, deviation, variances
from pgm.posteriors.status import ENOUGH_DIGITS

# The rounding of a mean, in standard deviations, from which on it is told.
TOLD = 10.0**-ENOUGH_DIGITS
# Roundings, of half a last place each, of a step forward and of one back.
_FORWARD, _BACK = 3.0, 4.0
_NEAR = (2.0 * TOLD / float(np.finfo(np.float64).eps)) ** 2


def error(
    plan: ChainPlan,
    swept: Forward | Filtered,
    smoothed: Beliefs | None,
    *,
    careful: bool,
    measured: bool,
) -> Array | None:
    """The largest error of a chain's means by last places, in standard deviations, (runs,).

    It is the largest one of all steps, with the errors that the passes carry from other steps.

    Parameters
    ----------
    plan : ChainPlan
        As it was linearised for the passes.
    swept : Forward or Filtered
        The forward pass. A `Filtered` one, which lacks the predicted moments, is made again where
        these are needed.
    smoothed : Beliefs or None
        The means and covariances of a smoother; None after a filter.
    careful : bool
        Whether the passes were made in twice the digits, and their means rounded at the end.
    measured : bool
        Whether the status counts digits already, for another reason. The result is then always an
        array; else it is None if no ½ u(m)/σ exceeds 10⁻⁶ in any run.
    """
    every = [] if smoothed is None else [(smoothed.mean, smoothed.cov)]
    if measured or swept.far:
        every.append((swept.mean, swept.cov))
    with np.errstate(all="ignore"):
        if not measured:
            # Without a floor, since only a whole pass knows the largest deviations.
            every = [each for each in every if _may_count(*each) and _counts(*each)]
        if not every:
            return None
        ahead = swept.whole if isinstance(swept, Filtered) else swept
        widest = _widest(ahead)
        most = np.max([of_beliefs(*each, widest).max(axis=0) for each in every], axis=0)
        if careful and plan.exact:
            return np.asarray(most)
        times = 1.0 if careful else _FORWARD
        if not measured and not (most > TOLD).any():
            return None
        added = (times * of_beliefs(ahead.mean, ahead.cov, widest)) ** 2
        past = carried(ahead, added, _old(plan, ahead))
        if smoothed is None:
            return past
        if careful:
            return np.asarray(np.hypot(past, most))
        return np.asarray(np.hypot(past, _back(ahead, smoothed, widest)))


def of_step(moments: Moments) -> Array | float:
    """The largest e/σ of the means after a step of an online filter, (runs,), with e = 1½ u(m).

    The result is the number 0.0 if no ½ u(m)/σ exceeds 10⁻⁶ in any run. `moments` are those of the
    slice, the vector of the step's hidden variables, after the step's measurements.
    """
    mean, cov = moments.mean, moments.cov
    variance = np.einsum("ii...->i...", cov)
    if not (mean * mean > _NEAR * variance).any():
        return 0.0
    found = of_each_step(moments)
    return found if (found > _FORWARD * TOLD).any() else 0.0


def of_each_step(moments: Moments) -> Array:
    """The largest e/σ of the means after a step of an online filter, (runs,), however small.

    e is 1½ u(m), and `moments` are those of the slice, the vector of the step's hidden variables,
    after the step's measurements.
    """
    return np.asarray(_FORWARD * of_beliefs(*moments.by_run, np.zeros(1)))


def _may_count(mean: Array, cov: Array) -> bool:
    """Whether ½ u(m)/σ may exceed 10⁻⁶ for some component of the means m, `mean` (..., n).

    A bound that takes little time decides: False is certain, True is not. σ² are the variances in
    `cov` (..., n, n).
    """
    return last_place.may_count(mean, variances(cov), 2.0 * TOLD)


def _counts(mean: Array, cov: Array) -> bool:
    """Whether ½ u(m)/σ exceeds 10⁻⁶ for some component of the means m, `mean` (..., n).

    σ² are the variances in `cov` (..., n, n). σ is not raised to 10⁻⁹ of the largest deviation.
    """
    return bool((of_beliefs(mean, cov, np.zeros(1)) > TOLD).any())


def of_beliefs(mean: Array, cov: Array, largest: Array) -> Array:
    """The largest ½ u(m) / σ of the components of beliefs (..., n) and (..., n, n), as (...).

    `largest` (..., n) are the largest variances that the components had: σ is taken to be at least
    10⁻⁹ of their roots. Zeros set no such bound.
    """
    return last_place.rounding(mean, deviation(cov), np.sqrt(largest))


def _old(plan: ChainPlan, ahead: Forward) -> Array:
    """The part of a predicted variance that is not new noise, max 1 − Q/P⁻_t, (T, runs).

    The maximum is over the components of the slice, the vector of a step's hidden variables, for
    t = 1..T. Q are the variances of the transition's noise as the plan is linearised, and P⁻_t the
    predicted variances of the forward pass `ahead`.
    """
    front, spread = plan.layout.state_size, variances(ahead.predicted_cov)[1:]
    new = np.zeros(spread.shape)
    for link in plan.transition if plan.steps else ():
        new[..., link.child.start - front : link.child.stop - front] = variances(link.family.noise)
    return ratio(np.maximum(spread - new, 0.0), spread)


def _back(ahead: Forward, smoothed: Beliefs, widest: Array) -> Array:
    """The largest √ν_t of all steps in a smoother's pass back in float64, (runs,).

    It is carried from step t + 1 to t by ρ′_t. `ahead` is the forward pass, `smoothed` has the
    smoother's beliefs, and `widest` (runs, n) are the largest variances that the components had.
    """
    after = variances(smoothed.cov)
    stays = ratio(variances(ahead.cov)[:-1], variances(ahead.predicted_cov)[1:]) ** 2
    stays = np.minimum(stays * ratio(after[1:], after[:-1], most=np.inf), 1.0)
    added = (_BACK * of_beliefs(smoothed.mean, smoothed.cov, widest)) ** 2
    total = most = added[-1]
    for row, more in zip(stays[::-1], added[-2::-1], strict=True):
        total = row * total + more
        most = np.maximum(most, total)
    return np.asarray(np.sqrt(most))


def _widest(ahead: Forward) -> Array:
    """The largest finite variance of each component at any step of a forward pass, (runs, n).

    Variances before and after the measurements of a step both count.
    """
    spread = np.maximum(variances(ahead.predicted_cov), variances(ahead.cov))
    found: Array = np.where(spread < np.inf, np.maximum(spread, 0.0), 0.0).max(axis=0, initial=0.0)
    return found
