"""Functions that the program calls for machine code: their values, and their derivatives."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import NamedTuple

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps import differences
from pgm.kernels.machine.sweeps.told import Called, Row, Sensor
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.step import AnyMatrix


class Rows(NamedTuple):
    """A row of a CPD, and those of its step, for which the program is asked at the first of them.

    All are linearised at one belief. `first` is the step's first row, and `after` the one behind
    its last; the answers of a row are put at its place among them.
    """

    at: Whole
    first: Whole
    after: Whole

    @classmethod
    def alone(cls, at: Whole) -> Rows:
        """The only row of a step."""
        return cls(at, at, at + 1)

    @property
    def place(self) -> Whole:
        """The number of the row at hand among those of its step."""
        return self.at.code.whole(0) if self.first is self.at else self.at - self.first

    def begin(self, code: Code) -> AbstractContextManager[None]:
        """The code inside runs at the first of the rows."""
        return nullcontext() if self.first is self.at else code.when(self.at == self.first)

    def ask(self, w: Writer, called: Called, count: int) -> None:
        """Ask for all rows at the points that are put down."""
        w.ask(called.number, count, self.first, self.after, w.code.whole(0))

    def ask_alone(self, w: Writer, called: Called, count: int) -> None:
        """Ask for the row at hand."""
        w.ask(called.number, count, self.at, self.at + 1, self.place)


def rows_of(w: Writer, sensor: Sensor, at: Whole, row: Whole) -> Rows | None:
    """The sightings of a step, one of which is at hand; None where no program is asked for them."""
    if sensor.called is None or sensor.bounds is None:
        return None
    return Rows(row, *w.sightings(sensor, at))


def values_at(w: Writer, called: Called, rows: Rows, points: AnyMatrix) -> AnyMatrix:
    """The values of a function at points, row by row, in one call for all rows of a step."""
    count, height = points.shape[0], called.values.shape[1]
    with rows.begin(w.code):
        w.keep(called.points, points)
        rows.ask(w, called, count)
    return w.matrices.matrix(w.at(called.values, rows.place), count, height)


def tangent(
    w: Writer, row: Row, rows: Rows, mean: AnyMatrix, cov: AnyMatrix, *, alone: bool = False
) -> AnyMatrix:
    """The derivative of a function by differences, which is put among its lines.

    So is the value. `alone` says that the other rows of the step are not asked for.
    """
    called = row.called
    assert called is not None
    size, points = mean.shape[0], w.at(called.points)
    count = differences.count(size)
    with nullcontext() if alone else rows.begin(w.code):
        if size:
            w.keep(called.points, mean)
            w.matrices.keep(points.moved(size), cov)
            differences.surround(points, size)
        (rows.ask_alone if alone else rows.ask)(w, called, count)
    values, lines, place = w.at(called.values, rows.place), called.lines, rows.place
    value, slope = w.at(lines.value, place), w.at(lines.matrix, place)
    differences.slopes(points, values, value, slope, size, row.height, row.angles)
    return w.matrix(lines.matrix, place)
