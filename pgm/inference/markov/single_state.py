"""Sweeps of a single state variable over many steps at once, in plain numbers.

They go without the overhead of `StateChain` at each step: all weights are laid out before, and
beliefs scaled now and then. Where a belief, or a sum of probabilities, comes near what float64
holds, the result is not used.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import repeat
from typing import Any

import numpy as np

from pgm.inference.markov.chain import TINY, StateChain, smallest
from pgm.inference.markov.plan import TableSlices
from pgm.kernels import markov
from pgm.kernels.arrays import Array
from pgm.kernels.stochastic import Dense, Transition
from pgm.progress import counted

# Up to so many states, and from so many steps on, blocks of steps are worked at together.
FEW, MANY = 16, 64
# Entries of weights that are laid out at a time, and of all of them where blocks are.
ROOM = 2**20
# Of a fixed lag all windows are worked at together, up to so many times as many entries.
_WINDOWS = 16


class DirectChain(StateChain):
    """A hidden Markov chain of one state variable, whose messages are computed many steps at once.

    precise: Whether the forward sweep has lost no digits; else the chain is not to be used.
    """

    slices: TableSlices
    precise = False
    _latest: tuple[range, tuple[Array, Array]] | None = None

    # An impossible measurement, which makes 0/0, is found here and told by the chain step by step.
    @np.errstate(divide="ignore", invalid="ignore")
    def run(self) -> DirectChain:
        """See `StateChain`."""
        known, log_density = self.take(0, self.start())
        self.keep(0, known, known, log_density)
        rows, logs = np.asarray(self.known)[1:], self.log_density[1:]
        least, belief = smallest(known), known
        for part in counted(self._parts, "forward"):
            place = slice(part.start - 1, part.stop - 1)
            weights, scales = self._weights(part)
            own = rows[place]
            if self._blocks is not None:
                totals, before = self._blocks.forward(belief, own)
            else:
                totals, before = markov.forward(self._applies(part), weights, belief, own)
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
        """All steps in blocks; for one run of few states with a constant transition."""
        steps, size = self.slices.steps, self.slices.plan.shape[0]
        if self.batch or size > FEW or steps < MANY or steps * size > ROOM:
            return None
        each = self._map(1)
        if self.slices.constant is None or not isinstance(each, Dense):
            return None
        weights, _ = self._weights(range(1, steps + 1))
        return markov.Blocks(each.matrix, weights)

    @cached_property
    def _by_runs(self) -> bool:
        """Whether beliefs lie by runs in memory, along which products by dense matrices go."""
        return bool(self.batch) and isinstance(self._map(1), Dense)

    def room(self, like: Array) -> Array:
        """See `StateChain`."""
        return np.swapaxes(super().room(like.T), 1, 2) if self._by_runs else super().room(like)

    @cached_property
    def _parts(self) -> list[range]:
        """The steps in parts whose weights fit the room."""
        steps = self.slices.steps
        size = max(1, ROOM // max(1, self.known[0].size))
        return [range(at, min(at + size, steps + 1)) for at in range(1, steps + 1, size)]

    def _weights(self, part: range) -> tuple[Array, Array]:
        """The likelihood weights of some steps and their log-scales; the latest call is cached.

        The last part of the sweep forward is the first of that back.
        """
        if self._latest is None or self._latest[0] != part:
            self._latest = part, self.slices.weights_of(part)
        return self._latest[1]

    def _applies(self, part: Sequence[int], *, back: bool = False) -> Iterator[markov.Apply]:
        """The products by the transition into each step of a part, or by its transpose."""
        if self.slices.constant is not None:
            return repeat(self._apply(part[0], back), len(part))
        return (self._apply(step, back) for step in part)

    def _apply(self, step: int, back: bool) -> markov.Apply:
        """The product of a vector with the transition into a step, or its transpose."""
        transition = self._map(step)
        if not isinstance(transition, Dense):
            moved = transition.backward if back else transition.forward
            return lambda vector, out: np.copyto(out, moved(vector))
        # Products along columns are faster by a tenth: over many steps this pays for a transpose.
        worth = self.slices.constant is not None and self.slices.steps >= transition.shape[0]
        if not back:
            matrix = transition.matrix
        else:
            matrix = transition.turned if worth else transition.matrix.T
        if self._by_runs:
            return lambda vector, out: vector.T.dot(matrix, out.T)
        return matrix.T.dot

    def _map(self, step: int) -> Transition:
        """The transition into a step."""
        move: Any = self.slices.factors(step, "onward")[0]
        found: Transition = move.maps[0][0]
        return found

    def smoothed_beliefs(self) -> Array | list[Array]:
        """See `StateChain`."""
        found, known = np.empty_like(self.known), np.asarray(self.known)
        precise = all(_joined(found[rows], known[rows]) for rows in self._messages(found))
        return found if precise else super().smoothed_beliefs()

    def _messages(self, found: Array) -> Iterator[slice]:
        """Fill rows with the messages to all steps, last to first; rows no message is made from."""
        if self._blocks is not None:
            self._blocks.backward(found)
            yield slice(None)
            return
        found[-1] = 1.0
        for part in reversed(self._parts):
            weights, _ = self._weights(part)
            applies = self._applies(part[::-1], back=True)
            markov.backward(applies, weights, found[part.start - 1 : part.stop])
            first = found[part.start - 1]  # scaled: a part may be too short for the sweep to do so
            total = first.sum(axis=0)
            first /= np.where(total > 0.0, total, 1.0)
            yield slice(part.start, part.stop)
        yield slice(0, 1)

    def lagged(self, lag: int) -> Iterator[tuple[int, Array]]:
        """See `StateChain`."""
        found = self._lagged(lag)
        yield from super().lagged(lag) if found is None else enumerate(found)

    def _lagged(self, lag: int) -> Array | None:
        """The fixed-lag beliefs of all steps; all windows' backward passes run side by side.

        None where the transition differs from step to step, or digits are lost.
        """
        steps, each = self.slices.steps, self._map(1)
        if self.slices.constant is None or np.size(self.known) > ROOM * _WINDOWS:
            return None
        weights, _ = self.slices.weights_of(range(1, steps + 1))
        found = np.ones(np.shape(self.known))
        for ahead in range(min(lag, steps), 0, -1):
            # Of the windows that do not reach beyond the last step.
            rows = found[: steps + 1 - ahead]
            rows[...] = each.backward(rows * weights[ahead - 1 :], 1)
            totals = markov.masses(rows)
            if not totals.min() > TINY:
                return None
            rows /= totals[:, None]
        return found if _joined(found, np.asarray(self.known)) else None


def _joined(messages: Array, known: Array) -> bool:
    """Multiply backward messages by filtered beliefs and normalise; False if one underflows."""
    if not markov.masses(messages).min() > TINY:
        return False
    messages *= known
    totals = markov.masses(messages)
    if not totals.min() > TINY:
        return False
    messages /= totals[:, None]
    return True
