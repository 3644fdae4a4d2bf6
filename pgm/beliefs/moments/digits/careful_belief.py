"""Beliefs in twice the digits, functions m + D δ of an unknown δ, with bounds of their rounding.

δ (q components) is what a flat prior leaves open (`careful`); given δ a belief has the mean m + D δ
and the covariance P. Two matrices (runs, n, n) go along with it. `rounding`, B, bounds the rounding
error E of P: −B ≤ E ≤ B in the order of semidefinite matrices; after F P Fᵀ it is F B Fᵀ. `drift`
is the covariance of the rounding error of m, as if that were random. "Twice the digits" are pairs
of float64, `Twofold`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.vector import Measured
from pgm.kernels import extended, semidefinite, step
from pgm.kernels.arrays import (
    Array,
    Kind,
    Mask,
    components_last,
    independent,
    may_hold,
    quiet,
    sandwich,
    variances,
)
from pgm.kernels.extended import Twofold
from pgm.kernels.roots import NEGLIGIBLE

# The share of the summands of a variance that its rounding, in twice the digits, may be.
ROUNDING = 1e-31
# A component's standard deviations below this share of its largest one are not told apart.
_TOLD = 1e-9
# The shares of a mean and of a variance in float64 that may be rounding.
_EPS = float(np.finfo(np.float64).eps)
_LAST_DIGIT = 4.0 * _EPS
# The standard deviations that earlier steps, in float64, may have moved a mean by.
_STEPS = 1e-8
# An entry of D below this share of its summands is rounding.
_CANCELLED = 1e-26
# Of a variance that is taken for rounding, the share that counts as one of the mean's error.
_SUNK = 1e-6
# How many times a variance has to exceed the bound of its rounding, not to be taken for zero.
CLEAR = 100.0


class Belief(NamedTuple):
    """Moments as functions of δ: `columns` [m D] (runs, n, 1 + q), `cov` P (runs, n, n).

    `rounding` and `drift` (runs, n, n) bound the rounding errors of P and of m, as the module says.
    `largest` (runs, n) are each component's largest predicted variance so far.
    """

    columns: Twofold
    cov: Twofold
    rounding: Array
    drift: Array
    largest: Array

    @classmethod
    def first(cls, columns: Twofold, cov: Twofold, rounding: float, drift: float) -> Belief:
        """A belief whose variances may be off by a share `rounding`, and means by a share `drift`.

        The bounds that the belief keeps under these names are diagonal matrices: `rounding` times
        each variance, and (`drift` · mean)² of each mean. Its `largest` variances are its own.
        """
        variance = variances(cov.hi)
        moved = diagonal((drift * columns.hi[..., 0]) ** 2)
        return cls(columns, cov, diagonal(rounding * np.abs(variance)), moved, variance)

    @classmethod
    def of(cls, mean: Array, cov: Array) -> Belief:
        """A belief in twice the digits, from moments (runs, n) and (runs, n, n) in float64.

        The bounds assume the relative rounding ε = 2.2·10⁻¹⁶ of float64. A variance may be off by
        4 ε of itself. A mean may be off by ε of itself, and besides by 10⁻⁸ standard deviations,
        which allows for the rounding of earlier steps. The result does not depend on δ (q = 0).
        """
        found = cls.first(Twofold(mean[..., None]), Twofold(cov), _LAST_DIGIT, _EPS)
        return found._replace(drift=found.drift + diagonal(_STEPS**2 * np.abs(variances(cov))))

    @property
    def parts(self) -> Array:
        """The shares of the variances that may be rounding, (runs, n); 0 of a variance of zero."""
        variance = variances(self.cov.hi)
        found: Array = variances(self.rounding) / np.where(variance > 0.0, variance, np.inf)
        return found

    def error(self, parts: Array | None = None) -> Array:
        """The largest rounding error of a component's mean, in standard deviations, (runs,).

        A mean's error is the square root of its variance in `drift`, or, if larger, `parts` times
        its standard deviation. `parts` (runs, n) are the shares of the variances that may be
        rounding, None for the belief's `parts`. The error is divided by the component's standard
        deviation, or, if larger, by 10⁻⁹ of the largest one that the component had so far.
        """
        variance = np.maximum(variances(self.cov.hi), 0.0)
        unit = np.sqrt(np.maximum(variance, _TOLD**2 * self.largest))
        changed = (self.parts if parts is None else parts) * np.sqrt(variance)
        changed = np.maximum(changed, np.sqrt(np.maximum(variances(self.drift), 0.0)))
        share = np.where(unit > 0.0, changed / np.where(unit > 0.0, unit, 1.0), 0.0)
        found: Array = share.max(axis=-1, initial=0.0)
        return found

    def shifted(self, mean: Array) -> Belief:
        """The belief with its mean moved by `mean`, (runs, n)."""
        columns = self.columns.copy()
        columns[..., 0] = columns[..., 0] + mean
        return self._replace(columns=columns)

    def certain(self) -> Belief:
        """The belief with zero variances and covariances where a variance may be rounding alone.

        A variance counts as rounding alone up to 100 times the bound of its rounding. A millionth
        of this threshold is added to the error variance of the component's mean, in `drift`, unless
        the variance was zero already.
        """
        floor = CLEAR * variances(self.rounding)
        open_ = np.abs(variances(self.cov.hi)) > floor
        if not may_hold(~open_):
            return self
        both = open_[..., None] & open_[..., None, :]
        sunk = np.where(open_ | (variances(self.cov.hi) == 0.0), 0.0, _SUNK * floor)
        return self._replace(
            cov=extended.where(both, self.cov, 0.0),
            rounding=np.where(both, self.rounding, 0.0),
            drift=self.drift + diagonal(sunk),
        )


def over(value: Any, before: tuple[int, ...], after: tuple[int, ...]) -> Any:
    """Repeat arrays of some runs for more runs, by the rules of broadcasting.

    The shapes `before` and `after` lay the runs out along several axes: their products are the
    numbers of runs. The arrays themselves are (runs, ...), with one axis of runs, before and after.
    `value` is an array, a `Twofold`, None, or a named tuple of these, which may be nested.
    """
    if isinstance(value, np.ndarray):
        own = value.shape[1:]
        wide = np.broadcast_to(value.reshape(*before, *own), (*after, *own))
        return wide.reshape(math.prod(after), *own)
    if isinstance(value, Twofold):
        return Twofold(over(value.hi, before, after), over(value.lo, before, after))
    return None if value is None else type(value)(*(over(part, before, after) for part in value))


def cancelled(columns: Twofold, *summed: Twofold | Array) -> Twofold:
    """The columns [m D] (..., n, 1 + q), with zeros where entries of D are only rounding.

    The entries of `columns` were found as sums; one of D counts as rounding if it is below 10⁻²⁶ of
    the sum of its summands' absolute values. Each array of `summed`, (..., n, 1 + q), has one
    summand of every entry, or the sum of the absolute values of several.
    """
    if columns.shape[-1] == 1:
        return columns
    size = sum(np.abs(part.hi if isinstance(part, Twofold) else part) for part in summed)
    nothing = np.abs(columns.hi) <= _CANCELLED * size
    nothing[..., 0] = False
    return extended.where(nothing, 0.0, columns)


def diagonal(values: Array) -> Array:
    """Diagonal matrices (..., n, n) of values (..., n)."""
    found: Array = values[..., None] * np.eye(values.shape[-1])
    return found


def rounded(matrix: Array, cov: Array, noise: Array | None = None) -> Array:
    """A diagonal bound of the error that rounding makes in F P Fᵀ or F P Fᵀ + noise, (..., d, d).

    F is `matrix` (..., d, n), P is `cov` (..., n, n), `noise` is (..., d, d); None for no noise.
    The product whose error is bounded is in twice the digits.
    """
    summed = _summed(matrix, cov)
    return diagonal(ROUNDING * (summed if noise is None else summed + np.abs(variances(noise))))


def through(matrix: Array, bound: Array) -> Array:
    """The bound F B Fᵀ of the error of F P Fᵀ (or F m), from a bound B of the error of P (or m).

    F is `matrix` (..., d, n), B is `bound` (..., n, n). The rounding of F B Fᵀ itself, in float64,
    is added on the diagonal, so that it does not vanish by cancelling.
    """
    return sandwich(matrix, bound) + diagonal(_LAST_DIGIT * _summed(matrix, bound))


def _summed(matrix: Array, cov: Array) -> Array:
    """Σ_jk |F_ij| |P_jk| |F_ik|, (..., d): how large the summands of each variance of F P Fᵀ are.

    F is `matrix` (..., d, n), P is `cov` (..., n, n).
    """
    size = np.abs(matrix)
    found: Array = ((size @ np.abs(cov)) * size).sum(axis=-1)
    return found


class Move(NamedTuple):
    """An affine conditional A x + b + C δ + e of a slice given the slice before, x.

    `matrix` A is (..., n, n), `offset` b (..., n), `cov` the covariance of the noise e (..., n, n).
    `columns` C is (..., n, q), with q = 0 but for a flat prior.
    """

    matrix: Twofold
    offset: Twofold
    cov: Twofold
    columns: Twofold

    def at(self, row: int) -> Move:
        """The conditional at one place of the first axis, that of steps, without the axis."""
        return Move(*(part[row] for part in self))


@quiet()
def predicted(belief: Belief, move: Move) -> Belief:
    """The belief over the next slice before its measurements: A (m + D δ) + b and A P Aᵀ + Q.

    A, b and Q are the matrix, offset and noise covariance of `move`. Its C is not used, since only
    a prior adds to δ. The belief's bounds of rounding are found too; a variance that may be
    rounding alone becomes zero.
    """
    matrix = move.matrix
    summed = np.abs(matrix.hi) @ np.abs(belief.columns.hi)
    columns = cancelled(matrix @ belief.columns, summed)
    columns[..., 0] = columns[..., 0] + move.offset
    cov = step.predict(belief.cov, matrix, move.cov)
    rounding = through(matrix.hi, belief.rounding) + rounded(matrix.hi, belief.cov.hi, move.cov.hi)
    moved = ROUNDING * (summed[..., 0] + np.abs(move.offset.hi))
    drift = through(matrix.hi, belief.drift) + diagonal(moved**2)
    found = Belief(columns, cov, rounding, drift, belief.largest).certain()
    return found._replace(largest=np.maximum(belief.largest, variances(found.cov.hi)))


class Solved(NamedTuple):
    """The estimate of δ from measurements: `weights` [1 δ] (runs, 1 + q, 1), and its covariance.

    `cov` is (runs, q, q). Along directions of which nothing is known the estimate and `cov` are
    zero. `open` (runs, q, q) has these directions as columns, and its other columns are zero.
    `log_weight` (runs,) is added to the measurements' log-density at δ = 0 to integrate δ out.
    """

    weights: Twofold
    cov: Twofold
    open: Array
    log_weight: Array

    def between(self, first: Belief, second: Belief) -> Twofold:
        """D₁ Cov(δ) D₂ᵀ: what δ adds to the cross-covariance of two slices, (runs, n, n)."""
        return first.columns[..., 1:] @ self.cov @ second.columns[..., 1:].T


def solved(whole: Twofold) -> Solved:
    """The estimate of δ from W = Σ [v V]ᵀ[v V] / S, (runs, 1 + q, 1 + q).

    The sum is over the scalar measurements, of innovation v + V δ and innovation variance S. W has
    the blocks M = Σ VᵀV / S and y = Σ Vᵀv / S. The estimate is δ = −M⁻¹y, of covariance M⁻¹, and
    the log-weight is ½ (yᵀM⁻¹y − ln |M|). Where M is singular, M⁻¹ is a generalised inverse, and
    |M| the product of the eigenvalues that are not zero. This is the limit of priors N(0, κ I) of δ
    as κ grows, apart from terms in ln κ.
    """
    runs, size = whole.shape[0], whole.shape[-1] - 1
    weights = Twofold(np.zeros((runs, size + 1, 1)))
    weights.hi[:, 0] = 1.0
    if not size:
        nothing = np.zeros((runs, 0, 0))
        return Solved(weights, Twofold(nothing), nothing, np.zeros(runs))
    unit, pivots = extended.eliminated(whole[:, 1:, 1:], CLEAR * ROUNDING)
    known = pivots.hi > 0.0
    cov = extended.inverse(unit, pivots)
    mean = -(cov @ whole[:, 1:, :1])
    weights[:, 1:] = mean
    level = -(whole[:, :1, 1:] @ mean).hi[:, 0, 0]
    log_det = np.log(np.where(known, pivots.hi, 1.0)).sum(axis=-1)
    lost = ~known.all(axis=-1)
    if lost.any():  # elsewhere that is the determinant of U, of which rounding is all that differs
        there = known[lost, None]
        spanned = np.where(there, unit.hi[lost], 0.0)
        log_det[lost] += np.linalg.slogdet(spanned.mT @ spanned + np.eye(size) * ~there)[1]
    open_ = np.where(known[:, None, :], 0.0, extended.inverse_unit(unit).T.hi)
    return Solved(weights, cov, open_, 0.5 * (level - log_det))


def moments(belief: Belief, unknown: Solved) -> tuple[Array, Array]:
    """Mean (runs, n) and covariance (runs, n, n) of a belief in float64, at the estimate of δ.

    `unknown` is that estimate. Components that depend on a direction of δ of which nothing is known
    have an infinite variance.
    """
    mean, spread = rounded_belief(belief, unknown)
    return mean, spread.shown


def rounded_belief(belief: Belief, unknown: Solved) -> tuple[Array, Diffuse]:
    """The mean m + D δ (runs, n) and the covariance P + D Cov(δ) Dᵀ in float64, at an estimated δ.

    `unknown` is the estimate of δ. The covariance is a `Diffuse`: it has, apart from the finite
    P + D Cov(δ) Dᵀ, the directions in which the variance is infinite, as the columns of D O; the
    columns of O are the directions of δ of which nothing is known.
    """
    mean, cov = (belief.columns @ unknown.weights).hi[..., 0], belief.cov
    if unknown.open.shape[-1]:
        cov = cov + unknown.between(belief, belief)
    slope = belief.columns.hi[..., 1:]
    found, size = slope @ unknown.open, np.abs(slope) @ np.abs(unknown.open)
    open_ = np.where(np.abs(found) > NEGLIGIBLE * size, found, 0.0)
    return mean, Diffuse(semidefinite.semidefinite(cov.hi, 1.0 / CLEAR), open_, size)


class Component(NamedTuple):
    """A scalar measurement z = h x + e that was taken in, with gain G and predictive variance S.

    `row` is h (runs, n), `keep` 1 − G h (runs, n, n), `innovation` [v V] (runs, 1 + q) the columns
    of the innovation v + V δ, and `weight` 1/S (runs,); G and 1/S are zero in runs in which the
    measurement was not used. `error` (runs,) is the share of S that may be rounding. By rounding G
    may be off by `blur`, and the updated mean by `drift`, both (runs, n).
    """

    row: Twofold
    keep: Twofold
    innovation: Twofold
    weight: Twofold
    error: Array
    blur: Array
    drift: Array


class _Reciprocal(NamedTuple):
    """The root of variances S = 1 S 1, of which `weight` is 1/S (runs,), or zero."""

    weight: Twofold

    def solve(self, right: Twofold) -> Twofold:
        """The X with 1 X = B."""
        return right

    def solve_transposed(self, right: Twofold) -> Twofold:
        """The X with S X = B; zero where S does not count."""
        return right * self.weight[:, None, None]


def take(
    belief: Belief, row: Twofold, value: Twofold, noise: Twofold, seen: Mask
) -> tuple[Belief, Component, Array, Mask]:
    """Condition a belief on one scalar measurement z = h x + e, e ~ N(0, r), of each run.

    `row` is h (runs, n), `value` z and `noise` r (runs,); `seen` (runs,) marks the runs that have
    the measurement. The predictive variance is S = h P hᵀ + r. An h P hᵀ that may be rounding alone
    counts as zero; where S is then zero, the belief stays as it is. Returns four values: first the
    updated belief, second the measurement as a `Component`, third S (runs,). The fourth is the mask
    (runs,) of the runs in which S is improper: in which h P hᵀ or S is negative beyond rounding or
    not finite, or S ≤ 0 because r is negative, as the error of a lineariser may make it.
    """
    columns, cov, rounding, drift, _ = belief
    cross = (cov @ row[..., None])[..., 0]
    spread = row.dot(cross)
    line, mean = row.hi[:, None, :], np.abs(columns.hi[..., 0])
    variance = np.maximum(variances(cov.hi), 0.0)
    blurred = np.maximum(sandwich(line, rounding)[:, 0, 0], 0.0)
    floor = blurred + rounded(line, cov.hi)[:, 0, 0]
    negative = np.minimum(spread.hi, spread.hi + noise.hi) < -CLEAR * floor
    improper = negative | ~np.isfinite(floor)
    # h P hᵀ may be rounding alone; the noise variance is exact.
    open_ = spread.hi > CLEAR * floor
    # Even so P hᵀ may hold more than rounding of a component: that is lost with it.
    said = np.sqrt(np.maximum(variances(rounding) * blurred[:, None], 0.0))
    said = said + ROUNDING * (np.abs(cov.hi) @ np.abs(row.hi)[..., None])[..., 0]
    said = (np.abs(cross.hi) > CLEAR * said) & ~open_[:, None]
    cross = extended.where(open_[:, None], cross, 0.0)
    predictive = extended.where(open_, spread, 0.0) + noise
    # A lineariser's error may be negative, and larger than h P hᵀ and the CPD's own noise.
    improper = improper | (seen & (noise.hi < 0.0) & (predictive.hi <= 0.0))
    read = seen & (predictive.hi > 0.0)
    weight = extended.where(read, 1.0 / extended.where(read, predictive, 1.0), 0.0)
    summed = floor - blurred + ROUNDING * np.abs(noise.hi)
    innovation = -(row[:, None, :] @ columns)[:, 0]
    innovation[:, 0] = innovation[:, 0] + value
    missed = np.abs(innovation.hi[:, :1])
    gain = step.gain(_Reciprocal(weight), cross[:, None, :])[..., 0]
    keep = (gain[..., None] @ row[:, None, :]).one_minus()
    # A change E of P changes G by (1 − G h) E hᵀ/S.
    kept = through(keep.hi, rounding)
    blur = np.sqrt(np.maximum(variances(kept) * blurred[:, None], 0.0))
    blur = (blur + np.abs(gain.hi) * summed[:, None]) * weight.hi[:, None]
    added = (np.abs(row.hi) * mean).sum(axis=-1) + np.abs(value.hi)
    moved = blur * missed + ROUNDING * (mean + np.abs(gain.hi) * added[:, None])
    unheard = np.where(read & ~open_, CLEAR * floor * weight.hi**2, 0.0)[:, None]
    moved = moved + np.sqrt(unheard * variance) * missed
    moved = moved + np.where(said & (seen & ~read)[:, None], np.sqrt(variance), 0.0)
    # A noise that S does not tell from rounding leaves no digit of what float64 tells at all.
    untold = read & (noise.hi > 0.0) & (noise.hi < CLEAR * summed)
    if may_hold(untold):
        moved = moved + _TOLD * np.sqrt(variance) * (gain.hi != 0.0) * untold[:, None]
    terms = np.abs(gain.hi)[..., None] * (np.abs(line) @ np.abs(columns.hi))
    columns = cancelled(columns + gain[..., None] * innovation[:, None, :], columns, terms)
    # What rounding has left of a zero in 1 − G h is squared.
    again = np.eye(cov.shape[-1]) + np.abs(gain.hi[..., None] * line)
    own = diagonal(gain.hi**2 * np.abs(noise.hi[:, None]))
    rounding = kept + rounded(keep.hi, cov.hi, own) + ROUNDING * rounded(again, cov.hi)
    drift = through(keep.hi, drift) + diagonal(moved**2)
    cov = step.squares_by(keep, cov, gain[..., None], noise[:, None, None])
    after = Belief(columns, cov, rounding, drift, belief.largest).certain()
    component = Component(row, keep, innovation, weight, floor * weight.hi, blur, moved)
    return after, component, predictive.hi, improper


def informed(information: Twofold, component: Component) -> Twofold:
    """The sum Σ [v V]ᵀ[v V] / S, (runs, 1 + q, 1 + q), with one scalar measurement more."""
    row = component.innovation[:, None, :]
    return information + row.T @ (row * component.weight[:, None, None])


def decorrelated(parts: Sequence[Measured], runs: int, width: int) -> tuple[Twofold, Twofold, Mask]:
    """The measurements of a step as k scalars z = h x + e with independent errors e.

    `parts` has the linearised measurements of each sensor, and `width` is the slice's n. Returns
    first the rows [h z] (runs, k, n + 1), second the errors' variances (runs, k), third the mask
    (runs, k) of the scalars that were measured; rows of the rest are zero. From z the CPD's offset
    has been subtracted. A noise covariance with correlations is R = U diag(r) Uᵀ, with U unit lower
    triangular; the rows have then been multiplied by U⁻¹, and the variances are r.
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
            rows[:, place] = extended.where(there[..., None], rows[:, place], 0.0)
            noise[:, place, place] = independent(noise[:, place, place], there)
    return *uncorrelated(rows, noise), taken


def uncorrelated(rows: Twofold, noise: Array) -> tuple[Twofold, Twofold]:
    """Measurements [h z] (..., k, n + 1) by their noise covariances (..., k, k), decorrelated.

    Returns the rows and the variances (..., k) of independent errors; see `decorrelated`.
    """
    own = variances(noise)
    if np.count_nonzero(noise) == np.count_nonzero(own):
        return rows, Twofold(own.copy())
    unit, noises = extended.eliminated(noise, NEGLIGIBLE)
    return extended.solve_unit(unit, rows), noises


def _by_run(array: npt.NDArray[Kind], own: int) -> npt.NDArray[Kind]:
    """An array (..., runs), or (...) without an axis of runs, as (runs, ...) or (1, ...).

    `own` is the number of its axes other than that of runs.
    """
    return array[None] if array.ndim == own else components_last(array, own)
