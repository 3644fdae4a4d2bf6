"""The windows of a fixed lag, each linearised again and again until its means settle.

The window of a step has the steps from `lag` before it on. It begins with the belief that the
window before has left at its second step, and is swept forward and back with CPDs as they were
linearised last, then linearised at the smoothed beliefs. What it leaves is kept in the arrays of
the whole chain, where later windows replace it.
"""

from __future__ import annotations

from typing import Any

from pgm.kernels import step
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.matrices.lines import Carried
from pgm.kernels.machine.sweeps import relinearising
from pgm.kernels.machine.sweeps.motion import predicted, transition
from pgm.kernels.machine.sweeps.reading import taken
from pgm.kernels.machine.sweeps.relinearising import Beliefs
from pgm.kernels.machine.sweeps.rounding import MODERATE, Rounding, hold, is_far
from pgm.kernels.machine.sweeps.settling import Settling, moved
from pgm.kernels.machine.sweeps.told import Windows, as_kept
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import Matrix, where

# The least share of a root on the way back.
_CORRELATED = 3e-5


def written(w: Writer, chain: Windows) -> Number:
    """Write all windows of the runs at hand; whether they are right, so far as can be told."""
    code = w.code
    prior = w.column(chain.ahead.begin[0]), w.symmetric(chain.ahead.begin[1])
    sure, before = code.varying(True), code.varying(0.0)
    with code.loop(w.last + 1) as newest:
        first = code.variable(newest - w.lag)
        with code.when(first.get() < 0):
            first.set(code.whole(0))
        window = _Window(w, chain, prior, first.get(), newest)
        window.begin()
        with code.when(first.get() > 0):
            # The window now begins with a step more, whose measurements the one before has had.
            with code.when(first.get() == 1):
                before.set(before.get() + w.at(chain.density, code.whole(0)).load(0))
            before.set(before.get() + w.at(chain.density, first.get()).load(0))
        window.settle()
        total = before.get() + window.density
        w.at(chain.log_evidence, newest).store(0, total)
        sure.set(sure.get() & window.sure & (abs(total) < float("inf")))
        code.leave_unless(code.some(sure.get()))
    return sure.get()


