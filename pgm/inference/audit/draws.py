"""Draws of an audit, and what the log-densities of a slice add to theirs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.inference.audit.density import Afresh
from pgm.inference.audit.excursions import PREDICTION, TAILS, Excursions
from pgm.inference.audit.proposal import Proposal
from pgm.kernels.arrays import Array, Integers


class Draws(NamedTuple):
    """Draws with their log-densities, (runs, S).

    Attributes
    ----------
    target : ndarray
        ln p(x, z) of the model; NaN where a function was not finite at a defensive draw.
    gaussian, defensive : ndarray
        By the Gaussian answer, and by excursions from it.
    values : list of ndarray
        (runs, S, n) each: the hidden variables, by step.
    """

    target: Array
    gaussian: Array
    defensive: Array
    values: list[Array]


@dataclass(eq=False)
class Strand:
    """Draws in the making, slice by slice: of the Gaussian answer, or defensive ones.

    Attributes
    ----------
    excursions : Excursions
    shape : tuple of int
        Runs and draws.
    rng : numpy.random.Generator
    defensive : bool
    relative : bool
        Whether densities are relative to those of the linearised model.
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
