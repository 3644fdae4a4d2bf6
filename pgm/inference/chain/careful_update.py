"""Readings taken into a belief in twice the digits, one component after another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.inference.chain import refusals
from pgm.inference.chain.iteration import Anchor
from pgm.inference.chain.vector import Measured
from pgm.kernels import twofold
from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Kind,
    Mask,
    components_last,
    independent,
    quiet,
    sandwich,
)
from pgm.kernels.roots import NEGLIGIBLE
from pgm.kernels.twofold import Twofold

# The part of what is summed up to a variance that rounding may change.
ROUNDING = 1e-31
# The share of the largest deviation of a component below which deviations are not told apart.
_TOLD = 1e-9
# The parts of a mean and of a variance in float64 that rounding may change.
_EPS = float(np.finfo(np.float64).eps)
_LAST_DIGIT = 4.0 * _EPS
# The part of what is summed up to an entry of D below which it is rounding.
_CANCELLED = 1e-26
# The part of a variance that is taken for rounding which counts as an error of the mean.
_SUNK = 1e-6
# By so much a variance has to exceed what rounding may have made of a zero.
CLEAR = 100.0


class Component(NamedTuple):
    """A component of a reading, taken in.

    Attributes
    ----------
    row, gain : Twofold
        (runs, n): h and G; the gain is zero where nothing was learnt.
    innovation : Twofold
        (runs, 1 + q): v and V.
    weight : Twofold
        (runs,): 1 / S, zero where nothing was learnt.
    error : ndarray
        (runs,): the part of S that rounding may have changed.
    blur, drift : ndarray
        (runs, n): the change of G that rounding may have made, and of the mean through it.
    """

    row: Twofold
    gain: Twofold
    innovation: Twofold
    weight: Twofold
    error: Array
    blur: Array
    drift: Array


class Belief(NamedTuple):
    """Moments as functions of δ.

    Attributes
    ----------
    columns : Twofold
        (runs, n, 1 + q): [m D].
    cov : Twofold
        (runs, n, n): P.
    rounding : ndarray
        (runs, n, n): a bound, as a covariance, of what rounding has changed P by so far. It goes
        through transitions and readings as an error does.
    drift : ndarray
        (runs, n, n): the covariance, in that sense, of what rounding has changed m by.
    """

    columns: Twofold
    cov: Twofold
    rounding: Array
    drift: Array

    @classmethod
    def of(cls, mean: Array, cov: Array) -> Belief:
        """A belief of moments (runs, n) and (runs, n, n) in float64: exact to rounding."""
        rounding, drift = _LAST_DIGIT * variances(cov), (_EPS * mean) ** 2
        columns, eye = Twofold(mean[..., None]), np.eye(mean.shape[-1])
        return cls(columns, Twofold(cov), rounding[..., None] * eye, drift[..., None] * eye)

    @property
    def parts(self) -> Array:
        """The parts of variances that rounding may have changed, (runs, n)."""
        variance = variances(self.cov.hi)
        found: Array = variances(self.rounding) / np.where(variance > 0.0, variance, np.inf)
        return found

    def error(self, largest: Array, parts: Array | None = None) -> Array:
        """The change of a mean that rounding may have made, (runs,).

        Counted from its deviation, or from 10⁻⁹ of the largest deviation that the component had,
        variance `largest` (runs, n), where that is more: float64 cannot tell less than 10⁻¹⁶ of it.
        The parts of variances that rounding may have changed, (runs, n), count as much.
        """
        variance = np.maximum(variances(self.cov.hi), 0.0)
        unit = np.sqrt(np.maximum(variance, _TOLD**2 * largest))
        changed = (self.parts if parts is None else parts) * np.sqrt(variance)
        changed = np.maximum(changed, np.sqrt(np.maximum(variances(self.drift), 0.0)))
        share = np.where(unit > 0.0, changed / np.where(unit > 0.0, unit, 1.0), 0.0)
        found: Array = share.max(axis=-1, initial=0.0)
        return found

    def shifted(self, mean: Array) -> Belief:
        """The belief with its mean moved, by (runs, n)."""
        columns = self.columns.copy()
        columns[..., 0] = columns[..., 0] + mean
        return self._replace(columns=columns)

    def certain(self) -> Belief:
        """The belief with zeros where a variance may be rounding alone."""
        floor = CLEAR * variances(self.rounding)
        open_ = np.abs(variances(self.cov.hi)) > floor
        if open_.all():
            return self
        both = open_[..., None] & open_[..., None, :]
        sunk = np.where(open_ | (variances(self.cov.hi) == 0.0), 0.0, _SUNK * floor)
        return self._replace(
            cov=twofold.where(both, self.cov, 0.0),
            rounding=np.where(both, self.rounding, 0.0),
            drift=self.drift + sunk[..., None] * np.eye(sunk.shape[-1]),
        )


def cancelled(columns: Twofold, *summed: Twofold | Array) -> Twofold:
    """[m D] with zeros in D where all that is left of what was summed up may be rounding."""
    if columns.shape[-1] == 1:
        return columns
    size = sum(np.abs(part.hi if isinstance(part, Twofold) else part) for part in summed)
    nothing = np.abs(columns.hi) <= _CANCELLED * size
    nothing[..., 0] = False
    return twofold.where(nothing, 0.0, columns)


def rounded(matrix: Array, cov: Array, noise: Array) -> Array:
    """A bound, as a covariance, of the rounding of F P Fᵀ + noise."""
    size = np.abs(matrix)
    summed = ((size @ np.abs(cov)) * size).sum(axis=-1) + np.abs(variances(noise))
    bound: Array = ROUNDING * summed[..., None] * np.eye(matrix.shape[-2])
    return bound


def variances(cov: Array) -> Array:
    """The diagonal of a covariance."""
    found: Array = np.einsum("...ii->...i", cov)
    return found


def through(matrix: Array, bound: Array) -> Array:
    """A bound, as a covariance, of F e from that of e; what cancels is not taken for certain."""
    size = np.abs(matrix)
    summed = ((size @ np.abs(bound)) * size).sum(axis=-1)
    found: Array = sandwich(matrix, bound) + _LAST_DIGIT * summed[..., None] * np.eye(
        size.shape[-2]
    )
    return found


def reach(rounding: Array, vector: Array) -> Array:
    """The change of a product E v that a change of E within a bound, as a covariance, may make."""
    along = sandwich(vector[..., None, :], rounding)
    found: Array = np.sqrt(np.maximum(variances(rounding) * variances(along), 0.0))
    return found


class IteratedUpdate(NamedTuple):
    """A belief given readings.

    Attributes
    ----------
    belief : Belief
    components : list of Component
    log_density : ndarray
        (runs,): of the readings, given δ = 0.
    """

    belief: Belief
    components: list[Component]
    log_density: Array


@quiet()
def update(parts: Sequence[Measured], step: int, belief: Belief, mean: Array) -> IteratedUpdate:
    """Take in the readings of a step; the rounded mean, (n, *batch), tells the numbers' size."""
    runs = len(belief.cov.hi)
    rows, noises, seen = _decorrelated(parts, runs, len(mean))
    components: list[Component] = []
    log_density = np.zeros(runs)
    left = np.zeros(seen.shape)
    for k in range(seen.shape[-1]):
        belief, component, predictive, indefinite = _take(
            belief, rows[:, k, :-1], rows[:, k, -1], noises[:, k], seen[:, k]
        )
        if indefinite:
            refusals.indefinite(parts, step)
        components.append(component)
        innovation, weight = component.innovation[:, 0], component.weight
        read = weight.hi > 0.0
        left[:, k] = np.where(seen[:, k] & ~read, np.abs(innovation.hi), 0.0)
        level = (innovation * innovation * weight).hi + np.log(np.where(read, predictive, 1.0))
        log_density -= np.where(read, 0.5 * (level + LOG_2PI), 0.0)
    if not np.isfinite(log_density).all():
        refusals.indefinite(parts, step)
    if left.any():
        refusals.contradiction(parts, step, mean, left.T if mean.ndim > 1 else left[0])
    return IteratedUpdate(belief, components, log_density)


