"""Draws of an audit: where defensive ones leave the Gaussian answer, and the densities of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.inference.audit.density import Afresh
from pgm.inference.audit.proposal import Proposal
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
    """One excursion a draw: slices k to l leave the Gaussian, those around them follow it.

    The first slice begins it with a probability of ½, all others alike; each of its slices is the
    last one with a probability of ⅛. The density of a draw, of all excursions that may have led to
    it, is summed up slice by slice, over the four stages.

    slices: Of a draw, 1 or more.
    predicted: The part of excursions that follow the model; the others have Student tails.
    """

    slices: int
    predicted: float = PREDICTED

    def _begin(self, index: int) -> float:
        """The probability that a slice begins the excursion, if none before has."""
        if index == 0 and self.slices > 1:
            return AT_FIRST
        return 1.0 / (self.slices - index)

    def start(self, runs: int, count: int) -> Integers:
        """The stage before the first slice, (runs, S)."""
        return np.full((runs, count), BEFORE)

    def advance(self, index: int, stage: Integers, rng: np.random.Generator) -> Integers:
        """Draw the stages of a slice given those of the slice before, (runs, S)."""
        chance = rng.random(stage.shape)
        begin = self._begin(index)
        kind = np.where(chance < begin * self.predicted, PREDICTION, TAILS)
        begun = np.where(chance < begin, kind, BEFORE)
        return np.where(
            stage == BEFORE, begun, np.where((stage != AFTER) & (chance < END), AFTER, stage)
        )

    def begin(self, shape: tuple[int, int]) -> Density:
        """The density before the first slice."""
        shares = np.zeros((4, *shape))
        shares[BEFORE] = 1.0
        return Density(np.zeros(shape), shares)

    def extend(
        self, index: int, so_far: Density, gaussian: Array, predicted: Array, tails: Array
    ) -> Density:
        """The density of draws up to a slice.

        gaussian, predicted: (runs, S): the log-density of the slice by the Gaussian, and by the
            model.
        tails: (runs, S): that with Student tails, less the Gaussian's.
        """
        begin, before = self._begin(index), so_far.shares
        scale = np.maximum(np.maximum(predicted, gaussian), gaussian + tails)
        by_gaussian = np.exp(gaussian - scale)
        shares = np.empty_like(before)
        shares[BEFORE] = (1.0 - begin) * before[BEFORE] * by_gaussian
        for kind, part in ((PREDICTION, self.predicted), (TAILS, 1.0 - self.predicted)):
            shares[kind] = (1.0 - END) * before[kind] + begin * part * before[BEFORE]
        shares[PREDICTION] *= np.exp(predicted - scale)
        shares[TAILS] *= np.exp(gaussian + tails - scale)
        shares[AFTER] = before[AFTER] + END * (before[PREDICTION] + before[TAILS])
        shares[AFTER] *= by_gaussian
        return Density(so_far.scale + scale, shares)


class Density(NamedTuple):
    """The density of draws so far, (runs, S), with a logarithm of its own as its scale.

    A share of a stage that is too small for float64 beside another's stays so: whatever follows one
    may follow the other.

    scale: (runs, S).
    shares: (4, runs, S): by stage, over the exponential of the scale.
    """

    scale: Array
    shares: Array

    def log(self) -> Array:
        """The log-density of whole draws, whose excursion has begun."""
        total: Array = self.scale + np.log(self.shares[PREDICTION:].sum(axis=0))
        return total


class Draws(NamedTuple):
    """Draws with their log-densities, (runs, S).

    target: ln p(x, z) of the model; NaN where a function was not finite at a defensive draw.
    gaussian, defensive: By the Gaussian answer, and by excursions from it.
    values: (runs, S, n) each: the hidden variables, by step.
    """

    target: Array
    gaussian: Array
    defensive: Array
    values: list[Array]


@dataclass(eq=False)
class Strand:
    """Draws in the making, slice by slice: of the Gaussian answer, or defensive ones.

    relative: Whether densities are relative to those of the linearised model.
    """

    excursions: Excursions
    shape: tuple[int, int]
    rng: np.random.Generator
    defensive: bool
    relative: bool

    def __post_init__(self) -> None:
        self.gaussian = np.zeros(self.shape)
        self._density = self.excursions.begin(self.shape)
        self._stage: Integers = self.excursions.start(*self.shape)
        self._white = np.zeros(0)
        self._index = 0

    def propose(self, proposal: Proposal, row: int, given: Array) -> tuple[Array, Afresh | None]:
        """Draw a slice by a row of a proposal, and say which of them the model draws."""
        tails = afresh = None
        if self.defensive:
            self._stage = self.excursions.advance(self._index, self._stage, self.rng)
            tails = self._stage == TAILS
            afresh = Afresh(self._stage == PREDICTION, self.rng)
        self._white = proposal.white(row, self.shape[1], self.rng, tails)
        return proposal.values(row, given, self._white), afresh

    def weigh(
        self, proposal: Proposal, row: int, given: Array, values: Array, predicted: Array
    ) -> None:
        """Take in the densities of a slice, (runs, S, n); `predicted` is that by the model."""
        white = self._white
        away = self._stage == PREDICTION
        if away.any():
            again = proposal.whitened(row, given, values)
            white = np.where(away[..., None], again, white)
        squared = np.einsum("rsi,rsi->rs", white, white)
        gaussian = np.zeros(self.shape)
        if not self.relative:
            gaussian = proposal.log_density(row, squared)
        tails = proposal.log_tails(row, squared)
        self._density = self.excursions.extend(
            self._index, self._density, gaussian, predicted, tails
        )
        self.gaussian += gaussian
        self._index += 1

    def drawn(self, target: Array, values: list[Array]) -> Draws:
        """The draws, once all slices are taken in."""
        return Draws(target, self.gaussian, self._density.log(), values)
