"""Traces judged by their answers: the function itself is asked where a call evaluated its trace.

A trace is wrong where its function has changed since it was made, or where the function decides by
numbers that tracing cannot follow, as in a comparison on a float copy of its input. No look at the
function's code shows all of that; its values do. So after a call the function is called once more,
in batches, at the points at which the call evaluated the trace. Where derivatives were used it is
called a hundredth of a deviation beside them, too: of 2 x and x / 2 the values at 0 are alike. And
derivatives are looked at by themselves (`slopes`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Any

import numpy as np

from pgm.errors import PgmError
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Integers, components_last, quiet
from pgm.tracing.clearing import Standing
from pgm.tracing.measures import EVEN, OF_LARGEST, OF_VALUE, VALUES_OF_NOISE
from pgm.tracing.program import Column, Program
from pgm.tracing.slopes import Points, beside, choice, shown
from pgm.tracing.trace import Tracer

# From so many points on, a trace is made anew at each call. Then about so many values are judged,
# and the slopes of so many points are looked at, or so many entries of slopes.
LARGE, _VALUES, _SLOPES, _ENTRIES = 2**12, 2**10, 2**13, 2**17
# So many points are judged at a time.
_BATCH = 4096

# The states of some traces, by their tracers.
_States = dict[Tracer, dict[str, Any]]


class Answers:
    """The values and slopes that one trace gave in one call.

    Parameters
    ----------
    tracer : Tracer
        Has a trace.
    columns : sequence of (int, int)
        The arguments, and components of them, by which derivatives are asked for, n of them.
    places : sequence of int
        Their places among the stacked hidden parents, of which the covariances of beliefs are.
    variances : sequence of float
        The least variance of the noise of each component of the value that is differentiated: its
        first ones, (d,).
    """

    def __init__(
        self,
        tracer: Tracer,
        columns: tuple[Column, ...],
        places: Sequence[int],
        variances: Sequence[float],
    ) -> None:
        assert tracer.trace is not None
        self.tracer, self.trace = tracer, tracer.trace
        self.program = self.trace.by(columns, len(variances))
        self.slopes = tracer.slopes(self.program, tuple(variances))
        self.fault: str | None = None
        # Whether a value was wrong, as where the function has changed; whether there were any.
        self.moved, self.used = False, False
        # Of so many points one is looked at, and of so many of these the value is judged.
        self.every = self.thin = 1
        self._open, self._passed = True, 0
        self.places, self._noise = list(places), self.slopes.noise
        # Of single evaluations: arguments, value and derivative, covariance.
        self._asked: list[list[float]] = []
        self._told: list[tuple[float, ...]] = []
        self._covs: list[Array | None] = []
        # Of batches; how many points they have.
        self._batches: list[Points] = []
        self._count = 0
        # Where machine code evaluated: arguments, and deviations if derivatives were used.
        self._swept: list[tuple[Array, Array | None]] = []
        # Points whose slopes are held against differences, and their doubts.
        self._chosen: list[tuple[Points, Array]] = []

    def single(self, arguments: Sequence[Array], cov: Array | None) -> tuple[Array, Array, bool]:
        """Evaluate at (width,) each: the value (d,), the derivative (d, n), whether it is finite.

        `cov` is the covariance of the belief over the stacked hidden parents.
        """
        height, asked = len(self.program.value), [c for each in arguments for c in each.tolist()]
        told = self.program.numbers(asked)
        if told is None:  # where NumPy has infinities and NaNs
            value, slope = self.program.batch(arguments, ())
            return value, slope, bool(np.isfinite(value).all() and np.isfinite(slope).all())
        finite = math.isfinite(sum(told))
        self._passed += 1
        if finite and self._open and self._passed % self.every == 0:
            self._asked.append(asked)
            self._told.append(told)
            self._covs.append(cov)
            if len(self._asked) == _BATCH:
                self._look_back()
        every = np.array(told, dtype=float)
        return every[:height], every[height:].reshape(height, -1), finite

    def batch(
        self, arguments: Sequence[Array], shape: tuple[int, ...], std: Array | None
    ) -> tuple[Array, Array]:
        """Evaluate at (*shape, width) each: the value (d, *shape), the derivative (d, n, *shape).

        `std` are the deviations of the belief over the stacked hidden parents, (*lead, size), with
        leading axes of the shape.
        """
        value, slope = self.program.batch(arguments, shape)
        if self._open and self.fault is None:
            # Of batch after batch other points, such as other runs of the steps of a filter.
            first = -self._passed % self.every
            self._passed += math.prod(shape)
            own = None if std is None else std[..., self.places]
            chosen = slice(first, None, self.every)
            points = Points.of_batch(shape, arguments, value, slope, own, chosen)
            self._batches.append(points)
            self._count += len(points.arguments)
            if self._count >= _BATCH:
                self._look_back()
        return value, slope

    def sample(self, count: int, thinned: int = 1) -> Integers:
        """The numbers of the points of a call that are looked at: all, or some of very many.

        Of a call that is `thinned` they are numbers among those points, one of so many, that stay.
        """
        if thinned == 1:
            return np.arange(self.every // 2, count, self.every)
        most = min(count * thinned // self.every, count)
        return (2 * np.arange(most) + 1) * count // (2 * max(most, 1))

    def judge(self, arguments: Sequence[Array], std: Array | None) -> None:
        """Judge the trace at points (k, width) of each argument, where machine code evaluated it.

        `std` (k, size) are the deviations of beliefs over the stacked hidden parents; None where no
        derivative was used, and the points are those whose values are judged.
        """
        if not self._open or self.fault is not None:
            return
        flat = np.concatenate(arguments, axis=-1)
        for first in range(0, len(flat), _BATCH):
            rows = slice(first, first + _BATCH)
            self._swept.append((flat[rows], None if std is None else std[rows, self.places]))
            self._count += len(self._swept[-1][0])
            if self._count >= _BATCH:
                self._look_back()

    def clear(self, points: Standing) -> bool:
        """Clear the trace at points where machine code evaluated it, if that can be done at once.

        Its derivatives were used there. Machine code is made for a trace that calls have often
        found right, as there may be many more.
        """
        if not self._open or self.fault is not None:
            return True
        if not self.tracer.often or self.every > 1:
            return False
        clearing = self.slopes.clearing(self.trace, differentiated=True)
        if clearing is None or not clearing.clears(points):
            return False
        self.used = True
        return True

    def close(self) -> None:
        """Judge all that has been kept, and keep nothing more."""
        if self._open:
            self._look_back(last=True)
        self._open, self._chosen = False, []

    def _look_back(self, *, last: bool = False) -> None:
        """Judge what has been kept since this was done last; at the `last` slopes as well."""
        if last and self._is_cleared():
            self.used = True
            return
        parts, alone = self._batches, list[Array]()
        if self._asked:
            told, height = np.array(self._told, dtype=float), len(self.program.value)
            slope = told[:, height:].reshape(len(told), height, -1)
            deviations = np.array([self._deviations(cov) for cov in self._covs])
            parts.append(Points(np.array(self._asked), told[:, :height], slope, deviations))
        for flat, std in self._swept:
            if std is None:
                alone.append(flat)
            elif len(flat):
                parts.append(self._points(flat, std))
        self._asked, self._told, self._covs = [], [], []
        self._batches, self._swept, self._count = [], [], 0
        if self.fault is None and (parts or alone or (last and self._chosen)):
            self._look(Points.joined(parts) if parts else None, alone, last=last)

    def _is_cleared(self) -> bool:
        """Whether machine code clears all that has been kept.

        It is made for a trace that calls have often found right, as there may be many more.
        """
        swept, fresh = self._swept, not (self._batches or self._asked or self._chosen)
        if not swept or not fresh or self.fault is not None or not self.tracer.often:
            return False
        flats, stds = zip(*swept, strict=True)
        alone = stds[0] is None
        if any((std is None) is not alone for std in stds) or not all(map(len, flats)):
            return False
        clearing = self.slopes.clearing(self.trace, differentiated=not alone)
        if clearing is None or self.thin > 1:
            return False
        flat = flats[0] if len(flats) == 1 else np.concatenate(flats)
        return clearing.clears(Standing.of(flat, None if alone else np.concatenate(stds)))

    def _points(self, flat: Array, std: Array) -> Points:
        """Points at which machine code evaluated the trace, as it evaluates here."""
        shape = (len(flat),)
        if self.program.smooth:  # whose slopes are not looked at
            steep = np.broadcast_to(0.0, (*shape, len(self._noise), len(self.places)))
            return Points(flat, self._values(flat), steep, std)
        value, slope = self.program.batch(self.slopes.apart(flat), shape)
        told = (
            self._values(flat) if len(self.trace.value) > len(value) else components_last(value, 1)
        )
        return Points(flat, told, components_last(slope, 2), std)

    def _values(self, flat: Array) -> Array:
        """The trace's values (k, d), followed by derivatives that were given."""
        return components_last(self.trace.batch(self.slopes.apart(flat), (len(flat),))[0], 1)

    def _deviations(self, cov: Array | None) -> Array:
        if cov is None:
            return np.full(len(self.places), np.nan)
        return np.sqrt(np.maximum(cov.diagonal()[self.places], 0.0))

    def _look(self, points: Points | None, alone: Sequence[Array], *, last: bool) -> None:
        """Look at points, and at others `alone`, whose values were used, at the `last` at slopes.

        The function is asked for all of this at once. Values beside points show slopes; where the
        function fails there, it need not show them.
        """
        asked, told = list(alone), [self._values(flat) for flat in alone]
        first = len(asked)
        if points is not None:
            some = points.at(slice(None, None, self.thin))
            asked.append(some.arguments)
            told.append(some.value)
            first += 1
            if self.places:
                asked.append(self._beside(some))
                told.append(self._values(asked[-1]))
            if self.places and not self.program.smooth:
                doubts = self.slopes.doubts(points)
                chosen = _chosen(doubts)
                self._chosen.append((points.at(chosen), doubts[chosen]))
        differed = None
        if last and self._chosen:
            every = Points.joined([each for each, _ in self._chosen])
            chosen = _chosen(np.concatenate([doubts for _, doubts in self._chosen]))
            differed = self.slopes.differed(every.at(chosen))
            asked.append(differed.points)
        due = self.slopes.functions(asked)
        self.used = self.used or first > 0
        for k, (where, answers) in enumerate(zip(asked, told, strict=False)):
            values = due[k]
            if values is not None and values.shape == answers.shape:
                self._hold(where, answers, values)
            elif k < first:
                self.fault = (
                    "its function fails on a batch of the points at which its trace was used"
                )
                self.moved = True
            if self.fault is not None:
                return
        if differed is not None:
            self.fault = differed.fault(due[-1])

    def _beside(self, points: Points) -> Array:
        """Points beside some, at which slopes show in values."""
        flat, columns = points.arguments.copy(), self.slopes.columns
        flat[:, columns] = beside(flat[:, columns], points.std)
        return flat

    def _hold(self, flat: Array, told: Array, due: Array) -> None:
        """A trace's values `told`, (k, d), unlike the function's are a fault."""
        with quiet():
            error = np.abs(difference(due, told, self.tracer.angles))
            known = np.isfinite(due)
            scale = np.where(known, np.abs(due), 0.0).max(axis=0, initial=0.0)
            height = len(self._noise)
            # Given derivatives, which may follow, have one scale: some are zero but for rounding.
            scale[height:] = scale[height:].max(initial=0.0)
            least = OF_LARGEST * np.maximum(scale, self.tracer.angles)
            least[:height] += VALUES_OF_NOISE * self._noise
            least = least + OF_VALUE * np.abs(due)
            wrong = np.where(known, ~(error <= least), np.isfinite(told)).any(axis=-1)
        if wrong.any():
            row, self.moved = int(wrong.argmax()), True
            self.fault = (
                f"at {shown(flat[row])} its value is {shown(due[row])}, its trace's "
                f"{shown(told[row])}: it decides by numbers that no trace can follow, such as "
                "copies of its input by np.asarray(x, dtype=float), or it has a memory, draws at "
                "random, or changed during the call"
            )


