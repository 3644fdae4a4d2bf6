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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pgm.beliefs.moments.digits import compiled
from pgm.beliefs.moments.digits.adjoint_belief import Later, Smooth, closer, given, is_close
from pgm.beliefs.moments.digits.careful_belief import (
    moments,
)
from pgm.beliefs.moments.digits.careful_pass import Careful
from pgm.beliefs.moments.digits.laid_out import piled
from pgm.beliefs.moments.digits.record import Record, Slices, row, shown
from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.beliefs.moments.steps import refusals
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import SliceLayout
from pgm.kernels import extended
from pgm.kernels.arrays import Array, block, quiet, stacked, variances
from pgm.kernels.extended import Twofold
from pgm.progress import counted
from pgm.schedules.iteration import Point


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
    slices: Slices
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
        last, steps = shape[0] - 1, careful.steps
        lag = last if lag is None else min(lag, last)
        until = np.minimum(np.arange(last + 1) + lag, last)
        if isinstance(steps, Record):
            slices = compiled.smoothed(steps, lag, 0, last - lag + 1)
            unknown = row(steps.unknown, until)
        else:
            found = [smoothed(careful, step + lag, step)[0] for step in range(last - lag)]
            slices = Slices.of([*found, *smoothed(careful, last, last - lag)])
            unknown = piled([steps[step].taken.unknown for step in until])
        mean, spread = shown(slices.belief, unknown)
        finite = np.isfinite(mean.sum(axis=(1, 2)) + spread.cov.sum(axis=(1, 2, 3)))
        if not finite.all():
            refusals.infinite("the smoothed belief", plan.first + int(finite.argmin()))
        beliefs = Beliefs(stacked(shape[:2], shape[2:]), stacked(shape[:2], shape[2:] * 2))
        beliefs.mean[...], beliefs.cov[...] = mean, spread.shown
        open_, proper = np.asarray(spread.open.any(axis=(1, 2, 3))), None
        if open_.any():
            proper = np.where(open_[:, None, None, None], spread.cov, beliefs.cov)
        return cls(careful, slices, beliefs, plan.layout, proper)

    @property
    def error(self) -> Array:
        """The largest rounding error of a mean, filtered or smoothed, at any step, (runs,).

        An error is divided by the standard deviation of its component, or, if larger, by 10⁻⁹ of
        the largest standard deviation that was predicted for the component up to that step.
        """
        largest: Array = self.slices.belief.error(self.slices.parts).max(axis=0)
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
        slices = replace(self.slices, belief=self.slices.belief.shifted(shift))
        return replace(self, slices=slices, beliefs=Beliefs(mean, self.beliefs.cov))


@quiet()
def smoothed(careful: Careful, last: int, first: int = 0) -> Sequence[Smooth]:
    """The slices at the steps `first`..`last` in order, given the measurements up to `last`.

    Where more than 10⁻¹² of a variance may be rounding, Bayes' rule from the next slice is tried
    too, and used in the runs in which it leaves a smaller share.
    """
    if isinstance(careful.steps, Record):
        return compiled.smoothed(careful.steps, last, first)
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
def joint(careful: Careful, steps: list[int], slices: Sequence[Smooth]) -> tuple[Array, Array]:
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
            cov[:, i, :, j], cov[:, j, :, i] = across.hi, across.T.hi
    whole = len(steps) * size
    total = cov.reshape(runs, whole, whole)
    unbounded = np.isinf(variances(total))
    # As in the moments of a slice: an unknown component has no covariance with others.
    total[(unbounded[:, None] | unbounded[..., None]) & ~np.eye(whole, dtype=bool)] = 0.0
    return mean.reshape(runs, whole), total


def _across(
    careful: Careful, slices: Sequence[Smooth], first: int, second: int
) -> dict[int, Twofold]:
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
    weight = move.matrix.T
    weight = weight - weight @ said @ predicted.cov
    for step in range(second - 1, first - 1, -1):
        move, _, taken = careful.steps[step]
        back, own = slices[step - begin].back, taken.belief.cov @ weight
        across = own if back is None else extended.where(back.lost, back.gain @ across, own)
        found[step] = across
        if step > first:
            assert move is not None
            for component in reversed(taken.components):
                weight = component.keep.T @ weight
            weight = move.matrix.T @ weight
    return found
