"""Probabilities of states estimated from weighted draws, beside those of the answer."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import log, sqrt

import numpy as np

from pgm.factors import Table
from pgm.inference.audit.mixture import Mixture
from pgm.kernels.arrays import Array, Integers, Mask, frozen
from pgm.variables import Discrete

# The smallest probability that is told from none.
_TINY = 1e-300


@dataclass(frozen=True, eq=False)
class ComparedStates:
    """Exact probabilities of a discrete variable's states, estimated, beside the answer's.

    scope: The variable alone.
    steps: The steps at which it is compared.
    probabilities: The estimated ones, (steps, runs, states).
    divergence: KL(these ‖ the answer's) in nats, (steps, runs).
    judged: Marks the steps at which the answer's belief is given all measurements, (steps,).
    """

    scope: tuple[Discrete]
    steps: Integers
    probabilities: Array
    divergence: Array
    judged: Mask

    def excess(self, draws: Array) -> Array:
        """The largest divergence of a judged belief, less what chance explains, (runs,), in nats.

        It is as of `Compared.excess`, with as many degrees of freedom as free probabilities.
        """
        freedom, spread = self.probabilities.shape[-1] - 1, log(max(int(self.judged.sum()), 1))
        chance = (0.5 * freedom + sqrt(freedom * spread) + spread) / draws
        return np.asarray(self._known.max(axis=0, initial=0.0) - chance)

    @property
    def _known(self) -> Array:
        return np.where(self.judged[:, None], self.divergence, 0.0)

    def furthest(self, lead: tuple[int, ...]) -> tuple[float, str]:
        """The largest divergence of a judged belief, and its variable and run in words."""
        found = self._known
        if not found.size:
            return 0.0, ""
        step, run = np.unravel_index(int(found.argmax()), found.shape)
        where = ", ".join(str(k) for k in np.unravel_index(run, lead))
        named = self.scope[0].at(int(self.steps[step]))
        return float(found[step, run]), f"{named!r}{f' of run {where}' if lead else ''}"

    def belief(self, lead: tuple[int, ...]) -> Table:
        """The estimated probabilities, its leading axes the runs, `lead`, then steps."""
        whole = self.probabilities.swapaxes(0, 1)
        return Table._plain(self.scope, frozen(whole.reshape(*lead, *whole.shape[1:])))

    def divergences(self, lead: tuple[int, ...]) -> Array:
        """The divergence, (*lead, steps)."""
        return frozen(self.divergence.T.reshape(*lead, len(self.steps)))


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

    def add(self, values: list[Array], pair: Array, fading: Array) -> None:
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
        steps = np.arange(self.first, self.first + len(own))
        return ComparedStates((self.variable,), steps, found, terms.sum(axis=-1), self.judged)