class Judge:
    """The traces that one call uses; without trust, it uses none.

    A call is a block of its judge, ``with judge:``, at the end of which the traces are judged. An
    error of the block that may be one of wrong traces goes no further; `right` is then False. Any
    other is that of the call, which then leaves the traces that it gives up as they were: they may
    have been asked for numbers beyond float64, and the next call need not do without them. `before`
    has the states of traces that this call has given up, by their tracers; all judges of a call
    share it.
    """

    def __init__(self, *, trusting: bool = True, before: _States | None = None) -> None:
        self.trusting, self.right = trusting, True
        self.answers: list[Answers] = []
        self._before: _States = {} if before is None else before

    def __enter__(self) -> Judge:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> bool:
        if error is not None and not isinstance(error, PgmError):
            return False
        self.right = self.passes()
        if error is not None and self.right:
            for tracer, state in self._before.items():
                if tracer.trace is None:
                    tracer.put_back(state)
        return not self.right

    def asked(
        self,
        tracer: Tracer,
        centres: Sequence[Array],
        columns: tuple[Column, ...],
        places: Sequence[int],
        variances: Sequence[float],
        count: int,
        alone: Tracer | None = None,
    ) -> Answers | None:
        """A tracer's answers in this call, for about as many points; None without a trace.

        A trace is made, if there is none, and compared with its function about the centres. `alone`
        is the tracer of a function without the derivatives that were given, if `tracer` has these,
        too: they may make floats, as by writing into np.zeros, and hide no decision. The other
        arguments are as of `Answers`.
        """
        large = count >= LARGE
        if not self.trusting or not tracer.confirm(centres, anew=large):
            return None
        found = Answers(tracer, columns, places, variances)
        # A sample suffices where a trace is new and shows all that its function does.
        own: Program | str = found.trace
        if large and alone is not None:
            own = alone.trace or alone.traced()
        if large and not (isinstance(own, str) or own.cast):
            most = _VALUES
            if found.program.slope and not found.program.smooth:  # whose slopes are looked at
                most = min(max(_ENTRIES // len(found.program.slope), EVEN), _SLOPES)
            found.every = math.ceil(count / most)
            found.thin = math.ceil(count / found.every / _VALUES)
        self.answers.append(found)
        return found

    def passes(self) -> bool:
        """Whether all traces were right; wrong ones are given up, or made anew."""
        right = True
        for each in self.answers:
            each.close()
            if each.fault is not None:
                self._before.setdefault(each.tracer, each.tracer.state)
                each.tracer.doubt(each.trace, each.fault, moved=each.moved)
                right = False
            elif each.used:
                each.tracer.prove(each.trace)
        return right


def judged() -> Iterator[Judge]:
    """The judges of a call, which is done once for each, until its traces have proved right.

    The result is that of the last::

        for judge in judged():
            with judge:
                found = ...

    At first a wrong trace is made anew, since its function may have changed; one that was new is
    given up. The last judge trusts none.
    """
    before: _States = {}
    for _ in range(2):
        judge = Judge(before=before)
        yield judge
        if judge.right:
            return
    yield Judge(trusting=False, before=before)


def _chosen(doubts: Array) -> Integers:
    """The places of the points most in doubt, and of some at even distances."""
    last = len(doubts) - 1
    if last < EVEN:
        return np.arange(last + 1)
    chosen = np.zeros(last + 1, dtype=bool)
    chosen[np.arange(EVEN) * last // (EVEN - 1)] = True
    chosen[choice(doubts)] = True
    return np.flatnonzero(chosen)
