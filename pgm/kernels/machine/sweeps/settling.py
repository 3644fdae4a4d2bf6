"""Iterations of a linearisation, by run: how far means move, and which runs have settled."""

from __future__ import annotations

from typing import Any

from pgm.kernels.arrays import LAST_PLACES
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import most, sqrt, where
from pgm.kernels.step import AnyMatrix


class Settling:
    """The iterations of a problem, of which a chain has many, and the record of all of them.

    The record has the largest residual of each iteration, a problem of fewer continued by its last;
    how many iterations there were; and whether some problem has not settled.
    """

    def __init__(self, w: Writer) -> None:
        self._w = w
        self._tolerance = w.settings.load(0)
        self._settled, self._made = w.code.varying(False), w.code.varying(0.0)
        self._residual, self._last = w.code.varying(0.0), w.code.variable(w.code.whole(0))

    @property
    def settled(self) -> Number:
        """Whether a run has settled."""
        return self._settled.get()

    def note(self, k: Whole, moved: Any, certain: Any) -> None:
        """Note how far iteration k, from 1 on, has moved means; it settles what is `certain`."""
        settled = self.settled
        self._residual.set(moved)
        self._made.set(where(settled, self._made.get(), k.number()))
        self._settled.set(settled | ((moved <= self._tolerance) & certain))
        self._at_most(k - 1, moved)
        self._last.set(k)

    def close(self, count: Whole) -> None:
        """End a problem of at most so many linearisations."""
        with self._w.code.loop(count - 1, self._last.get()) as later:
            self._at_most(later, self._residual.get())
        self._at_most(count - 1, self._made.get())
        self._at_most(count, where(self.settled, 0.0, 1.0))

    def _at_most(self, place: Whole, value: Any) -> None:
        """Let a number of the record be no less than a value."""
        record = self._w.residuals
        known = record.load(place)
        record.store(place, where(known > value, known, value))


def moved(w: Writer, mean: AnyMatrix, cov: AnyMatrix, point: AnyMatrix) -> Any:
    """How far a mean is from where it was linearised, in deviations, as `moments.moved`."""
    residual: Any = 0.0
    m = w.matrices
    for new, old, variance in zip(m.beside(mean), m.beside(point), m.diagonal(cov), strict=True):
        size, other = abs(new), abs(old)
        unit = where(variance > 0.0, sqrt(variance), most(size, 1.0))
        left = abs(new - old) - LAST_PLACES * most(size, other)
        left = where(left < 0.0, 0.0, left) / unit  # NaN stays
        residual = where(residual > left, residual, left)
    return w.together(lambda a, b: where(a > b, a, b), [residual])