def hold(anchor: Anchor, taken: IteratedUpdate) -> IteratedUpdate:
    """Take in the reading of an anchor of one step too, which is no evidence."""
    belief, components = taken.belief, list(taken.components)
    size = belief.cov.shape[-1]
    held = (anchor.std[0] > 0.0) & (anchor.weight > 0.0)[:, None]
    variance = anchor.std[0] ** 2 / np.where(anchor.weight > 0.0, anchor.weight, 1.0)[:, None]
    for k in range(size):
        row = Twofold(np.broadcast_to(np.eye(size)[k], belief.columns.shape[:2]).copy())
        value, noise = Twofold(anchor.mean[0][:, k]), Twofold(variance[:, k])
        belief, component, *_ = _take(belief, row, value, noise, held[:, k])
        components.append(component)
    return IteratedUpdate(belief, components, taken.log_density)


def _take(
    belief: Belief, row: Twofold, value: Twofold, noise: Twofold, seen: Mask
) -> tuple[Belief, Component, Array, bool]:
    """Take in a component; also its predictive variance, and whether that is indefinite."""
    columns, cov, rounding, drift = belief
    size = cov.shape[-1]
    cross = (cov @ row[..., None])[..., 0]
    spread = row.dot(cross)
    line, mean = row.hi[:, None, :], np.abs(columns.hi[..., 0])
    blurred = np.maximum(sandwich(line, rounding)[:, 0, 0], 0.0)
    nothing = np.zeros_like(noise.hi)[:, None, None]
    floor = blurred + rounded(line, cov.hi, nothing)[:, 0, 0]
    negative = (np.minimum(spread.hi, spread.hi + noise.hi) < -CLEAR * floor).any()
    indefinite = bool(negative) or not np.isfinite(floor).all()
    # What the belief leaves open may be rounding alone; the noise is none.
    open_ = spread.hi > CLEAR * floor
    cross = twofold.where(open_[:, None], cross, 0.0)
    predictive = twofold.where(open_, spread, 0.0) + noise
    # A lineariser's error may be negative, and take more than there is.
    indefinite |= bool((seen & (noise.hi < 0.0) & (predictive.hi <= 0.0)).any())
    read = seen & (predictive.hi > 0.0)
    weight = twofold.where(read, 1.0 / twofold.where(read, predictive, 1.0), 0.0)
    summed = floor - blurred + ROUNDING * np.abs(noise.hi)
    innovation = -(row[:, None, :] @ columns)[:, 0]
    innovation[:, 0] = innovation[:, 0] + value
    gain = cross * weight[:, None]
    keep = np.eye(size) - gain[..., None] * row[:, None, :]
    own = (gain * noise[:, None])[..., None] * gain[:, None, :]
    # A change E of P changes G by (1 − G h) E hᵀ/S.
    kept = through(keep.hi, rounding)
    blur = np.sqrt(np.maximum(variances(kept) * blurred[:, None], 0.0))
    blur = (blur + np.abs(gain.hi) * summed[:, None]) * weight.hi[:, None]
    added = (np.abs(row.hi) * mean).sum(axis=-1) + np.abs(value.hi)
    moved = blur * np.abs(innovation.hi[:, :1])
    moved = moved + ROUNDING * (mean + np.abs(gain.hi) * added[:, None])
    unheard = np.where(read & ~open_, CLEAR * floor * weight.hi**2, 0.0)[:, None]
    unheard = np.sqrt(unheard * np.maximum(variances(cov.hi), 0.0))
    moved = moved + unheard * np.abs(innovation.hi[:, :1])
    # A noise that S does not tell from rounding leaves no digit of what float64 tells at all.
    untold = read & (noise.hi > 0.0) & (noise.hi < CLEAR * summed)
    if untold.any():
        before = np.sqrt(np.maximum(variances(cov.hi), 0.0)) * (gain.hi != 0.0)
        moved = moved + _TOLD * before * untold[:, None]
    terms = np.abs(gain.hi)[..., None] * (np.abs(line) @ np.abs(columns.hi))
    columns = cancelled(columns + gain[..., None] * innovation[:, None, :], columns, terms)
    # What rounding has left of a zero in 1 − G h is squared.
    again = np.eye(size) + np.abs(gain.hi[..., None] * line)
    again = ROUNDING * rounded(again, cov.hi, np.zeros_like(cov.hi))
    rounding = kept + rounded(keep.hi, cov.hi, own.hi) + again
    drift = through(keep.hi, drift) + moved[..., None] ** 2 * np.eye(size)
    after = Belief(columns, keep @ cov @ keep.mT + own, rounding, drift).certain()
    component = Component(row, gain, innovation, weight, floor * weight.hi, blur, moved)
    return after, component, predictive.hi, indefinite


