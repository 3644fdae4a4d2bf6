"""The backward pass in twice the digits: a smoother that inverts no covariance of states.

With the gain G and the innovation v of variance S of a component read along h, backwards from r = 0
and N = 0 behind the last step,

    r ← (1 − G h)ᵀ r + hᵀv/S,    N ← (1 − G h)ᵀ N (1 − G h) + hᵀh/S,

and r ← Aᵀ r, N ← Aᵀ N A through a transition with the matrix A. A belief m, P that knows the
readings up to a step becomes m + P r, P − P N P with those after it. Where that difference would
leave too few digits (an unstable motion, a wide prior), it is found from the next belief by Bayes'
rule instead, as in the smoother of Rauch, Tung and Striebel.

References
----------
Bryson & Frazier, Smoothing for linear and nonlinear dynamic systems, 1963.
de Jong, Smoothing and interpolation with the state-space model, 1989.
Durbin & Koopman, Time series analysis by state space methods, 2012, sections 4.4 to 4.7.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.inference.chain.backward import Beliefs
from pgm.inference.chain.careful import ROUNDING, Belief, Careful, Component, Step, moments
from pgm.kernels import twofold
from pgm.kernels.arrays import Array, Mask, sandwich, stacked
from pgm.kernels.twofold import Twofold

# A variance that the readings after a step leave so small a part of is not found as a difference.
_SMALL = 1e-6
# The share of its diagonal entry below which a pivot of a predicted covariance is rounding.
_SINGULAR = 1e-26


class Later(NamedTuple):
    """What readings say of a slice: r as a function of δ, (runs, n, 1 + q), and N, (runs, n, n)."""

    vector: Twofold
    matrix: Twofold

    def before(self, components: list[Component]) -> Later:
        """With the components read at the step too, for the belief before they are."""
        vector, matrix = self
        for row, gain, innovation, weight in reversed(components):
            keep = np.eye(matrix.shape[-1]) - gain[..., None] * row[:, None, :]
            said = innovation * weight[:, None]
            vector = keep.mT @ vector + row[..., None] * said[:, None, :]
            matrix = keep.mT @ matrix @ keep + (row * weight[:, None])[..., None] * row[:, None, :]
        return Later(vector, matrix)

    def back(self, matrix: Twofold) -> Later:
        """What it says of the slice before, through a transition."""
        return Later(matrix.mT @ self.vector, matrix.mT @ self.matrix @ matrix)


class Back(NamedTuple):
    """Gains on the slice after, (runs, n, n), and the runs that they are used in, (runs, 1, 1)."""

    gain: Twofold
    lost: Mask


class Smooth(NamedTuple):
    """A slice given the readings up to a last step.

    Attributes
    ----------
    belief : Belief
    here : Later
        What is read from its step on.
    back : Back or None
        Where in some run the belief was found from that of the slice after it.
    """

    belief: Belief
    here: Later
    back: Back | None


@dataclass(frozen=True, eq=False)
class CarefulSmoothed:
    """Both passes.

    Attributes
    ----------
    careful : Careful
        The forward pass.
    slices : list of Smooth
        Of each step, given all readings.
    beliefs : Beliefs
        Their moments, rounded.
    """

    careful: Careful
    slices: list[Smooth]
    beliefs: Beliefs

    @classmethod
    def of(cls, careful: Careful) -> CarefulSmoothed:
        """Go back."""
        shape = careful.forward.mean.shape
        beliefs = Beliefs(stacked(shape[:2], shape[2:]), stacked(shape[:2], shape[2:] * 2))
        slices = smoothed(careful, shape[0] - 1)
        for step, each in enumerate(slices):
            beliefs.mean[step], beliefs.cov[step] = moments(each.belief, careful.unknown)
        return cls(careful, slices, beliefs)

    @property
    def means(self) -> Array:
        """Of the slices."""
        return self.beliefs.mean


def smoothed(careful: Careful, last: int) -> list[Smooth]:
    """Every slice up to a last step, given the readings up to it."""
    columns, cov, _ = careful.steps[last].known
    later = Later(Twofold.zeros(columns.shape), Twofold.zeros(cov.shape))
    out: list[Smooth] = []
    for step in range(last, -1, -1):
        made = careful.steps[step]
        belief, back = _given(made.known, later), None
        if out and (lost := _lost(made.known, belief)).any():
            gain, other = _reversed(made.known, careful.steps[step + 1], out[-1].belief)
            back = Back(gain, lost)
            belief = _either(lost, other, belief)
        here = later.before(made.components)
        out.append(Smooth(belief, here, back))
        if made.matrix is not None:
            later = here.back(made.matrix)
    return out[::-1]


def joint(careful: Careful, steps: list[int], slices: list[Smooth]) -> tuple[Array, Array]:
    """Moments of the slices of some steps, ascending, given the readings up to the last slice.

    With Φ the product of A (1 − G h) from one step to another, the errors of two predictions have
    the covariance P Φᵀ, of which the readings from the second step on leave P Φᵀ (1 − N P).

    Returns
    -------
    mean, cov : ndarray
        (runs, k n) and (runs, k n, k n).
    """
    known = careful.to(len(slices) - 1)
    runs, size = careful.forward.mean.shape[1:]
    mean = np.empty((runs, len(steps), size))
    cov = np.empty((runs, len(steps), size, len(steps), size))
    for i, first in enumerate(steps):
        mean[:, i], cov[:, i, :, i] = moments(slices[first].belief, known)
        for j, second in enumerate(steps[i + 1 :], i + 1):
            total = _across(careful, slices, first, second)
            total = total + known.between(slices[first].belief, slices[second].belief)
            cov[:, i, :, j], cov[:, j, :, i] = total.hi, total.mT.hi
    whole = len(steps) * size
    return mean.reshape(runs, whole), cov.reshape(runs, whole, whole)


def _across(careful: Careful, slices: list[Smooth], first: int, second: int) -> Twofold:
    """The covariance given δ of a slice with a later one."""
    across = careful.steps[first].known.cov
    for step in range(first + 1, second + 1):
        made = careful.steps[step]
        assert made.matrix is not None
        across = across @ made.matrix.mT
        if step < second:
            for row, gain, *_ in made.components:
                across = across - (across @ row[..., None]) @ gain[:, None, :]
    made, later = careful.steps[second], slices[second]
    across = across - across @ later.here.matrix @ made.predicted.cov
    back = slices[first].back
    if back is None:
        return across
    rest = slices[second].belief.cov
    if first + 1 < second:
        rest = _across(careful, slices, first + 1, second)
    return twofold.where(back.lost, back.gain @ rest, across)


def _given(known: Belief, later: Later) -> Belief:
    """A belief with what is read after its step."""
    columns, cov, _ = known
    left = _symmetric(cov - cov @ later.matrix @ cov)
    rounding = ROUNDING * _variances(cov)[..., None] * np.eye(cov.shape[-1])
    return Belief(columns + cov @ later.vector, left, known.rounding + rounding).certain()


def _lost(known: Belief, belief: Belief) -> Mask:
    """Whether a variance is so much smaller than it was that the difference has lost its digits.

    (runs, 1, 1).
    """
    before, after = _variances(known.cov), _variances(belief.cov)
    small: Mask = np.any((after < _SMALL * before) & (before > 0.0), axis=-1, keepdims=True)
    return small[..., None]


def _reversed(known: Belief, after: Step, belief: Belief) -> tuple[Twofold, Belief]:
    """A belief with what is read after its step, by Bayes' rule from that of the slice after it.

    With the gain G = P Aᵀ(P⁻)⁺, (1 − G A) P (1 − G A)ᵀ + G (Q + P′) Gᵀ subtracts nothing.
    """
    columns, cov, _ = known
    matrix, noise = after.matrix, after.noise
    assert matrix is not None
    assert noise is not None
    gain = cov @ matrix.mT @ twofold.inverse(*twofold.eliminated(after.predicted.cov, _SINGULAR))
    keep = np.eye(cov.shape[-1]) - gain @ matrix
    left = keep @ cov @ keep.mT + gain @ (noise + belief.cov) @ gain.mT
    rounding = sandwich(keep.hi, known.rounding) + sandwich(gain.hi, belief.rounding)
    mean = columns + gain @ (belief.columns - after.predicted.columns)
    return gain, Belief(mean, _symmetric(left), rounding).certain()


def _either(mask: Mask, a: Belief, b: Belief) -> Belief:
    """A belief in the runs of a mask, (runs, 1, 1), another one in all others."""
    return Belief(
        twofold.where(mask, a.columns, b.columns),
        twofold.where(mask, a.cov, b.cov),
        np.where(mask, a.rounding, b.rounding),
    )


def _symmetric(cov: Twofold) -> Twofold:
    return 0.5 * (cov + cov.mT)


def _variances(cov: Twofold) -> Array:
    found: Array = np.einsum("...ii->...i", cov.hi)
    return found
