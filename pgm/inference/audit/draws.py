"""Importance draws for an audit, made slice by slice, with their densities.

Draws are from the Gaussian answer q, or from a *defensive* density d with wider tails. Some draws
from d follow q but for an *excursion*: at some successive slices they follow the model's own CPDs,
or q's conditionals, with Student's t for the noise in either case. The other draws from d are from
Gaussians at other modes.

A slice is a step of a chain, or all variables of a network without time. Under q, a slice is
F x + b + L s given the states x before, an affine mean plus white noise s times a root L. S is the
number of draws of a run, n that of the components of a slice, m that of the components of the
states before, 0 for the first slice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.trajectories.density import Afresh
from pgm.beliefs.moments.trajectories.proposal import Path
from pgm.inference.audit.excursions import PREDICTION, TAILS, Excursions
from pgm.inference.audit.modes import Modes
from pgm.kernels.arrays import Array, Integers, Mask, inner


class Draws(NamedTuple):
    """The log-densities of draws x, (runs, S) each, and the values of the draws.

    target: ln p(x, z) of the model with the measurements z; NaN where a function of the model is
        NaN or infinite at a defensive draw.
    gaussian, defensive: ln q and ln d.
    values: In a chain, by step the vectors of the states before, then the slice, with zeros for the
        states before step 0, (T+1, runs, S, m + n); in a network without time (1, runs, S, n).
    """

    target: Array
    gaussian: Array
    defensive: Array
    values: Array


@dataclass(eq=False)
class Strand:
    """Draws from q or d under construction: call `propose` for each slice, `weigh` for several.

    A defensive draw leaves q for an excursion, or is of another mode's Gaussian q_k:

        d = (1 − Σ_k π_k) d_excursion + Σ_k π_k q_k

    with the modes' shares π_k and the density d_excursion of draws with an excursion. Both ln q and
    ln d are summed up over the slices.

    answer : Path
        The Gaussian answer q.
    modes : Modes
        The other Gaussians q_k, and their shares.
    excursions : Excursions
        The law of excursions: where defensive draws leave q, and what they follow there.
    shape : tuple of int
        (runs, S).
    rng : Generator
        The generator of the draws.
    defensive : bool
        Whether these are draws from d; otherwise they are from q.
    relative : bool
        Whether densities are divided by those of the linearised model; q's are one then.
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
        self._white: list[Array] = []  # of the slices that are not weighed yet
        self._away: list[Mask] = []  # and where they are not made of it by q
        self._index = self._weighed = 0

    def propose(self, given: Array) -> tuple[Array, Afresh | None]:
        """Draw the next slice (runs, S, n) given the states before, (runs, S, m).

        Returns the slice; and of defensive draws an `Afresh`, which marks those whose slice the
        model's own CPDs are to draw instead. For draws from q it is None.
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
        self._white.append(white)
        self._away.append((self._stage == PREDICTION) | ~self._excursion)
        self._index += 1
        return values, afresh

    def weigh(self, given: Array, values: Array, predicted: Array) -> None:
        """Add the log-densities of the next k slices to ln q and ln d.

        given: The states before them, (k, runs, S, m).
        values: The slices as they were drawn, (k, runs, S, n).
        predicted: Their log-densities by the model's own CPDs, with Student's t for their noise,
            (k, runs, S).
        """
        first, self._weighed = self._weighed, self._weighed + len(values)
        proposal, row = self.answer.at(first)
        rows = slice(row, row + len(values))
        white, away = np.stack(self._white), np.stack(self._away)
        self._white, self._away = [], []
        if away.any():
            again = proposal.whitened(rows, given, values)
            white = np.where(away[..., None], again, white)
        squared = inner(white, white)
        gaussian = np.zeros(squared.shape)
        if not self.relative:
            gaussian = proposal.log_density(rows, squared)
        tails = proposal.log_tails(rows, squared)
        self._density = self.excursions.extend(first, self._density, gaussian, predicted, tails)
        self.gaussian += gaussian.sum(axis=0)
        for k, path in enumerate(self.modes.paths):
            other, place = path.at(first)
            rows = slice(place, place + len(values))
            white = other.whitened(rows, given, values)
            self._by_mode[k] += other.log_density(rows, inner(white, white)).sum(axis=0)

    def drawn(self, target: Array, values: Array) -> Draws:
        """The finished draws, after the last slice.

        target: ln p(x, z) of the model, (runs, S).
        values: The values of the draws, by step.
        """
        defensive = self._density.log()
        if self.modes.paths:
            shares = self.modes.shares
            rest = np.log1p(-shares.sum(axis=0))[:, None]
            with np.errstate(divide="ignore"):  # no draw is of a mode that a run has not
                each = np.log(shares)[..., None] + self._by_mode
            defensive = np.logaddexp.reduce([defensive + rest, *each])
        return Draws(target, self.gaussian, defensive, values)
