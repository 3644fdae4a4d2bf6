"""Messages of later measurements in twice the digits, and beliefs given them; see `adjoint`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.digits.careful_belief import (
    CLEAR,
    ROUNDING,
    Belief,
    Component,
    Move,
    diagonal,
    rounded,
    through,
)
from pgm.kernels import extended, step
from pgm.kernels.arrays import Array, Mask, apply, sandwich, variances
from pgm.kernels.extended import Twofold

# Bayes' rule is tried where more than this share of a smoothed variance may be rounding.
_CLOSE = 1e-12


class Later(NamedTuple):
    """The message of later measurements to a belief over a slice: r as a function of δ, and N.

    `vector` has the columns [r R] (runs, n, 1 + q) of r + R δ; `matrix` is N (runs, n, n).
    `rounding` B (runs, n, n) bounds the rounding error E of N, −B ≤ E ≤ B in the order of
    semidefinite matrices; `drift` (runs, n, n) is the covariance of the rounding error of r, as if
    that were random. Of each later measurement's innovation variance S a share may be rounding;
    `blurred` (runs,) is the largest of these shares.
    """

    vector: Twofold
    matrix: Twofold
    rounding: Array
    drift: Array
    blurred: Array

    def before(self, components: list[Component]) -> Later:
        """Carry the message back through the measurements of a step.

        This message is to the belief after those measurements. The result is to the step's
        predicted belief, and includes them. `components` are the measurements as scalars, in the
        order in which the forward pass took them in.
        """
        later = self
        for component in reversed(components):
            later = later.past(component)
        return later

    def past(self, component: Component) -> Later:
        """Carry the message back through one scalar measurement, which it then includes."""
        vector, matrix, rounding, drift, blurred = self
        row, keep, innovation, weight, error, blur, moved = component
        said = innovation * weight[:, None]
        lost = (blur * np.abs(vector.hi[..., 0])).sum(-1) + np.abs(said.hi[:, 0]) * error
        along = row.hi * lost[:, None]
        drift = drift + sandwich(matrix.hi, diagonal(moved**2))
        drift = through(keep.hi.mT, drift) + along[..., None] * along[..., None, :]
        own = (row * weight[:, None])[..., None] * row[:, None, :]
        rounding = through(keep.hi.mT, rounding) + rounded(keep.hi.mT, matrix.hi, own.hi)
        vector = keep.T @ vector + row[..., None] * said[:, None, :]
        matrix = step.predict(matrix, keep.T, own)
        return Later(vector, matrix, rounding, drift, np.maximum(blurred, error))

    def back(self, matrix: Twofold) -> Later:
        """The message Aᵀ r, Aᵀ N A to the slice one step before.

        A = `matrix` (runs or 1, n, n) is the transition from that slice to the present one.
        """
        slope, said = matrix.hi.mT, self.matrix
        rounding = through(slope, self.rounding) + rounded(slope, said.hi)
        drift = through(slope, self.drift)
        said = (matrix.T @ said).times(matrix.T)
        return Later(matrix.T @ self.vector, said, rounding, drift, self.blurred)


class Back(NamedTuple):
    """The gain G of Bayes' rule, by which a smoothed belief follows from the next slice's.

    `gain` is (runs, n, n), with rows of the slice and columns of the next; `lost` (runs, 1, 1)
    marks the runs in which this gain was used, since P − P N P would have left fewer digits.
    """

    gain: Twofold
    lost: Mask


class Smooth(NamedTuple):
    """The smoothed belief over the slice at `step`, given the measurements up to some last step.

    `here` is the message to the predicted belief at `step`, of the measurements from `step` itself
    up to that last step. `back` has the gains of Bayes' rule from the next slice, None if that rule
    was not tried. `parts` (runs, n) are the shares of the belief's variances that may be rounding.
    """

    step: int
    belief: Belief
    here: Later
    back: Back | None
    parts: Array


def given(known: Belief, later: Later) -> tuple[Belief, Array]:
    """The smoothed belief m + P r, P − P N P over a slice, from its filtered belief `known`, m, P.

    `later` is the message r, N of the measurements after the slice's own. Returns the belief, with
    its own bounds of rounding, and the shares of its variances that may be rounding, (runs, n).
    """
    columns, cov, own, drift, largest = known
    left = cov - (cov @ later.matrix).times(cov)
    before = variances(cov.hi)
    changed = through(cov.hi, later.rounding) + rounded(cov.hi, later.matrix.hi, cov.hi)
    rounding = later.blurred[:, None] * before + variances(changed)
    pull = later.vector.hi[..., 0]
    size = np.abs(columns.hi[..., 0]) + apply(np.abs(cov.hi), np.abs(pull))
    # A change E of P within its bound changes P r by E r.
    along = variances(sandwich(pull[..., None, :], own))
    moved = np.sqrt(np.maximum(variances(own) * along, 0.0)) + ROUNDING * size
    drift = through(np.eye(cov.shape[-1]) - cov.hi @ later.matrix.hi, drift)
    drift = drift + through(cov.hi, later.drift) + diagonal(moved**2)
    found = Belief(columns + cov @ later.vector, left, diagonal(rounding), drift, largest)
    after = np.maximum(variances(left.hi), rounding)
    return found.certain(), rounding / np.where(after > 0.0, after, np.inf)


def is_close(parts: Array) -> Mask:
    """The runs (runs,) in which Bayes' rule is tried, by the shares (runs, n) of rounding."""
    found: Mask = np.logical_or.reduce(parts > _CLOSE, axis=-1)
    return found


