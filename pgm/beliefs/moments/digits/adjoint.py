"""The backward pass in twice the digits: a smoother that inverts no covariance of states.

Numbers are pairs of float64. A *slice* x (n components) holds the *states* and the hidden controls
of a step; only the states act on the next slice. The belief over a slice has a mean m and a
covariance P. The forward pass (`careful`) conditions it on the measurements of the step, one scalar
z = h x + e after another, where h is a row and e is noise. Each scalar has a gain G, an innovation
v = z − h m, and the variance S of that innovation. The next slice is A x plus noise.

The backward pass begins with a vector r = 0 and a matrix N = 0 after the last step. It goes back
through each scalar, and then through the transition to the step:

    scalar:        r ← (1 − G h)ᵀ r + hᵀv/S,    N ← (1 − G h)ᵀ N (1 − G h) + hᵀh/S,
    transition:    r ← Aᵀ r,                    N ← Aᵀ N A.

r and N are the *message* of all measurements passed so far. A belief m, P that knows only the
earlier measurements becomes, given the message, m + P r, P − P N P. Where this difference would
leave too few digits (an unstable motion, a wide prior), the smoothed belief is found from the next
slice's by Bayes' rule instead (Bryson & Frazier, 1963; de Jong, 1989; Durbin & Koopman, 2012, 4.4
to 4.7).

A *flat* prior has infinite variances. What it leaves unknown is then a vector δ of q components.
Means are functions m + D δ of it, and messages r + R δ, with matrices D and R; P and N are those
given δ.

Arrays of one slice have the runs first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.digits.careful_belief import (
    CLEAR,
    ROUNDING,
    Belief,
    Component,
    Move,
    diagonal,
    moments,
    rounded,
    rounded_belief,
    through,
)
from pgm.beliefs.moments.digits.careful_pass import Careful
from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.beliefs.moments.steps import refusals
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import SliceLayout
from pgm.kernels import extended
from pgm.kernels.arrays import Array, Mask, apply, block, quiet, sandwich, stacked, variances
from pgm.kernels.extended import Twofold
from pgm.progress import counted
from pgm.schedules.iteration import Point

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
        vector = keep.mT @ vector + row[..., None] * said[:, None, :]
        matrix = keep.mT @ matrix @ keep + own
        return Later(vector, matrix, rounding, drift, np.maximum(blurred, error))

    def back(self, matrix: Twofold) -> Later:
        """The message Aᵀ r, Aᵀ N A to the slice one step before.

        A = `matrix` (runs or 1, n, n) is the transition from that slice to the present one.
        """
        slope, said = matrix.hi.mT, self.matrix
        rounding = through(slope, self.rounding) + rounded(slope, said.hi)
        drift = through(slope, self.drift)
        said = matrix.mT @ said @ matrix
        return Later(matrix.mT @ self.vector, said, rounding, drift, self.blurred)


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


@dataclass(frozen=True, eq=False)
class CarefulSmoothed:
    """A chain smoothed in twice the digits: the forward pass `careful`, and the smoothed slices.

    `slices` has for each step its belief given all measurements, or given the measurements up to a
    fixed lag after the step. `beliefs` are the moments of these beliefs in float64. `layout` says
    where the variables stand in a slice. `proper` is None, unless a flat prior has left infinite
    variances in `beliefs` at some step. Then it has the covariances (T+1, runs, n, n) without their
    infinite part, that of directions of δ of which nothing is known, so that CPDs can be linearised
    at them.
    """

    careful: Careful
    slices: list[Smooth]
    beliefs: Beliefs
    layout: SliceLayout
    proper: Array | None = None

    @classmethod
    def of(cls, plan: ChainPlan, careful: Careful, lag: int | None = None) -> CarefulSmoothed:
        """Smooth a forward pass; each slice is given the measurements up to `lag` steps later.

        None for `lag` means all measurements. `careful` is the forward pass over all steps of
        `plan`. A moment that is not finite is refused with a NumericalError, except for infinite
        variances that a flat prior leaves.
        """
        shape = careful.forward.mean.shape
        beliefs = Beliefs(stacked(shape[:2], shape[2:]), stacked(shape[:2], shape[2:] * 2))
        proper: dict[int, Array] = {}
        last = shape[0] - 1
        lag = last if lag is None else lag
        slices = smoothed(careful, last, max(last - lag, 0))
        slices = [smoothed(careful, step + lag, step)[0] for step in range(last - lag)] + slices
        for step, each in enumerate(slices):
            known = careful.steps[min(step + lag, last)].taken
            mean, spread = rounded_belief(each.belief, known.unknown)
            if not np.isfinite(mean.sum() + spread.cov.sum()):
                refusals.infinite("the smoothed belief", plan.first + step)
            beliefs.mean[step], beliefs.cov[step] = mean, spread.shown
            if spread.open.any():
                proper[step] = spread.cov
        whole = None
        if proper:
            whole = beliefs.cov.copy()
            whole[list(proper)] = list(proper.values())
        return cls(careful, slices, beliefs, plan.layout, whole)

    @property
    def error(self) -> Array:
        """The largest rounding error of a mean, filtered or smoothed, at any step, (runs,).

        An error is divided by the standard deviation of its component, or, if larger, by 10⁻⁹ of
        the largest standard deviation that was predicted for the component up to that step.
        """
        largest: Array = np.max([each.belief.error(each.parts) for each in self.slices], axis=0)
        return np.maximum(largest, self.careful.error)

    @property
    def means(self) -> Array:
        """The smoothed means of the slices, (T+1, runs, n)."""
        return self.beliefs.mean

    @cached_property
    def point(self) -> Point:
        """The smoothed moments, as a point at which CPDs can be linearised.

        The point has the moments of the slices, and the covariances of the pairs (states at t − 1,
        slice at t) for the CPDs of a transition. The latter are None if the transition is one CPD,
        of the whole slice given the whole slice before: the moments of slices are enough for it.
        """
        pairs = None if self.layout.single else self.pairs()
        return Point(self.beliefs.mean, self.beliefs.cov, pairs, self.proper)

    def pairs(self) -> Array:
        """The covariances of the pairs (states at t − 1, slice at t), t = 1..T.

        They are (T, runs, m, m), m being the number of the states' components plus n, the slice's.
        Row t − 1 is of step t.
        """
        states, front = self.layout.state_places, self.layout.state_size
        found = [
            joint(self.careful, [step - 1, step], self.slices)[1]
            for step in range(1, len(self.slices))
        ]
        size = self.layout.slice_size
        wanted = np.concatenate([np.arange(size)[states], size + np.arange(size)])
        shape = (0, *self.beliefs.mean.shape[1:2], front + size, front + size)
        return block(np.array(found), wanted, wanted) if found else np.zeros(shape)

    def at(self, plan: ChainPlan, mean: Array) -> CarefulSmoothed:
        """A copy of the result whose smoothed means are `mean` (T+1, runs, n).

        A step control (Levenberg–Marquardt) reports means of its own in place of the solution's.
        Covariances stay as they are. `plan` is not used; the results of other smoothers need it.
        """
        shift = mean - self.beliefs.mean
        slices = [
            each._replace(belief=each.belief.shifted(own))
            for each, own in zip(self.slices, shift, strict=True)
        ]
        beliefs = Beliefs(mean, self.beliefs.cov)
        return replace(self, slices=slices, beliefs=beliefs)


@quiet()
def smoothed(careful: Careful, last: int, first: int = 0) -> list[Smooth]:
    """The slices at the steps `first`..`last` in order, given the measurements up to `last`.

    Where more than 10⁻¹² of a variance may be rounding, Bayes' rule from the next slice is tried
    too, and used in the runs in which it leaves a smaller share.
    """
    columns, cov, *_ = careful.steps[last].predicted
    nothing = np.zeros(cov.shape)
    said = Twofold.zeros(columns.shape), Twofold.zeros(cov.shape)
    later = Later(*said, nothing, nothing, np.zeros(len(nothing)))
    out: list[Smooth] = []
    for step in counted(range(last, first - 1, -1), "back, in twice the digits"):
        move, _, taken = careful.steps[step]
        belief, parts, back = *given(taken.belief, later), None
        if out and is_close(parts).any():
            ahead, after = careful.steps[step + 1], out[-1]
            assert ahead.move is not None
            next_ = ahead.move, ahead.predicted, after.belief, after.parts
            belief, parts, back = closer(taken.belief, belief, parts, *next_)
        here = later.before(taken.components)
        out.append(Smooth(step, belief, here, back, parts))
        if move is not None:
            later = here.back(move.matrix)
    return out[::-1]


@quiet()
def joint(careful: Careful, steps: list[int], slices: list[Smooth]) -> tuple[Array, Array]:
    """The joint mean (runs, k n) and covariance (runs, k n, k n) of the slices at k `steps`.

    The steps ascend. `slices` are those of consecutive steps, as `smoothed` finds them, from
    `steps[0]` or before to `steps[-1]` or later, given the measurements up to the last of these.
    Where a flat prior leaves a component unknown, it has an infinite variance and no covariances.
    """
    last = slices[-1].step
    begin, known = slices[0].step, careful.steps[last].taken.unknown
    runs, size = careful.forward.mean.shape[1:]
    mean = np.empty((runs, len(steps), size))
    cov = np.empty((runs, len(steps), size, len(steps), size))
    for j, second in enumerate(steps):
        later = slices[second - begin]
        mean[:, j], cov[:, j, :, j] = moments(later.belief, known)
        found = _across(careful, slices, steps[0], second) if j else {}
        for i, first in enumerate(steps[:j]):
            across = found[first] + known.between(slices[first - begin].belief, later.belief)
            cov[:, i, :, j], cov[:, j, :, i] = across.hi, across.mT.hi
    whole = len(steps) * size
    total = cov.reshape(runs, whole, whole)
    unbounded = np.isinf(variances(total))
    # As in the moments of a slice: an unknown component has no covariance with others.
    total[(unbounded[:, None] | unbounded[..., None]) & ~np.eye(whole, dtype=bool)] = 0.0
    return mean.reshape(runs, whole), total


def _across(careful: Careful, slices: list[Smooth], first: int, second: int) -> dict[int, Twofold]:
    """Cross-covariances of slice s with slice `second`, (runs, n, n), by s = `first`..second − 1.

    Rows are of slice s, columns of `second`. Both slices know the measurements up to the last of
    `slices`; the covariances are those given δ. With P the filtered covariance at s, P⁻ the
    predicted one at `second`, N the message of the measurements from `second` on, and Φ the product
    of the A and 1 − G h that carry an error at s to the prediction at `second`, the
    cross-covariance is P Φᵀ (1 − N P⁻). In runs in which slice s was found by Bayes' rule, with the
    gain G, it is G times the cross-covariance of slice s + 1.
    """
    begin = slices[0].step
    move, predicted, _ = careful.steps[second]
    assert move is not None
    across, found = slices[second - begin].belief.cov, {}
    said = slices[second - begin].here.matrix
    weight = move.matrix.mT
    weight = weight - weight @ said @ predicted.cov
    for step in range(second - 1, first - 1, -1):
        move, _, taken = careful.steps[step]
        back, own = slices[step - begin].back, taken.belief.cov @ weight
        across = own if back is None else extended.where(back.lost, back.gain @ across, own)
        found[step] = across
        if step > first:
            assert move is not None
            for component in reversed(taken.components):
                weight = component.keep.mT @ weight
            weight = move.matrix.mT @ weight
    return found


def given(known: Belief, later: Later) -> tuple[Belief, Array]:
    """The smoothed belief m + P r, P − P N P over a slice, from its filtered belief `known`, m, P.

    `later` is the message r, N of the measurements after the slice's own. Returns the belief, with
    its own bounds of rounding, and the shares of its variances that may be rounding, (runs, n).
    """
    columns, cov, own, drift, largest = known
    left = _symmetric(cov - cov @ later.matrix @ cov)
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
    found: Mask = (parts > _CLOSE).any(axis=-1)
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
    gain = extended.solve(unit, pivots, matrix @ cov).mT
    keep = np.eye(cov.shape[-1]) - gain @ matrix
    other = noise + belief.cov
    left = keep @ cov @ keep.mT + gain @ other @ gain.mT
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
    found = Belief(columns + gain @ shift, _symmetric(left), rounding, drift, largest)
    return gain, found.certain(), error


def _either(mask: Mask, a: Belief, b: Belief) -> Belief:
    """Belief `a` in the runs that the mask (runs, 1, 1) marks, `b` in the rest."""
    return b._replace(
        columns=extended.where(mask, a.columns, b.columns),
        cov=extended.where(mask, a.cov, b.cov),
        rounding=np.where(mask, a.rounding, b.rounding),
        drift=np.where(mask, a.drift, b.drift),
    )


def _symmetric(cov: Twofold) -> Twofold:
    """(P + Pᵀ) / 2 of a covariance P (..., n, n), since rounding makes products unsymmetric."""
    return 0.5 * (cov + cov.mT)
