"""Excursions: where a defensive draw leaves the Gaussian answer, and with which density."""

from __future__ import annotations

from dataclasses import dataclass
from math import log

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
    """One excursion a draw: slices k to l leave the Gaussian, those around them follow it.

    The first slice begins it with a probability of ½, all others alike; each of its slices is the
    last one with a probability of ⅛. The density of a draw, of all excursions that may have led to
    it, is summed up slice by slice, over the four stages.

    Attributes
    ----------
    slices : int
        Of a draw, 1 or more.
    predicted : float
        The part of excursions that follow the model; the others have Student tails.
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

    def log_start(self, shape: tuple[int, ...]) -> Array:
        """The log-density before the first slice, by stage, (4, *shape)."""
        logs = np.full((4, *shape), -np.inf)
        logs[BEFORE] = 0.0
        return logs

    def log_advance(self, index: int, logs: Array, gaussian: Array, others: Array) -> Array:
        """The log-density of draws up to a slice, by the slice's stage, (4, runs, S).

        Parameters
        ----------
        index : int
        logs : ndarray
            (4, runs, S): up to the slice before.
        gaussian : ndarray
            (runs, S): the log-density of the slice by the Gaussian.
        others : ndarray
            (2, runs, S): by the model, and with Student tails.
        """
        begin = self._begin(index)
        with np.errstate(divide="ignore"):  # what cannot be has a density of zero
            fresh = np.log([begin * self.predicted, begin * (1.0 - self.predicted)])
            never = np.log(1.0 - begin) if begin < 1.0 else -np.inf
        away = logs[PREDICTION : TAILS + 1]
        new = np.empty_like(logs)
        new[BEFORE] = logs[BEFORE] + never + gaussian
        new[PREDICTION : TAILS + 1] = others + np.logaddexp(
            away + log(1.0 - END), logs[BEFORE] + fresh[:, None, None]
        )
        back = np.logaddexp(*away) + log(END)
        new[AFTER] = np.logaddexp(logs[AFTER], back) + gaussian
        return new

    def log_density(self, logs: Array) -> Array:
        """The log-density of whole draws, (runs, S)."""
        return np.logaddexp.reduce(logs[PREDICTION:], axis=0)
