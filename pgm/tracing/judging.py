"""Traces judged by their answers: the function itself is asked where a call evaluated its trace.

A trace is wrong where its function has changed since it was made, or where the function decides by
numbers that tracing cannot follow, as in a comparison on a float copy of its input. No look at the
function's code shows all of that; its values do. So after a call the function is called once more,
in batches, at the points at which the call evaluated the trace. Where derivatives were used it is
called a hundredth of a deviation beside them, too: of 2 x and x / 2 the values at 0 are alike. A
derivative is wrong, too, where its formula cancels, as the quotient's rule does near a removable
singularity: a few derivatives are held against differences.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from pgm.errors import PgmError
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Integers, components_last, quiet
from pgm.kernels.differences import jacobian, steps
from pgm.tracing.program import Column
from pgm.tracing.trace import Tracer

Found = TypeVar("Found")

# From so many points on, a trace is made anew at each call, and is then judged at about so many.
LARGE, _SAMPLE = 2**12, 2**11
# So many points are judged at a time, and in a call so many derivatives.
_BATCH, _DERIVATIVES = 4096, 64
# Values that are the same differ by less: shares of a value, of the largest of a batch, and of the
# noise's deviation.
_OF_VALUE, _OF_LARGEST, _OF_NOISE = 1e-9, 1e-12, 1e-6
# Slopes that are the same move a prediction by less, in its deviations.
_OF_PREDICTION = 1e-3
# Differences are taken with two steps, the second so much finer, and believed where others agree to
# this share of an error.
_FINER, _AGREE = 1e-2, 0.1
# Of some roundings of a value.
_ROUNDING = 1e-14
# Values show slopes so far beside a point, in deviations: about as far as differences reach.
_BESIDE = 1e-2


def beside(x: Array, std: Array) -> Array:
    """Points (..., n) about 10⁻² deviations beside x (..., n), each component by another share.

    So no difference of components is the same there as at x, as it were with equal steps.
    """
    shares = 0.5 + np.modf(0.6180339887498949 * np.arange(1.0, x.size + 1.0))[0]
    found: Array = x + _BESIDE * shares.reshape(x.shape) * np.nan_to_num(std, posinf=0.0)
    return found


class _Points(NamedTuple):
    """Points at which a trace was evaluated: arguments (k, widths), value (k, d), slope (k, d, n).

    `std` (k, n) are the deviations of the beliefs there, NaN where nobody has told them.
    """

    arguments: Array
    value: Array
    slope: Array
    std: Array

    def at(self, rows: Integers) -> _Points:
        return _Points(*(part[rows] for part in self))

    @classmethod
    def joined(cls, parts: Sequence[_Points]) -> _Points:
        return cls(*(np.concatenate(each) for each in zip(*parts, strict=True)))


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
        self.fault: str | None = None
        # Whether a value was wrong, as where the function has changed; whether there were any.
        self.moved, self.used = False, False
        # Of so many points one is judged.
        self.every = 1
        self._open, self._passed = True, 0
        self._places, self._noise = list(places), np.sqrt(variances)
        starts = np.cumsum([0, *tracer.widths])
        self._cuts = starts[1:-1]
        self._columns = np.array([starts[a] + i for a, i in columns], dtype=np.intp)
        # Of single evaluations: arguments, value and derivative, covariance.
        self._asked: list[list[float]] = []
        self._told: list[tuple[float, ...]] = []
        self._covs: list[Array | None] = []
        # Of batches; how many points they have.
        self._batches: list[_Points] = []
        self._count = 0
        self._chosen: list[_Points] = []

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
            points = self._flat(shape, arguments, value, slope, std)
            self._batches.append(points)
            self._count += len(points.arguments)
            if self._count >= _BATCH:
                self._look_back()
        return value, slope

    def sample(self, points: Integers) -> Integers:
        """The points of a call at which the trace is judged: all, or some of very many."""
        return points[self.every // 2 :: self.every]

    def judge(self, arguments: Sequence[Array], std: Array | None) -> None:
        """Judge the trace at points (k, width) of each argument, where machine code evaluated it.

        `std` (k, size) are the deviations of beliefs over the stacked hidden parents; None where no
        derivative was used.
        """
        if not self._open or self.fault is not None:
            return
        flat = np.concatenate(arguments, axis=-1)
        for first in range(0, len(flat), _BATCH):
            part = flat[first : first + _BATCH]
            apart, shape = self._apart(part), (len(part),)
            told = components_last(self.trace.batch(apart, shape)[0], 1)
            if std is None:
                self._compare(part, told)
                continue
            slope = components_last(self.program.batch(apart, shape)[1], 2)
            spread = std[first : first + _BATCH, self._places]
            self._look(_Points(part, told, slope, spread))

    def close(self) -> None:
        """Judge all that has been kept, and keep nothing more."""
        self._look_back()
        self._open = False
        if self.fault is None and self._chosen:
            self._hold_slopes(self._choice(_Points.joined(self._chosen)))
        self._chosen = []

    def _look_back(self) -> None:
        """Judge what has been kept since this was done last."""
        parts = self._batches if self.fault is None else []
        if self._asked:
            told, height = np.array(self._told, dtype=float), len(self.program.value)
            slope = told[:, height:].reshape(len(told), height, -1)
            std = np.array([self._deviations(cov) for cov in self._covs])
            parts.append(_Points(np.array(self._asked), told[:, :height], slope, std))
            self._asked, self._told, self._covs = [], [], []
        self._batches, self._count = [], 0
        if parts and self.fault is None:
            self._look(_Points.joined(parts))

    def _flat(
        self,
        shape: tuple[int, ...],
        arguments: Sequence[Array],
        value: Array,
        slope: Array,
        std: Array | None,
    ) -> _Points:
        """Copies of a batch's points to be judged, one after another."""
        # Of batch after batch other points, such as other runs of the steps of a filter.
        count, width, first = math.prod(shape), len(self._places), -self._passed % self.every
        self._passed += count
        chosen = slice(first, None, self.every)
        told = value.reshape(len(value), count)[:, chosen]
        steep = slope.reshape(len(value), width, count)[..., chosen]
        spread = np.full((told.shape[-1], width), np.nan)
        if std is not None:
            own = std[..., self._places]
            own = own.reshape(*own.shape[:-1], *(1,) * (len(shape) + 1 - own.ndim), width)
            spread = np.broadcast_to(own, (*shape, width)).reshape(count, width)[chosen]
        flat = [each.reshape(count, each.shape[-1])[chosen] for each in arguments]
        return _Points(
            np.concatenate(flat, axis=-1),
            components_last(told, 1).copy(),
            components_last(steep, 2).copy(),
            spread,
        )

    def _deviations(self, cov: Array | None) -> Array:
        if cov is None:
            return np.full(len(self._places), np.nan)
        return np.sqrt(np.maximum(cov.diagonal()[self._places], 0.0))

    def _look(self, points: _Points) -> None:
        self._compare(points.arguments, points.value)
        if self.fault is None and self._places and not np.isnan(points.std).all():
            self._compare_beside(points)
            self._chosen.append(self._choice(points))

    def _compare_beside(self, points: _Points) -> None:
        """Compare values where slopes show in them; where the function fails there, it need not."""
        flat = points.arguments.copy()
        flat[:, self._columns] = beside(flat[:, self._columns], points.std)
        told = components_last(self.trace.batch(self._apart(flat), (len(flat),))[0], 1)
        due = self._function(flat)
        if due is not None:
            self._hold(flat, told, due)

    def _compare(self, flat: Array, told: Array) -> None:
        """Call the user's function at some points; a value unlike the trace's is a fault."""
        due, self.used = self._function(flat), True
        if due is None or due.shape != told.shape:
            self.fault = "its function fails on a batch of the points at which its trace was used"
            self.moved = True
            return
        self._hold(flat, told, due)

    def _hold(self, flat: Array, told: Array, due: Array) -> None:
        """A trace's values `told`, (k, d), unlike the function's are a fault."""
        with quiet():
            error = np.abs(difference(due, told, self.tracer.angles))
            known = np.isfinite(due)
            scale = np.where(known, np.abs(due), 0.0).max(axis=0, initial=0.0)
            height = len(self._noise)
            # Given derivatives, which may follow, have one scale: some are zero but for rounding.
            scale[height:] = scale[height:].max(initial=0.0)
            least = _OF_LARGEST * np.maximum(scale, self.tracer.angles)
            least[:height] += _OF_NOISE * self._noise
            least = least + _OF_VALUE * np.abs(due)
            wrong = np.where(known, ~(error <= least), np.isfinite(told)).any(axis=-1)
        if wrong.any():
            row, self.moved = int(wrong.argmax()), True
            self.fault = (
                f"at {_shown(flat[row])} its value is {_shown(due[row])}, its trace's "
                f"{_shown(told[row])}: it decides by numbers that no trace can follow, such as "
                "copies of its input by np.asarray(x, dtype=float), or it has a memory, draws at "
                "random, or changed during the call"
            )

    def _choice(self, points: _Points) -> _Points:
        """The first, the last, and those whose slope differs most from their neighbours'."""
        count = len(points.arguments)
        if count <= _DERIVATIVES:
            return points
        with quiet():
            moved = np.abs(np.diff(points.slope, axis=0)) * np.nan_to_num(points.std[1:, None])
            size = (np.abs(points.slope) * np.nan_to_num(points.std[:, None])).max(axis=0)
            moved = np.nan_to_num((moved / np.where(size > 0.0, size, 1.0)).max(axis=(1, 2)))
        pairs = np.argsort(moved)[-(_DERIVATIVES // 2 - 1) :]
        return points.at(np.unique([0, count - 1, *pairs, *(pairs + 1)]))

    def _hold_slopes(self, points: _Points) -> None:
        """A slope unlike the function's differences, or the trace's nearby slopes, is a fault.

        An entry (i, j) is wrong where it moves a prediction by too many of its deviations: of
        |J − D| σⱼ against Σ (D σ)² and the noise. But D, by differences, is believed only where two
        steps agree to it, and the trace's own slopes a step to either side: not at kinks, nor where
        a function turns within a step. Rounding of values, over a step, is no fault of the slope.
        """
        std, flat = np.nan_to_num(points.std, posinf=0.0)[:, None], points.arguments
        angles = self.tracer.angles[: len(self._noise)]
        x, columns = flat[:, self._columns], np.arange(len(self._columns))

        def along(moved: Array) -> Array:
            wide = np.repeat(flat[:, None], moved.shape[1], axis=1)
            wide[..., self._columns] = moved
            due = self._function(wide)
            if due is None:
                return np.full((*moved.shape[:-1], len(angles)), np.nan)
            return due[..., : len(angles)]

        with quiet():
            coarse, fine = (jacobian(along, x, std[:, 0], angles, each) for each in (1.0, _FINER))
            step = steps(x, std[:, 0], _FINER)
            beside = np.repeat(flat[:, None, None], 2, axis=1).repeat(len(columns), axis=2)
            beside[:, 0, columns, self._columns] += step
            beside[:, 1, columns, self._columns] -= step
            near = self.program.batch(self._apart(beside), beside.shape[:-1])[1]
            near = np.einsum("ijpsj->psij", near)  # by each column, a step along it
            error = np.abs(points.slope - fine)
            doubt = np.maximum(np.abs(coarse - fine), np.abs(near - fine[:, None]).max(axis=1))
            most = np.abs(points.value[:, : len(angles), None])
            unit = np.sqrt(((fine * std) ** 2).sum(axis=-1, keepdims=True)) + self._noise[:, None]
            least = _OF_PREDICTION * unit + _ROUNDING * most * std / step[:, None]
            wrong = (error * std > least) & (doubt < _AGREE * error)
        if wrong.any():
            row, part, _ = (int(axis[0]) for axis in np.nonzero(wrong))
            self.fault = (
                f"at {_shown(flat[row])} the derivative of component {part} of its value is "
                f"{_shown(fine[row, part])} by differences, {_shown(points.slope[row, part])} by "
                "its trace, whose formula cancels there"
            )

    def _function(self, flat: Array) -> Array | None:
        """The value (..., d) at arguments (..., widths) side by side; None where it fails."""
        with quiet():
            try:
                return np.asarray(self.tracer.function(*self._apart(flat)), dtype=float)
            except Exception:  # whose error the call itself raises, without its trace
                return None

    def _apart(self, flat: Array) -> list[Array]:
        return np.split(flat, self._cuts, axis=-1)


class Judge:
    """The traces that one call uses; without trust, it uses none."""

    def __init__(self, *, trusting: bool = True) -> None:
        self.trusting = trusting
        self.answers: list[Answers] = []

    def asked(
        self,
        tracer: Tracer,
        centres: Sequence[Array],
        columns: tuple[Column, ...],
        places: Sequence[int],
        variances: Sequence[float],
        count: int,
    ) -> Answers | None:
        """A tracer's answers in this call, for about as many points; None without a trace.

        A trace is made, if there is none, and compared with its function about the centres. What
        else there is as in `Answers`.
        """
        large = count >= LARGE
        if not self.trusting or not tracer.confirm(centres, anew=large):
            return None
        found = Answers(tracer, columns, places, variances)
        # A sample suffices where a trace is new and shows all that its function does.
        if large and not found.trace.cast:
            found.every = math.ceil(count / _SAMPLE)
        self.answers.append(found)
        return found

    def passes(self) -> bool:
        """Whether all traces were right; wrong ones are given up, or made anew."""
        right = True
        for each in self.answers:
            each.close()
            if each.fault is not None:
                each.tracer.doubt(each.trace, each.fault, moved=each.moved)
                right = False
            elif each.used:
                each.tracer.prove(each.trace)
        return right


def judged(call: Callable[[Judge], Found]) -> Found:
    """A call's result from traces that proved right; otherwise the call is done again.

    At first a wrong trace is made anew, since its function may have changed; one that was new is
    given up.
    """
    for _ in range(2):
        judge = Judge()
        try:
            found = call(judge)
        except PgmError:
            if judge.passes():
                raise
        else:
            if judge.passes():
                return found
    return call(Judge(trusting=False))


def _shown(numbers: Array) -> str:
    return "[" + ", ".join(f"{number:.6g}" for number in numbers) + "]"
