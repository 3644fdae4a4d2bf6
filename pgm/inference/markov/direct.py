"""Sweeps of a single state variable over many steps at once, in plain numbers.

The chain of `StateChain`, without its overhead at each step: weights of all measurements are laid
out before, and beliefs are scaled now and then. Where a belief, or a sum of probabilities, comes
near what float64 holds, the result is not used.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property, partial
from itertools import repeat
from typing import Any

import numpy as np

from pgm.inference.markov.chain import TINY, StateChain, smallest
from pgm.inference.markov.plan import TableSlices
from pgm.kernels import markov
from pgm.kernels.arrays import Array
from pgm.kernels.stochastic import Dense, Transition

# Up to so many states, and from so many steps on, blocks of steps are worked at together.
FEW, MANY = 16, 64
# Entries of weights that are laid out at a time, and of all of them where blocks are.
ROOM = 2**20


class DirectChain(StateChain):
    """The family of one chain, swept over many steps at once.

    Attributes
    ----------
    precise : bool
        Whether the forward sweep has lost no digits; else the chain is not to be used.
    """

    slices: TableSlices
    precise = False

    # An impossible measurement, which makes 0/0, is found here and told by the chain step by step.
    @np.errstate(divide="ignore", invalid="ignore")
    def run(self) -> DirectChain:
        """The same, its forward sweep done."""
        known, log_density = self.take(0, self.start())
        self.keep(0, known, known, log_density)
        rows, logs = np.asarray(self.known)[1:], self.log_density[1:]
        least, belief = smallest(known), known
        for part in self._parts:
            place = slice(part.start - 1, part.stop - 1)
            weights, scales = self.slices.weights_of(part)
            own = rows[place]
            if self._blocks is not None:
                before = self._blocks.forward(belief, own)
            else:
                before = markov.forward(self._applies(part), weights, belief, own)
            totals = own.sum(axis=1)
            if not totals.min() > TINY:
                return self
            logs[place] = np.log(totals / before) + scales
            least = min(least, smallest(own))
            own /= totals[:, None]
            belief = own[-1]
        self.precise = least >= TINY
        return self

    @cached_property
    def _blocks(self) -> markov.Blocks | None:
        """All steps in blocks, of one run of few states whose transition is the same at all."""
        steps, size = self.slices.steps, self.slices.plan.shape[0]
        if self.batch or size > FEW or steps < MANY or steps * size > ROOM:
            return None
        each = self._map(1)
        if self.slices.constant is None or not isinstance(each, Dense):
            return None
        weights, _ = self.slices.weights_of(range(1, steps + 1))
        return markov.Blocks(each.matrix, weights)

    @cached_property
    def _parts(self) -> list[range]:
        """The steps, in parts whose weights fit the room."""
        steps = self.slices.steps
        size = max(1, ROOM // max(1, self.known[0].size))
        return [range(at, min(at + size, steps + 1)) for at in range(1, steps + 1, size)]

    def _applies(self, part: Sequence[int], *, back: bool = False) -> Iterator[markov.Apply]:
        """The product by the transition into each step, or by its transpose."""
        if self.slices.constant is not None:
            return repeat(_apply(self._map(part[0]), back), len(part))
        return (_apply(self._map(step), back) for step in part)

    def _map(self, step: int) -> Transition:
        move: Any = self.slices.factors(step, "onward")[0]
        found: Transition = move.maps[0][0]
        return found

    def smoothed_beliefs(self) -> Array | list[Array]:
        """The beliefs given all measurements, by step."""
        found = np.empty(np.shape(self.known))
        if self._blocks is not None:
            self._blocks.backward(found)
        else:
            found[-1] = 1.0
            for part in reversed(self._parts):
                weights, _ = self.slices.weights_of(part)
                applies = self._applies(part[::-1], back=True)
                markov.backward(applies, weights, found[part.start - 1 : part.stop])
        if not found.sum(axis=1).min() > TINY:
            return super().smoothed_beliefs()
        found *= self.known
        totals = found.sum(axis=1)
        if not totals.min() > TINY:
            return super().smoothed_beliefs()
        found /= totals[:, None]
        return found


def _apply(transition: Transition, back: bool) -> markov.Apply:
    """The product of a matrix and a vector, into a place."""
    if isinstance(transition, Dense):
        return partial(np.dot, transition.matrix if back else transition.turned)
    moved = transition.backward if back else transition.forward
    return lambda vector, out: np.copyto(out, moved(vector))