def closer(
    known: Belief,
    belief: Belief,
    parts: Array,
    move: Move,
    predicted: Belief,
    later: Belief,
    others: Array,
) -> tuple[Belief, Array, Back]:
    """The smoothed belief `belief` by Bayes' rule in its place, in the runs where that is closer.

    `known` is the filtered belief over the slice; `move`, `predicted` and `later` are the
    transition to the next slice, the belief predicted there, and the smoothed one. `parts` and
    `others` (runs, n) are the shares of the variances of `belief` and `later` that may be rounding.
    Returns the belief, its shares and the gain.
    """
    gain, other, error = _reversed(known, move, predicted, later, others)
    lost = is_close(parts) & (error < parts.max(axis=-1))
    back = Back(gain, lost[:, None, None])
    return _either(back.lost, other, belief), np.where(lost[:, None], error[:, None], parts), back


def _reversed(
    known: Belief, move: Move, predicted: Belief, belief: Belief, others: Array
) -> tuple[Twofold, Belief, Array]:
    """The smoothed belief over a slice by Bayes' rule, from that of the slice after it.

    The filtered belief `known` has the moments m, P. The transition `move` to the next slice has
    the matrix A and the noise covariance Q; there `predicted` has the moments m⁻, P⁻, and `belief`
    the smoothed ones m′, P′, of whose variances shares `others` (runs, n) may be rounding. With the
    gain G = P Aᵀ (P⁻)⁺ the smoothed mean is m + G (m′ − m⁻), and the covariance
    (1 − G A) P (1 − G A)ᵀ + G (Q + P′) Gᵀ, which subtracts nothing. Returns first G (runs, n, n),
    then the belief, then the largest share of a variance that may be rounding, (runs,).
    """
    columns, cov, own, drift, largest = known
    matrix, noise = move.matrix, move.cov
    floor = variances(predicted.rounding)
    unit, pivots = extended.eliminated(predicted.cov, CLEAR, floor)
    gain = extended.solve(unit, pivots, matrix @ cov).T
    keep, other = (gain @ matrix).one_minus(), noise + belief.cov
    left = step.squares_by(keep, cov, gain, other)
    # Changes E of P and E′ of Q change G (x − m) by (1 − G A) E Aᵀ y − G E′ y.
    kept = through(keep.hi, own)
    summed = np.maximum(floor - variances(sandwich(matrix.hi, own)), 0.0)
    rounding = kept + through(gain.hi, belief.rounding + diagonal(summed))
    rounding = rounding + rounded(keep.hi, cov.hi, cov.hi) + rounded(gain.hi, other.hi, cov.hi)
    shift = belief.columns - predicted.columns
    pull = extended.solve(unit, pivots, shift).hi[..., 0]
    along = sandwich(apply(matrix.hi.mT, pull)[:, None, :], own)[:, 0]
    moved = np.sqrt(np.maximum(variances(kept) * along, 0.0))
    across = apply(gain.hi**2, summed) * (pull**2 * summed).sum(axis=-1, keepdims=True)
    moved = moved + np.sqrt(across)
    inverse = np.abs(extended.inverse(unit, pivots).hi)
    size = np.abs(cov.hi) @ np.abs(matrix.hi.mT) @ inverse @ np.abs(shift.hi)
    moved = moved + ROUNDING * (size[..., 0] + np.abs(columns.hi[..., 0]))
    drift = through(keep.hi, drift) + through(gain.hi, belief.drift) + diagonal(moved**2)
    proper = np.where(pivots.hi > 0.0, pivots.hi, np.inf)
    error = (floor / proper).max(axis=-1) + others.max(axis=-1)
    found = Belief(columns + gain @ shift, left, rounding, drift, largest)
    return gain, found.certain(), error


def _either(mask: Mask, a: Belief, b: Belief) -> Belief:
    """Belief `a` in the runs that the mask (runs, 1, 1) marks, `b` in the rest."""
    return b._replace(
        columns=extended.where(mask, a.columns, b.columns),
        cov=extended.where(mask, a.cov, b.cov),
        rounding=np.where(mask, a.rounding, b.rounding),
        drift=np.where(mask, a.drift, b.drift),
    )
