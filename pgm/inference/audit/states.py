"""Probabilities of states estimated from weighted draws, beside those of the answer."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pgm.factors import Table
from pgm.inference.audit.compared import Compared
from pgm.inference.audit.mixture import Mixture
from pgm.kernels.arrays import Array, Mask, frozen
from pgm.variables import Discrete

# The smallest probability that is told from none.
_TINY = 1e-300


@dataclass(frozen=True, eq=False, kw_only=True)
class ComparedStates(Compared):
    """Exact probabilities of a discrete variable's states, estimated, beside the answer's.

    scope: The variable alone.
    probabilities: The estimated ones, (steps, runs, states).
    """

    scope: tuple[Discrete]
    probabilities: Array

    @property
    def freedom(self) -> float:
        """The number of free probabilities."""
        return float(self.probabilities.shape[-1] - 1)

    def belief(self, lead: tuple[int, ...]) -> Table:
        """The estimated probabilities, its leading axes the runs, `lead`, then steps."""
        return Table._plain(self.scope, frozen(self._stacked(self.probabilities, lead)))


@dataclass(eq=False)
class StateSums:
    """Weighted sums of how often draws have each state of a discrete variable.

    variable : Discrete
    column : int
        The place of its state's index in a step's vector of draws.
    first : int
        The first step that has it.
    probabilities : ndarray
        (steps, runs, states): the answer's.
    judged : ndarray
        (steps,): whether the answer's belief at a step is given all measurements.
    """

    variable: Discrete
    column: int
    first: int
    probabilities: Array
    judged: Mask
    _sums: Array = field(init=False)

    def __post_init__(self) -> None:
        self._sums = np.zeros(self.probabilities.shape)

    def add(self, values: Array, pair: Array, fading: Array) -> None:
        """Add S draws for each run to the sums; as of `Sums.add`."""
        self._sums *= fading[:, None]
        for row, drawn in enumerate(values[self.first :]):
            for state in range(self.variable.size):
                has = drawn[..., self.column] == state
                self._sums[row, :, state] += np.where(has, pair[0], 0.0).sum(axis=-1)

    def compared(self, mixture: Mixture) -> ComparedStates:
        """The exact probabilities, from all draws, beside the answer's."""
        found = self._sums / self._sums.sum(axis=-1, keepdims=True)
        # A state that the answer excludes may have a probability that float64 cannot hold.
        known, own = np.maximum(found, _TINY), np.maximum(self.probabilities, _TINY)
        terms = found * (np.log(known) - np.log(own))
        return ComparedStates(
            scope=(self.variable,),
            steps=np.arange(self.first, self.first + len(own)),
            divergence=terms.sum(axis=-1),
            judged=self.judged,
            probabilities=found,
        )
