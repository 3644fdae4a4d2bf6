"""Importance draws for an audit, made slice by slice, with their densities.

Draws are from the Gaussian answer q, or from a defensive density d. Of the draws from d some follow
q but for an excursion (`Excursions`), the others are from Gaussians at other modes (`Modes`). A
slice is a step of a chain, or all variables of a network without time. *White noise* s gives a
slice, F x + b + L s, from the states x before (`Proposal`). S is the number of draws of a run, n
that of the components of a slice, m that of the states before, 0 for the first slice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.inference.audit.density import Afresh
from pgm.inference.audit.excursions import PREDICTION, TAILS, Excursions
from pgm.inference.audit.modes import Modes
from pgm.inference.audit.proposal import Path
from pgm.kernels.arrays import Array, Integers


class Draws(NamedTuple):
    """The log-densities of draws x, (runs, S) each, and the values of the draws.

    `target` is ln p(x, z) of the model with the measurements z, NaN where a function was not finite
    at a defensive draw; `gaussian` is ln q and `defensive` ln d. `values` has by step an array
    (runs, S, ...): of a chain, vectors of the states before and the slice; of a network without
    time a single array, of all variables.
    """

    target: Array
    gaussian: Array
    defensive: Array
    values: list[Array]


@dataclass(eq=False)
class Strand:
    """Draws from q or d under construction: call `propose`, then `weigh`, for each slice in turn.

    A defensive draw leaves q for an excursion, or is of another mode's Gaussian q_k:

        d = (1 − Σ_k m_k) d_excursion + Σ_k m_k q_k

    with the modes' shares m_k and the density d_excursion of draws with an excursion. Both ln q and
    ln d are summed up over the slices.

    answer : Path
        The Gaussian answer q.
    modes : Modes
        The other Gaussians q_k, and their shares.
    excursions : Excursions
        Where defensive draws leave q.
    shape : tuple of int
        (runs, S).
    rng : Generator
    defensive : bool
        Whether these are draws of d, or of q.
    relative : bool
        Whether densities are divided by those of the linearised model, so that q's is one.
    """

    answer: Path
    modes: Modes
    excursions: Excursions
    shape: tuple[int, int]
    rng: np.random.Generator
    defensive: bool
    relative: bool

    def __post_init__(self) -> None:
        self.gaussian = np.zeros(self.shape)
        self._density = self.excursions.begin(self.shape)
        self._stage: Integers = self.excursions.start(*self.shape)
        self._by_mode = np.zeros((len(self.modes.paths), *self.shape))
        self._excursion = np.ones(self.shape, dtype=bool)
        if self.defensive and self.modes.paths:
            self._mode = self.modes.drawn(self.shape[1], self.rng)
            self._excursion = self._mode == len(self.modes.paths)
        self._white = np.zeros(0)
        self._index = 0

    def propose(self, given: Array) -> tuple[Array, Afresh | None]:
        """Draw the next slice (runs, S, n) given the states before, (runs, S, m).

        Returns the slice, and an `Afresh`, whose mask has the draws for which the model's own CPDs
        are to draw the slice instead; None unless draws are defensive.
        """
        proposal, row = self.answer.at(self._index)
        tails = afresh = None
        if self.defensive:
            self._stage = self.excursions.advance(self._index, self._stage, self.rng)
            tails = (self._stage == TAILS) & self._excursion
            afresh = Afresh((self._stage == PREDICTION) & self._excursion, self.rng)
        white = proposal.white(row, self.shape[1], self.rng, tails)
        values = proposal.values(row, given, white)
        if not self._excursion.all():
            for k, path in enumerate(self.modes.paths):
                other, place = path.at(self._index)
                here = self._mode == k
                values = np.where(here[..., None], other.values(place, given, white), values)
        self._white = white
        return values, afresh

    def weigh(self, given: Array, values: Array, predicted: Array) -> None:
        """Add the log-densities of a slice to ln q and ln d.

        `given` (runs, S, m) are the states before, `values` (runs, S, n) the slice as drawn, and
        `predicted` (runs, S) its log-density by the model's CPDs, with Student's t for their noise.
        """
        proposal, row = self.answer.at(self._index)
        white = self._white
        away = (self._stage == PREDICTION) | ~self._excursion
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
        for k, path in enumerate(self.modes.paths):
            other, place = path.at(self._index)
            white = other.whitened(place, given, values)
            self._by_mode[k] += other.log_density(place, np.einsum("rsi,rsi->rs", white, white))
        self._index += 1

    def drawn(self, target: Array, values: list[Array]) -> Draws:
        """The finished draws, after the last slice; `target` and `values` are those of `Draws`."""
        defensive = self._density.log()
        if self.modes.paths:
            shares = self.modes.shares
            rest = np.log1p(-shares.sum(axis=0))[:, None]
            with np.errstate(divide="ignore"):  # no draw is of a mode that a run has not
                each = np.log(shares)[..., None] + self._by_mode
            defensive = np.logaddexp.reduce([defensive + rest, *each])
        return Draws(target, self.gaussian, defensive, values)
