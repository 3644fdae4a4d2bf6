"""Excursions: where a defensive draw leaves the Gaussian answer, and the density of such draws.

A slice is a step of a chain, or all variables of a network without time. At each slice a draw is in
one of four *stages*, in this order:

- BEFORE its excursion;
- on an excursion that follows the model's own CPDs (PREDICTION);
- on an excursion that follows the answer's conditionals with wider tails (TAILS);
- AFTER it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import Array, Integers

# The stages of a draw: before its excursion, on one of two kinds, and after it.
BEFORE, PREDICTION, TAILS, AFTER = range(4)
# The part of excursions that follow the model itself; the others have Student tails.
PREDICTED = 0.75
# The probability that the first slice begins one, where there are more.
AT_FIRST = 0.5
# The probability that a slice is an excursion's last.
END = 0.125


@dataclass(frozen=True)
class Excursions:
    """One excursion a draw: slices k to l leave the Gaussian answer, all others follow it.

    On an excursion all slices are drawn by the model's own CPDs (stage PREDICTION), or all by the
    Gaussian answer's conditionals (stage TAILS), with Student's t for the noise in either case.
    Where there are several slices, the excursion begins at the first with a probability of ½, else
    at one of the others, all equally likely; each of its slices is its last one with a probability
    of ⅛. The density of a draw is a sum over all excursions that may have led to it. It is computed
    slice by slice, as a sum over the four stages. S is the number of draws of a run.

    slices : int
        The number of slices of a draw, 1 or more.
    predicted : float
        The part of excursions that follow the model; the others have Student tails.
    """

    slices: int
    predicted: float = PREDICTED

    def _begin(self, index: int) -> float:
        """The probability that slice `index` begins the excursion, if none before has."""
        if index == 0 and self.slices > 1:
            return AT_FIRST
        return 1.0 / (self.slices - index)

    def start(self, runs: int, count: int) -> Integers:
        """The stage of all draws before the first slice, BEFORE, (runs, S) with S = `count`."""
        return np.full((runs, count), BEFORE)

    def advance(self, index: int, stage: Integers, rng: np.random.Generator) -> Integers:
        """Choose the stages (runs, S) of draws at slice `index` at random.

        stage: Their stages at the slice before, (runs, S).
        """
        chance = rng.random(stage.shape)
        begin = self._begin(index)
        kind = np.where(chance < begin * self.predicted, PREDICTION, TAILS)
        begun = np.where(chance < begin, kind, BEFORE)
        return np.where(
            stage == BEFORE, begun, np.where((stage != AFTER) & (chance < END), AFTER, stage)
        )

    def begin(self, shape: tuple[int, int]) -> Density:
        """The density of draws before their first slice: 1, all of it in the stage BEFORE.

        shape: (runs, S).
        """
        shares = np.zeros((4, *shape))
        shares[BEFORE] = 1.0
        return Density(np.zeros(shape), shares)

    def extend(
        self, first: int, so_far: Density, gaussian: Array, predicted: Array, tails: Array
    ) -> Density:
        """The density of draws up to some slices, from that before these.

        Let a be the densities up to the slice before, by stage: a_before, a_after, and a_kind for
        each kind of excursion, PREDICTION and TAILS. Let π_kind be the part of excursions of a
        kind, p_kind the slice's density in it, and p_q its density by the Gaussian. With b the
        probability that the slice begins the excursion if none before has, and e the probability
        that an excursion has ended with the slice before, the densities become

            before: (1 − b) a_before p_q,
            of either kind: ((1 − e) a_kind + b π_kind a_before) p_kind,
            after: (a_after + e Σ a_kind) p_q.

        Parameters
        ----------
        first : int
            The number of the first of k slices, from 0.
        so_far : Density
            The density up to the slice before.
        gaussian, predicted : ndarray
            (k, runs, S): the slices' log-densities by the Gaussian, and by the model with Student's
            t.
        tails : ndarray
            (k, runs, S): the log-densities by the Gaussian with Student's t for its noise, less
            `gaussian`.
        """
        scale = np.maximum(np.maximum(predicted, gaussian), gaussian + tails)
        by_gaussian, by_model = np.exp(gaussian - scale), np.exp(predicted - scale)
        by_tails = np.exp(gaussian + tails - scale)
        none, model, wide, after = so_far.shares
        for k in range(len(scale)):
            begin = self._begin(first + k)
            after = (after + END * (model + wide)) * by_gaussian[k]
            model = ((1.0 - END) * model + begin * self.predicted * none) * by_model[k]
            wide = ((1.0 - END) * wide + begin * (1.0 - self.predicted) * none) * by_tails[k]
            none = (1.0 - begin) * none * by_gaussian[k]
        shares = np.stack([none, model, wide, after])
        peak = shares.max(axis=0)
        peak = np.where(peak > 0.0, peak, 1.0)
        return Density(so_far.scale + scale.sum(axis=0) + np.log(peak), shares / peak)


class Density(NamedTuple):
    """The density of draws up to a slice, by their stage there: `shares` times exp(`scale`).

    scale: The logarithm of a factor of all four shares, (runs, S).
    shares: For each stage, in the order of the stages, (4, runs, S).

    A share that is too small beside another for float64 becomes zero. That changes little, since
    slices that may follow the one stage may follow the other, too.
    """

    scale: Array
    shares: Array

    def log(self) -> Array:
        """The log-density of whole draws, (runs, S): that of all stages but BEFORE together.

        The draws must have all their slices: by the last one the excursion of every draw has begun.
        """
        total: Array = self.scale + np.log(self.shares[PREDICTION:].sum(axis=0))
        return total