def _decorrelated(
    parts: Sequence[Measured], runs: int, width: int
) -> tuple[Twofold, Twofold, Mask]:
    """The components of readings, each with an error of its own.

    Returns
    -------
    rows : Twofold
        (runs, D, n + 1): h, and the reading less the CPD's offset.
    noises : Twofold
        (runs, D): variances.
    taken : ndarray of bool
        (runs, D).
    """
    height = sum(len(seen.value) for seen in parts)
    rows = Twofold.zeros((runs, height, width + 1))
    noise = np.zeros((runs, height, height))
    taken = np.ones((runs, height), dtype=bool)
    top = 0
    for seen in parts:
        place = slice(top, top := top + len(seen.value))
        rows.hi[:, place, :-1][..., seen.sensor.parents] = _by_run(seen.matrix, 2)
        rows[:, place, -1] = Twofold(_by_run(seen.reading, 1)) - _by_run(seen.constant, 1)
        noise[:, place, place] = _by_run(seen.noise, 2)
        if seen.taken is not None:
            there = _by_run(seen.taken, 1)
            taken[:, place] = there
            rows[:, place] = twofold.where(there[..., None], rows[:, place], 0.0)
            noise[:, place, place] = independent(noise[:, place, place], there)
    own = variances(noise)
    if np.count_nonzero(noise) == np.count_nonzero(own):
        return rows, Twofold(own.copy()), taken
    unit, noises = twofold.eliminated(noise, NEGLIGIBLE)
    return twofold.solve_unit(unit, rows), noises, taken


def _by_run(array: npt.NDArray[Kind], own: int) -> npt.NDArray[Kind]:
    """An array (own axes, *batch) with an axis of runs first."""
    return array[None] if array.ndim == own else components_last(array, own)
