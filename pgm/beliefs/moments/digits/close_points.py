"""How many digits of means rounding leaves where sigma points lie close together, far from zero.

The value of a linearisation is Σ w f(x) over a rule's points x with weights w. Where weights are
large and of both signs, as the 1/α² of ``Unscented(alpha)``, it is a difference, and the rounding
of each f(x) and x, far from zero, grows by as much. Let y be a component of the value at a mean μ,
and the row F its slope there. With float64's relative rounding ε = 2.2·10⁻¹⁶, y is off by

    e = ε c √(y² + Σ_j (F_j μ_j)²),

if the errors of all values and points are independent. c, the rule's *cancellation*, is
√(Σ w² + Σ u²), where u are the weights with which the values f(x) enter the slope, for points of
unit covariance.

A *share* is the part of a standard deviation by which one linearisation's rounding may move a mean.
That of a prediction of standard deviation σ is e/σ. A measurement with slope H and noise variance
R, of a belief of covariance P, has a share of at most e/√R √(HPHᵀ/(HPHᵀ + R)), in standard
deviations of the belief after it. Squares of shares add up to a sum ν_t at step t, and are
forgotten as a filter forgets:

    ν_t = ρ_t ν_{t−1} + Σ share²,    ρ_t = max P_{t−1}/P_t⁻ · max P_t/P_t⁻.

The last sum is over the components of the step's predictions and measurements. P_t⁻ and P_t are
here a component's variances before and after the measurements of step t, and the maxima are over
the components. The first factor of ρ_t is the part of a predicted variance that is not new, the
second the part that a measurement leaves. √ν_t is the error of step t, in standard deviations. A
smoothed mean is a sum of the filtered one and later measurements, and no worse in its own standard
deviations.

A *family* is a CPD at all its *rows*: the steps of a transition, or the measurements of a sensor; a
prior has one row.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pgm.beliefs.moments.passes.forward import Filtered, Forward
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.kernels.arrays import Array, apply, block, sandwich, variances
from pgm.kernels.prefixes import gather
from pgm.linearisation.family import Family, cancellation

_EPS = float(np.finfo(np.float64).eps)
# An error of means, in standard deviations, of which nothing need be told.
NOTHING = 1e-9
# A standard deviation below this part of an earlier one is taken for that part of it.
_SUNK = 1e-9


def error(plan: ChainPlan, swept: Forward | Filtered) -> Array | None:
    """The standard deviations by which means may be off, (runs,): the largest √ν_t of all steps.

    None where no rule has weights that cancel, or a bound at hand shows that it is below 10⁻⁹.

    Parameters
    ----------
    plan : ChainPlan
        As it was linearised for the pass.
    swept : Forward or Filtered
        The forward pass. A `Filtered` has kept no predictions; where the answer depends on them,
        the pass is made again.
    """
    times = largest(families(plan))
    if not times:
        return None
    sharp = any(s.family.bare and cancellation(s.family) for s in plan.read)
    farthest = _farthest(plan, swept.mean, swept.cov)
    if not sharp and times * farthest * (plan.steps + 1) <= NOTHING:
        return None
    ahead = swept.whole if isinstance(swept, Filtered) else swept
    with np.errstate(all="ignore"):
        added = _predictions(plan, ahead)
        for sensor in plan.read:
            times = cancellation(sensor.family)
            if times:
                rows = sensor.family.step - plan.first
                mean = gather(ahead.predicted_mean, rows)[..., sensor.parents]
                cov = block(gather(ahead.predicted_cov, rows), sensor.parents, sensor.parents)
                own = variances(sensor.family.noise)
                share = _of_reading(_rounding(sensor.family, times, mean), sensor.family, cov, own)
                if sensor.taken is not None:
                    share = np.where(sensor.taken, share, 0.0)
                np.add.at(added, rows, share.sum(axis=-1))
        return carried(ahead, added)


def of_step(
    plan: ChainPlan,
    before: Moments,
    after: Moments,
    digits: Array | None,
    place: Array | float = 0.0,
) -> Array | None:
    """The `error` (runs,) after a step of an online filter, from the decimal digits left before it.

    `before` and `after` are the beliefs over the slice before and after the step. `digits` is
    −log₁₀ of the error before the step for each run, in the shape of the user's axes of runs; None
    as long as no digits were lost. If `plan` has a transition, the step is a prediction, and ρ is
    the first of its two factors alone; else it is an update, and ρ is the second. Slopes are not at
    hand. So the share of the step is taken to be ε c times the largest distance of a mean or a
    measurement from zero in any run, in standard deviations; it is zero if no rule has weights that
    cancel. `place` (runs,) is a further share, that of rounding the means to float64; the float 0.0
    if it is too small to count. The result is None if the error is at most 10⁻⁹ in all runs.
    """
    times = largest(families(plan))
    if not times and digits is None and isinstance(place, float):
        return None
    (_, known), (mean, cov) = before.by_run, after.by_run
    was, left = np.maximum(variances(known), 0.0), np.maximum(variances(cov), 0.0)
    stays = ratio(was, left) if plan.transition else ratio(left, was)
    past = 0.0 if digits is None else 10.0 ** (-2.0 * digits.reshape(-1))
    added = times * _farthest(plan, mean, cov) if times else 0.0
    total: Array = np.sqrt(past * stays + added**2 + place**2)
    return total if (total > NOTHING).any() else None


def families(plan: ChainPlan) -> list[Family]:
    """The families of the prior, the transition, and the sensors that have measurements."""
    links = [link.family for link in (*plan.prior, *plan.transition)]
    return links + [sensor.family for sensor in plan.read]


def largest(every: Iterable[Family]) -> float:
    """The largest ε c of the families: the relative rounding error of a linearised value.

    It is 0 if no family has a rule with weights that cancel.
    """
    return _EPS * max(map(cancellation, every), default=0.0)


def _farthest(plan: ChainPlan, mean: Array, cov: Array) -> float:
    """The largest distance of a mean or a measurement from zero, in standard deviations.

    `mean` (..., n) and `cov` (..., n, n) are those of the slices. The measurements are those of
    sensors whose rules have weights that cancel, in standard deviations of their noise. Components
    without variance do not count.
    """
    farthest = _most(mean, np.maximum(variances(cov), 0.0))
    for sensor in plan.read:
        if cancellation(sensor.family):
            values = np.where(np.isnan(sensor.values), 0.0, sensor.values)
            farthest = max(farthest, _most(values, variances(sensor.family.own_noise)))
    return farthest


def _most(values: Array, variance: Array) -> float:
    """The largest |value| / √variance over the components whose variance is not zero."""
    open_ = variance > 0.0
    far = np.where(open_, np.abs(values) / np.sqrt(np.where(open_, variance, 1.0)), 0.0)
    return float(far.max(initial=0.0))


def _predictions(plan: ChainPlan, ahead: Forward) -> Array:
    """Σ (e/σ)² over the components of each step's prediction, (T+1, runs).

    A σ of zero is replaced by the component's largest predicted σ so far, and a σ below 10⁻⁹ of
    that largest one by 10⁻⁹ of it.
    """
    front, states = plan.layout.state_size, plan.layout.state_places
    added = np.zeros(ahead.predicted_mean.shape[:2])
    spread = np.maximum(variances(ahead.predicted_cov), 0.0)
    before = np.maximum.accumulate(spread, axis=0)
    # What is certain has no standard deviation to count in but one that it had before.
    unit = np.sqrt(np.where(spread > 0.0, np.maximum(spread, _SUNK**2 * before), before))
    pairs = np.concatenate([ahead.mean[:-1][..., states], ahead.predicted_mean[1:]], axis=-1)
    each = [(link, ahead.predicted_mean[:1][..., states], 0) for link in plan.prior]
    each += [(link, pairs, 1) for link in plan.transition] if plan.steps else []
    for link, mean, first in each:
        times = cancellation(link.family)
        if not times:
            continue
        place = slice(link.child.start - front, link.child.stop - front) if first else link.child
        own = unit[1:][..., place] if first else unit[:1][..., states][..., place]
        moved = _rounding(link.family, times, mean[..., link.parents])
        share = np.where(own > 0.0, moved / np.where(own > 0.0, own, 1.0), 0.0)
        added[first : first + len(share)] += (share**2).sum(axis=-1)
    return added


def _rounding(family: Family, times: float, mean: Array) -> Array:
    """The rounding e (rows, runs, d) of a linearised value, at means (rows, runs, n) of parents.

    n is the parents' number of components; `times` is c, the rule's `cancellation`.
    """
    matrix = family.matrix
    value = apply(matrix, mean) + family.offset
    found: Array = _EPS * times * np.sqrt(value**2 + ((matrix * mean[..., None, :]) ** 2).sum(-1))
    return found


def _of_reading(moved: Array, family: Family, cov: Array, noise: Array) -> Array:
    """The squared shares of measurements, e²/R · HPHᵀ/(HPHᵀ + R), (rows, runs, d).

    `moved` is e (rows, runs, d), `cov` P (rows, runs, n, n) of the parents, of n components, before
    the measurement, and `noise` the variances R (rows, runs, d). Where R is zero HPHᵀ takes its
    place, as the belief after the measurement has no standard deviation there to divide by.
    """
    known = np.maximum(variances(sandwich(family.matrix, cov)), 0.0)
    floor = np.where(noise > 0.0, noise, known)
    share = moved**2 * known / (floor * (known + floor))
    found: Array = np.where(known > 0.0, share, 0.0)
    return found


def carried(ahead: Forward, added: Array, old: Array | float = 1.0) -> Array:
    """The largest √ν_t of all steps, (runs,), from each step's Σ share², `added` (T+1, runs).

    `ahead` has the variances P. `old` (T, runs) is an upper bound of max P_{t−1}/P_t⁻, the part of
    a predicted variance that is not new; 1 if no better bound is known.
    """
    before, left = variances(ahead.predicted_cov), variances(ahead.cov)
    stays = np.minimum(ratio(left[:-1], before[1:]), old) * ratio(left[1:], before[1:])
    total = added[0]
    most = total
    for row, more in zip(stays, added[1:], strict=True):
        total = row * total + more
        most = np.maximum(most, total)
    found: Array = np.sqrt(most)
    return found


def ratio(part: Array, whole: Array, most: float = 1.0) -> Array:
    """The largest `part` / `whole` of variances (..., n), as (...), and never above `most`.

    The quotient is 0 where `whole` is 0, and 1 where `part` is infinite.
    """
    found = np.where(whole > 0.0, part / np.where(whole > 0.0, whole, 1.0), 0.0)
    found = np.where(np.isfinite(part), found, 1.0)  # of what a flat prior leaves unknown
    stays: Array = np.asarray(np.minimum(found.max(axis=-1, initial=0.0), most))
    return stays
