"""Sweeps of a single state variable over many steps at once, in plain numbers.

They go without the overhead of `StateChain` at each step: the weights p(z_t | x_t) of many steps, a
*part*, are laid out before, and beliefs are scaled once in a few steps. Where a belief, or a sum of
probabilities, comes near the smallest number of float64, a state may be *lost*, its probability
underflowing to zero, and the result is not used. The last step is T. A *vector* is a belief or a
message, (states, [runs]), whose last axis is there only if the user gave axes of runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import repeat
from typing import Any

import numpy as np

from pgm.beliefs.markov.chain import TINY, StateChain, smallest
from pgm.beliefs.markov.plan import TableSlices
from pgm.kernels import markov
from pgm.kernels.arrays import Array
from pgm.kernels.stochastic import Dense, Transition
from pgm.progress import counted

# With at most FEW states and at least MANY steps, blocks of steps are worked at side by side.
FEW, MANY = 16, 64
# The most entries of weights that are laid out at a time; of all of them, where blocks are made.
ROOM = 2**20
# With a fixed lag all windows are worked at together, if beliefs have at most so many times `ROOM`
# entries.
_WINDOWS = 16


class DirectChain(StateChain):
    """A hidden Markov chain of one state variable, whose messages are computed many steps at once.

    precise: Whether `run` was called, and has lost no state to underflow; if not, the chain must
        not be used.
    _latest: The part whose weights were asked for last, with these weights and their log-scales.
    """

    slices: TableSlices
    precise = False
    _latest: tuple[range, tuple[Array, Array]] | None = None

    # An impossible measurement, which makes 0/0, is found here and told by the chain step by step.
    @np.errstate(divide="ignore", invalid="ignore")
    def run(self) -> DirectChain:
        """Send the forward messages, keep them, set `precise`, and return the chain itself."""
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
                # The steps of a part, if it is the only one; else parts are counted.
                applies = counted(self._applies(part), "forward", len(part))
                totals, before = markov.forward(applies, weights, belief, own)
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
        """The sweeps in blocks of steps that are computed side by side; None if not worth it.

        Blocks are worth it if beliefs have no axis of runs, there are at most 16 states, at least
        64 steps, at most 2²⁰ entries of beliefs in all, and the transition is constant and dense.
        """
        steps, size = self.slices.steps, self.slices.plan.shape[0]
        if self.batch or size > FEW or steps < MANY or steps * size > ROOM:
            return None
        each = self._map(1)
        if self.slices.constant is None or not isinstance(each, Dense):
            return None
        weights, _ = self._weights(range(1, steps + 1))
        return markov.Blocks(each.matrix, weights, counted)

    @cached_property
    def _by_runs(self) -> bool:
        """Whether the runs of a state lie side by side in memory, not the states of a run.

        They do if beliefs have an axis of runs and the transition is a dense matrix, whose products
        with them are then faster.
        """
        return bool(self.batch) and isinstance(self._map(1), Dense)

    def room(self, like: Array) -> Array:
        """An array for a belief like this one at each step, (steps + 1, states, *runs).

        In memory the runs of a state lie side by side if `_by_runs`, else it is in C order.
        """
        return np.swapaxes(super().room(like.T), 1, 2) if self._by_runs else super().room(like)

    @cached_property
    def _parts(self) -> list[range]:
        """The steps 1..T in consecutive parts, each with at most 2²⁰ entries of weights (`ROOM`).

        A part has one step where a step's weights alone have more.
        """
        steps = self.slices.steps
        size = max(1, ROOM // max(1, self.known[0].size))
        return [range(at, min(at + size, steps + 1)) for at in range(1, steps + 1, size)]

    def _weights(self, part: range) -> tuple[Array, Array]:
        """The weights of some steps' measurements, (steps, states, [runs]), and their log-scales.

        The latest call is cached: the last part of the sweep forward is the first of that back.
        """
        if self._latest is None or self._latest[0] != part:
            self._latest = part, self.slices.weights_of(part)
        return self._latest[1]

    def _applies(self, part: Sequence[int], *, back: bool = False) -> Iterator[markov.Apply]:
        """For each step of a part, in its order, a function that applies the transition into it.

        Each is a function as `_apply` returns it: it multiplies a vector by the transition, or with
        `back` by its transpose, and puts the product into an array that it is given.
        """
        if self.slices.constant is not None:
            return repeat(self._apply(part[0], back), len(part))
        return (self._apply(step, back) for step in part)

    def _apply(self, step: int, back: bool) -> markov.Apply:
        """A function that multiplies vectors v by the transition into a step: Σ_x' p(x | x') v(x').

        With `back` the product is Σ_x p(x | x') v(x). The function takes a vector, (states,
        [runs]), and the array that the product is put into.
        """
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
        """The matrix of the transition into a step."""
        move: Any = self.slices.factors(step, self.slices.plan.onward)[0]
        found: Transition = move.maps[0][0]
        return found

    def smoothed_beliefs(self) -> Array | list[Array]:
        """The beliefs given all measurements, by step.

        Where numbers may lose a state they are made by `StateChain`, step by step.
        """
        known = np.asarray(self.known)
        found = self.room(known[0])  # which pickling may have laid out otherwise
        precise = all(_joined(found[rows], known[rows]) for rows in self._messages(found))
        return found if precise else super().smoothed_beliefs()

    def _messages(self, found: Array) -> Iterator[slice]:
        """Fill `found`, (steps + 1, states, [runs]), with the backward messages to all steps.

        They are made from the last step to the first. Yields ranges of steps, as Python slices
        along the first axis of `found`, whenever their messages are done. The caller may overwrite
        these messages, since no further one is made from them.
        """
        if self._blocks is not None:
            self._blocks.backward(found)
            yield slice(None)
            return
        found[-1] = 1.0
        for part in counted(self._parts[::-1], "back"):
            weights, _ = self._weights(part)
            applies = counted(self._applies(part[::-1], back=True), "back", len(part))
            markov.backward(applies, weights, found[part.start - 1 : part.stop])
            first = found[part.start - 1]  # scaled: a part may be too short for the sweep to do so
            total = first.sum(axis=0)
            first /= np.where(total > 0.0, total, 1.0)
            yield slice(part.start, part.stop)
        yield slice(0, 1)

    def lagged(self, lag: int) -> Iterator[tuple[int, Array]]:
        """The steps from 0 to T, and the belief of each given measurements up to a lag later.

        Where numbers may lose a state they are made by `StateChain`, step by step.
        """
        found = self._lagged(lag)
        yield from super().lagged(lag) if found is None else enumerate(found)

    def _lagged(self, lag: int) -> Array | None:
        """The fixed-lag beliefs of all steps, (steps + 1, states, [runs]), made side by side.

        None where the transition differs by step, the beliefs have more than 2²⁴ entries, or
        numbers may lose a state.
        """
        steps, each = self.slices.steps, self._map(1)
        if self.slices.constant is None or np.size(self.known) > ROOM * _WINDOWS:
            return None
        weights, _ = self.slices.weights_of(range(1, steps + 1))
        found = np.ones(np.shape(self.known))
        for ahead in counted(range(min(lag, steps), 0, -1), "back"):
            # Of the windows that do not reach beyond the last step.
            rows = found[: steps + 1 - ahead]
            rows[...] = each.backward(rows * weights[ahead - 1 :], 1)
            totals = markov.masses(rows)
            if not totals.min() > TINY:
                return None
            rows /= totals[:, None]
        return found if _joined(found, np.asarray(self.known)) else None


def _joined(messages: Array, known: Array) -> bool:
    """Make backward messages posteriors, in place: times filtered beliefs, divided by sums.

    Both are (steps, states, [runs]), the filtered beliefs `known`. Returns True; or False where
    numbers may lose a state, and then `messages` are not to be used.
    """
    if not markov.masses(messages).min() > TINY:
        return False
    messages *= known
    totals = markov.masses(messages)
    if not totals.min() > TINY:
        return False
    messages /= totals[:, None]
    return True
