"""Mixtures of Gaussians swept forward: pairs of a Gaussian and a regime, merged at each step.

Hypotheses are runs, one after another; see `told.Mixture`. What the NumPy passes do with arrays of
hypotheses is done here in loops over them, by the same formulas (`kernels.merging`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.motion import predicted
from pgm.kernels.machine.sweeps.reading import taken
from pgm.kernels.machine.sweeps.told import Array, Mixture
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import log, most, where

# A number from which on little or nothing can be told.
_LARGEST = 1e150
_NONE = float("-inf")


def written(w: Writer, chain: Mixture) -> Number:
    """Write the sweep of the run at hand; whether it is right, so far as can be told."""
    return _Mixture(w, chain).written()


class _Merged(NamedTuple):
    """A merged Gaussian: its log-weight, its mean, and the lower half of its covariance."""

    log: Number
    mean: list[Number]
    cov: list[list[Number]]


class _Mixture:
    """The sweep of a user's run, at which the writer stands."""

    def __init__(self, w: Writer, chain: Mixture) -> None:
        self._w, self._chain, self._size = w, chain, chain.ahead.size
        self._own, self._run = w.numbers[chain.own_runs], w.run
        self._count, self._kept = len(chain.memories), max(chain.memories) + 1
        self._sure = w.code.varying(True)

    def written(self) -> Number:
        """Write the sweep; whether it is right, so far as can be told."""
        w, code = self._w, self._w.code
        with code.loop(w.last + 1) as at, w.matrices.scratch():
            copies = code.variable(code.whole(1))
            with code.when(at > 0):
                if self._chain.mixed:
                    self._mix(at)
                else:
                    copies.set(code.whole(self._kept))
                self._predict(at, copies.get())
            self._take(at, copies.get())
            self._merge(at, copies.get())
            code.leave_unless(self._sure.get())
        w.run = self._run
        return self._sure.get()

    def _at(self, array: Array, number: Whole | int | None, row: Whole | None = None) -> Memory:
        """The cells of an array, of a hypothesis of the user's run; None for the run's own."""
        self._stand_at(number)
        return self._w.at(array, row)

    def _stand_at(self, number: Whole | int | None) -> None:
        """Go to a hypothesis of the user's run, of which the writer's arrays then are."""
        self._w.run = self._run if number is None else self._run + self._own * number

    def _doubt(self, sure: Number) -> None:
        self._sure.set(self._sure.get() & sure)

    def _onward(self, at: Whole, pair: Whole) -> Number:
        """Ln p(regime | memory before it) of a pair."""
        return self._at(self._chain.onward, None, at - 1).load(pair)

    def _mix(self, at: Whole) -> None:
        """The Gaussians of the step before, mixed for each regime, and their log-weights."""
        chain, code = self._chain, self._w.code
        for regime in range(self._count):

            def log_of(k: Whole, regime: int = regime) -> Number:
                before = self._at(chain.logs, k, at - 1).load(0)
                return before + self._onward(at, k * self._count + regime)

            known = chain.mean, chain.cov, at - 1
            mixed = self._merged(log_of, code.whole(self._kept), (0,), 1, *known)
            self._put(*chain.ahead.begin, regime, None, mixed)
            self._at(chain.pairs, regime).store(0, mixed.log)

    def _predict(self, at: Whole, copies: Whole) -> None:
        """The pairs of a step: predicted moments, and log-weights."""
        w, chain = self._w, self._chain

        def body(k: Whole, pair: Whole, _: Whole) -> None:
            if chain.mixed:
                log_weight = self._at(chain.pairs, pair).load(0)
                mean, cov = w.column(chain.ahead.begin[0]), w.symmetric(chain.ahead.begin[1])
            else:
                log_weight = self._at(chain.logs, k, at - 1).load(0) + self._onward(at, pair)
                self._stand_at(k)
                mean, cov = w.column(chain.mean, at - 1), w.symmetric(chain.cov, at - 1)
            cells = self._at(chain.pairs, pair)
            moved = predicted(w, chain.ahead, at - 1, mean, cov)
            cells.store(0, log_weight)
            w.keep(chain.ahead.begin[0], moved.mean)
            w.keep(chain.ahead.begin[1], moved.cov)
            self._doubt(moved.sure | ~(log_weight > _NONE))

        self._each(copies, body)

    def _take(self, at: Whole, copies: Whole) -> None:
        """The pairs given the measurements of a step."""
        w, chain = self._w, self._chain

        def body(_: Whole, pair: Whole, regime: Whole) -> None:
            likelihood = self._at(chain.likelihood, None, at).load(regime)
            cells = self._at(chain.pairs, pair)
            mean, cov = w.column(chain.ahead.begin[0]), w.symmetric(chain.ahead.begin[1])
            found = taken(w, chain.ahead, at, mean, cov)
            known, spread = found.moments.mean, found.moments.cov
            numbers = [abs(x) for vector in (mean, known) for x in w.matrices.beside(vector)]
            numbers += [x for each in (cov, spread) for x in w.matrices.diagonal(each)]
            total = found.density + w.sum(numbers)
            log_weight = cells.load(0) + likelihood + found.density
            cells.store(0, log_weight)
            w.keep(chain.ahead.known[0], known)
            w.keep(chain.ahead.known[1], spread)
            dead = ~(log_weight > _NONE) & ~(log_weight != log_weight)
            self._doubt((found.sure & (abs(total) < _LARGEST)) | dead)

        self._each(copies, body)

    def _merge(self, at: Whole, copies: Whole) -> None:
        """The Gaussians of a step, of the pairs of each memory, and the regimes' probabilities."""
        w, chain = self._w, self._chain
        every = range(self._count)

        def log_of(pair: Whole) -> Number:
            return self._at(chain.pairs, pair).load(0)

        total = self._log_sum(log_of, copies, every)
        self._doubt(total > _NONE)
        self._at(chain.density, None, at).store(0, total)
        for regime in every:
            own = self._log_sum(log_of, copies, (regime,))
            self._at(chain.regimes, regime, at).store(0, own - total)
        for memory in range(self._kept):
            places = [s for s in every if chain.memories[s] == memory]
            known = *chain.ahead.known, None
            merged = self._merged(log_of, copies, places, self._count, *known)
            self._put(chain.mean, chain.cov, memory, at, merged)
            self._at(chain.logs, memory, at).store(0, merged.log - total)
            numbers = [abs(x) for x in merged.mean] + [merged.cov[i][i] for i in range(self._size)]
            self._doubt(w.sum(numbers) < _LARGEST)

    def _each(self, copies: Whole, body: Callable[[Whole, Whole, Whole], None]) -> None:
        """Code for each pair: for the Gaussian before it, its own number, and its regime."""
        w = self._w
        count = w.code.whole(self._count)
        with w.code.loop(copies) as k, w.code.loop(count) as regime, w.matrices.scratch():
            body(k, k * self._count + regime, regime)

    def _over(
        self, copies: Whole, places: Sequence[int], stride: int, body: Callable[[Whole], None]
    ) -> None:
        """Code for the members number k stride + place, for k below `copies`."""
        with self._w.code.loop(copies) as k:
            for place in places:
                body(k * stride + place)

    def _log_sum(
        self, log_of: Callable[[Whole], Number], copies: Whole, places: Sequence[int]
    ) -> Number:
        """The logarithm of a sum of weights of pairs."""
        top, total = self._top(log_of, copies, places, self._count), self._w.code.varying(0.0)
        base = where(top > _NONE, top, 0.0)
        self._over(
            copies,
            places,
            self._count,
            lambda k: total.set(total.get() + (log_of(k) - base).apply("exp")),
        )
        found: Number = base + log(total.get())
        return found

    def _top(
        self, log_of: Callable[[Whole], Number], copies: Whole, places: Sequence[int], stride: int
    ) -> Number:
        """The largest of some log-weights."""
        top = self._w.code.varying(_NONE)
        self._over(copies, places, stride, lambda k: top.set(most(top.get(), log_of(k))))
        return top.get()

    def _merged(
        self,
        log_of: Callable[[Whole], Number],
        copies: Whole,
        places: Sequence[int],
        stride: int,
        mean: Array,
        cov: Array,
        row: Whole | None,
    ) -> _Merged:
        """Members merged, as of `kernels.merging.merged`; equal ones where all are dead."""
        code, size = self._w.code, range(self._size)
        top = self._top(log_of, copies, places, stride)
        some = top > _NONE
        base, total = where(some, top, 0.0), code.varying(0.0)
        centre = [code.varying(0.0) for _ in size]
        spread = [[code.varying(0.0) for _ in range(i + 1)] for i in size]

        def share(k: Whole) -> Number:
            found: Number = where(some, (log_of(k) - base).apply("exp"), 1.0)
            return found

        def add_mean(k: Whole) -> None:
            own = share(k)
            cells = self._at(mean, k, row)
            total.set(total.get() + own)
            for i, each in enumerate(centre):
                each.set(each.get() + own * cells.load(i))

        def add_cov(k: Whole) -> None:
            own = share(k) / total.get()
            cells = self._at(mean, k, row)
            away = [cells.load(i) - each.get() for i, each in enumerate(centre)]
            cells = self._at(cov, k, row)
            for i, line in enumerate(spread):
                for j, each in enumerate(line):
                    part = cells.load(i * self._size + j) + away[i] * away[j]
                    each.set(each.get() + own * part)

        self._over(copies, places, stride, add_mean)
        for each in centre:
            each.set(each.get() / total.get())
        self._over(copies, places, stride, add_cov)
        return _Merged(
            where(some, base + log(total.get()), _NONE),
            [each.get() for each in centre],
            [[each.get() for each in line] for line in spread],
        )

    def _put(
        self, mean: Array, cov: Array, number: Whole | int, row: Whole | None, merged: _Merged
    ) -> None:
        """Keep a merged Gaussian's moments."""
        size = range(self._size)
        cells = self._at(mean, number, row)
        for i in size:
            cells.store(i, merged.mean[i])
        cells = self._at(cov, number, row)
        for i in size:
            for j in size:
                cells.store(i * self._size + j, merged.cov[max(i, j)][min(i, j)])
