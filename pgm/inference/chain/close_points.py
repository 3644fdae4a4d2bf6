"""The digits of means that sigma points close together leave, in coordinates far from zero.

The value of a linearisation is Σ w f(x) over a rule's points. Where weights are large and of both
signs, as the 1/α² of ``Unscented(alpha)``, it is a difference, and the last digits of each f(x) and
x, far from zero, grow by as much. With F the slope at a mean μ and y the value there, rounding is

    e = ε √(Σ w² + ...) √(y² + Σ_j (F_j μ_j)²),

for independent errors of all values and points (`Points.cancellation`). It shifts a prediction by
e/σ of its deviations, and by a measurement of noise R, of which HPHᵀ is known before, a belief by
at most e/√R √(HPHᵀ/(HPHᵀ + R)) of what it has left. Shares add up as squares do, and are forgotten
as a filter forgets: ν_t = ρ_t ν_{t−1} + Σ share², with ρ the largest share of a variance that is
not new, P_{t−1}/P_t⁻, times what a measurement leaves of it, P_t/P_t⁻. All smoothed beliefs are
sums of filtered ones and later measurements, and no worse in their own deviations.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pgm.inference.chain.forward import Filtered, Forward
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import Moments
from pgm.inference.family import Family, cancellation
from pgm.kernels.arrays import Array, apply, block, sandwich, variances
from pgm.kernels.prefixes import gather

_EPS = float(np.finfo(np.float64).eps)
# A part of a deviation, added up, of which nothing need be told.
NOTHING = 1e-9
# Where a deviation is a smaller part of one before, float64 tells nothing of it anyway.
_SUNK = 1e-9


def error(plan: ChainPlan, swept: Forward | Filtered) -> Array | None:
    """The part of a deviation by which means are off, (runs,); None where that is next to nothing.

    Parameters
    ----------
    plan : ChainPlan
        As it was linearised for the pass.
    swept : Forward or Filtered
        The forward pass, of which another one is made where not all of it is known.
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
        return _kept(ahead, added)


def of_step(plan: ChainPlan, before: Moments, after: Moments, digits: Array | None) -> Array | None:
    """The `error` after a step of an online filter, (runs,), from the digits that it had before.

    Slopes are not at hand: no component is taken to move a value by more than its deviations.
    """
    times = largest(families(plan))
    if not times:
        return None
    (_, known), (mean, cov) = before.by_run, after.by_run
    was, left = np.maximum(variances(known), 0.0), np.maximum(variances(cov), 0.0)
    stays = _ratio(np.minimum(left, was), np.maximum(left, was))
    past = 0.0 if digits is None else 10.0 ** (-2.0 * digits.reshape(-1))
    total: Array = np.sqrt(past * stays + (times * _farthest(plan, mean, cov)) ** 2)
    return total if digits is not None or (total > NOTHING).any() else None


def families(plan: ChainPlan) -> list[Family]:
    """The families that a pass linearises."""
    links = [link.family for link in (*plan.prior, *plan.transition)]
    return links + [sensor.family for sensor in plan.read]


def largest(every: Iterable[Family]) -> float:
    """The largest rounding of a linearisation, as a part of the value; 0 of rules that are safe."""
    return _EPS * max(map(cancellation, every), default=0.0)


def _farthest(plan: ChainPlan, mean: Array, cov: Array) -> float:
    """The most deviations that a mean or a reading is from zero, of components that have any."""
    farthest = _most(mean, np.maximum(variances(cov), 0.0))
    for sensor in plan.read:
        if cancellation(sensor.family):
            values = np.where(np.isnan(sensor.values), 0.0, sensor.values)
            farthest = max(farthest, _most(values, variances(sensor.family.own_noise)))
    return farthest


def _most(values: Array, variance: Array) -> float:
    open_ = variance > 0.0
    far = np.where(open_, np.abs(values) / np.sqrt(np.where(open_, variance, 1.0)), 0.0)
    return float(far.max(initial=0.0))


def _predictions(plan: ChainPlan, ahead: Forward) -> Array:
    """The shares² of all predictions, (T+1, runs)."""
    front, states = plan.layout.state_size, plan.layout.state_places
    added = np.zeros(ahead.predicted_mean.shape[:2])
    spread = np.maximum(variances(ahead.predicted_cov), 0.0)
    before = np.maximum.accumulate(spread, axis=0)
    # What is certain has no deviation to count from but one that it had.
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
    """The rounding e of a linearisation's value at means (rows, runs, n) of hidden parents."""
    matrix = family.matrix
    value = apply(matrix, mean) + family.offset
    found: Array = _EPS * times * np.sqrt(value**2 + ((matrix * mean[..., None, :]) ** 2).sum(-1))
    return found


def _of_reading(moved: Array, family: Family, cov: Array, noise: Array) -> Array:
    """The shares² of measurements, from rounding (rows, runs, d) and what was known before.

    One without noise leaves no deviation to count from but that before it.
    """
    known = np.maximum(variances(sandwich(family.matrix, cov)), 0.0)
    floor = np.where(noise > 0.0, noise, known)
    share = moved**2 * known / (floor * (known + floor))
    found: Array = np.where(known > 0.0, share, 0.0)
    return found


def _kept(ahead: Forward, added: Array) -> Array:
    """The largest √ν of all steps, (runs,)."""
    before, left = variances(ahead.predicted_cov), variances(ahead.cov)
    stays = _ratio(left[:-1], before[1:]) * _ratio(left[1:], before[1:])
    total = added[0]
    most = total
    for row, more in zip(stays, added[1:], strict=True):
        total = row * total + more
        most = np.maximum(most, total)
    found: Array = np.sqrt(most)
    return found


def _ratio(part: Array, whole: Array) -> Array:
    """The largest part of a variance, at most one; none of a component without a variance."""
    found = np.where(whole > 0.0, part / np.where(whole > 0.0, whole, 1.0), 0.0)
    stays: Array = np.asarray(np.minimum(found.max(axis=-1, initial=0.0), 1.0))
    return stays