class _Window:
    """The window of the steps from `first` to `newest`."""

    def __init__(
        self, w: Writer, chain: Windows, prior: tuple[Matrix, Matrix], first: Whole, newest: Whole
    ) -> None:
        self._w, self._chain, self._prior = w, chain, prior
        self._first, self._newest = first, newest
        self._kept = as_kept(chain.ahead)
        self._gated = any(sensor.gate is not None for sensor in chain.ahead.sensors)
        code = w.code
        self._certain, self._sound = code.varying(True), code.varying(True)
        self._density, self._moved = code.varying(0.0), code.varying(0.0)

    @property
    def density(self) -> Number:
        """The log-density of the measurements that the window has taken in."""
        return self._density.get()

    @property
    def sure(self) -> Number:
        """Whether all is right that the window has left, so far as can be told."""
        return self._certain.get() & self._sound.get()

    def begin(self) -> None:
        """Linearise the newest step at the belief of a filter."""
        w, code, ahead = self._w, self._w.code, self._chain.ahead
        belief = Carried(code, *self._prior)
        with code.when(self._newest > 0):
            known = self._known(self._newest - 1)
            after = predicted(w, ahead, self._newest - 1, *known)
            belief.set(after.mean, after.cov)
            self._be_sure(after.sure)
        found = taken(w, ahead, self._newest, belief.mean, belief.cov)
        share = w.open_share(belief.cov)
        self._be_sure(found.sure & (share > MODERATE))

    def settle(self) -> None:
        """Smooth the window again and again, until its means settle."""
        w, code, chain = self._w, self._w.code, self._chain
        settling, count = Settling(w), code.variable(code.whole(1))
        with code.when(self._is_curved()):
            count.set(w.iterations)
        with code.loop(count.get()) as k:
            with code.when(k > 0):
                self._linearise(k, settling.settled)
            self._smooth()
            with code.when(k > 0):
                settling.note(k, self._moved.get(), w.true)
            code.leave_when(code.every(settling.settled))
            code.leave_unless(code.some(self.sure))
        with code.when(count.get() > 1):
            settling.close(count.get())
        for array, kept in zip(chain.newest, chain.smoothed, strict=True):
            matrix = w.matrix if len(kept.shape) > 1 else w.column
            w.keep(array, matrix(kept, self._newest), self._newest)

    def _is_curved(self) -> Number:
        """Whether a CPD of the window depends on where it is linearised."""
        w, ahead = self._w, self._chain.ahead
        found = w.code.constant(False).lane(0)
        if any(motion.curved for motion in ahead.motions):
            found = found | (self._newest > self._first)
        for sensor in ahead.sensors:
            if not sensor.curved and sensor.loss is None:
                continue
            begun = w.code.variable(self._first)
            with w.code.when(self._first > 0):
                begun.set(self._first + 1)
            if sensor.bounds is None:
                found = found | (begun.get() <= self._newest)
                continue
            rows = w.sightings(sensor, begun.get())[0], w.sightings(sensor, self._newest)[1]
            found = found | (rows[0] < rows[1])
        return found

    def _linearise(self, k: Whole, settled: Number) -> None:
        """Linearise all steps at the smoothed beliefs, or between them and those before."""
        w, code, chain = self._w, self._w.code, self._chain
        damping = where(k == 1, 0.0, w.settings.load(1))
        first, newest, point = self._first, self._newest, Beliefs(*chain.point)

        choice = w.matrices.chosen

        def follow(array: Any, found: Any, row: Whole, at: Whole) -> None:
            matrix = w.symmetric if len(array.shape) > 1 else w.column
            old, new = matrix(array, row), matrix(found, at)
            mixed = old.scaled(damping) + new.scaled(1.0 - damping)
            # What was there before the first iteration need not be a number.
            w.keep(array, choice(settled, old, choice(k == 1, new, mixed)), row)

        with code.loop(newest + 1, first) as at:
            row = at - first
            for array, found in zip(chain.point, chain.smoothed, strict=False):
                follow(array, found, row, at)
            with code.when(at > first):
                if point.joint is not None:
                    assert chain.joint is not None
                    follow(point.joint, chain.joint, row - 1, row - 1)
                self._be_sure(relinearising.move(w, chain.ahead, at - 1, point, row - 1))
            with code.when((at > first) | (first == 0)):
                self._be_sure(relinearising.read(w, chain.ahead, at, point, row))

    def _smooth(self) -> None:
        """Sweep forward and back with CPDs as they are linearised."""
        self._sound.set(True)
        self._density.set(0.0)
        self._moved.set(0.0)
        last = self._forward()
        self._backward(last)

    def _forward(self) -> Carried:
        w, code, chain = self._w, self._w.code, self._chain
        belief = Carried(code, *self._prior)
        with code.when(self._first > 0):
            belief.set(*self._known(self._first))
        start = code.variable(self._first)
        with code.when(self._first > 0):
            start.set(self._first + 1)
        with code.loop(self._newest + 1, start.get()) as at:
            with code.when(at > 0):
                after = predicted(w, self._kept, at - 1, belief.mean, belief.cov)
                belief.set(after.mean, after.cov)
                self._doubt(after.sure)
            mean, cov = belief.mean, belief.cov
            w.keep(chain.predicted[0], mean, at)
            w.keep(chain.predicted[1], cov, at)
            found = taken(w, self._kept, at, mean, cov, decided=self._gated)
            known, spread = found.moments.mean, found.moments.cov
            w.keep(chain.known[0], known, at)
            w.keep(chain.known[1], spread, at)
            w.at(chain.density, at).store(0, found.density)
            self._density.set(self._density.get() + found.density)
            self._doubt(found.sure & hold(w, cov, spread) & (w.open_share(spread) > MODERATE))
            self._doubt(~is_far(w, known, spread))
            belief.set(known, spread)
        return belief

    def _backward(self, last: Carried) -> None:
        w, code, chain = self._w, self._w.code, self._chain
        rounding = Rounding(w)
        self._leave(self._newest, last)
        with code.loop(self._newest, self._first, down=True) as at:
            own, states = self._known(at), chain.ahead.states
            mean, cov = own[0].part(states, (0,)), own[1].part(states, states)
            moves = transition(w, self._kept, at)
            after = w.column(chain.predicted[0], at + 1), w.symmetric(chain.predicted[1], at + 1)
            back = step.reverse(mean, cov, *moves, *after)
            moments = step.push(last.mean, last.cov, *back[:3])
            if chain.joint is not None:
                across = back.gain @ last.cov
                w.keep(chain.joint, moments[1].bordered(across.T, last.cov), at - self._first)
            sure = back.root.share > _CORRELATED
            if len(states) < chain.ahead.size:
                moments, certain = _with_controls(states, own, moments)
                sure = sure & certain
            self._doubt(sure & rounding.counts_not(own[1], after[1], back.root, moments[1]))
            last.set(*moments)
            self._leave(at, last)

    def _leave(self, at: Whole, found: Carried) -> None:
        """Keep a smoothed belief, and note how far it is from where CPDs were linearised."""
        w, chain = self._w, self._chain
        mean, cov = found.mean, found.cov
        w.keep(chain.smoothed[0], mean, at)
        w.keep(chain.smoothed[1], cov, at)
        far = moved(w, mean, cov, w.column(chain.point[0], at - self._first))
        self._moved.set(where(self._moved.get() > far, self._moved.get(), far))

    def _known(self, at: Whole) -> tuple[Matrix, Matrix]:
        """The belief at a step given the measurements up to there."""
        known = self._chain.known
        return self._w.column(known[0], at), self._w.symmetric(known[1], at)

    def _be_sure(self, sure: Number) -> None:
        """Note that all iterations are right only if this is."""
        self._certain.set(self._certain.get() & sure)

    def _doubt(self, sure: Number) -> None:
        """Note that the last solution is right only if this is."""
        self._sound.set(self._sound.get() & sure)


def _with_controls(
    states: tuple[int, ...], own: tuple[Matrix, Matrix], after: tuple[Matrix, Matrix]
) -> tuple[tuple[Matrix, Matrix], Number]:
    """A smoothed slice, from its own belief and its smoothed states; and whether that is right.

    The controls follow from the states by their regression.
    """
    mean, cov = own
    size = range(cov.shape[0])
    rest = [k for k in size if k not in states]
    root = cov.part(states, states).root()
    gain = step.gain(root, cov.part(states, rest))
    rows: list[Any] = [None] * len(size)
    for i, k in enumerate(states):
        rows[k] = [1.0 if j == i else 0.0 for j in range(len(states))]
    for i, k in enumerate(rest):
        rows[k] = gain.rows[i]
    matrix = Matrix(rows)
    offset = mean - matrix @ mean.part(states, (0,))
    # What is left of the controls given the states, E picking the states.
    picks = Matrix([[1.0 if j == k else 0.0 for j in size] for k in states])
    nothing = Matrix([[0.0] * len(states)] * len(states))
    own_cov = step.squares(cov, matrix, picks, nothing)
    return step.push(*after, matrix, offset, own_cov), root.share > MODERATE
