"""Linearised sightings of a step, and the point at which they are linearised."""

from __future__ import annotations

from typing import Any, NamedTuple

from pgm.kernels import step
from pgm.kernels.arrays import LOG_2PI
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.called import Rows
from pgm.kernels.machine.sweeps.control import Anchor
from pgm.kernels.machine.sweeps.cpd import Line, keep, linearised, readings
from pgm.kernels.machine.sweeps.told import Sensor
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.step import AnyMatrix


class Point(NamedTuple):
    """The point where a step's measurements are linearised, and the belief that takes them in.

    `mean` and `cov` are the predicted moments, `at` and `about` those of the linearisation. `first`
    is whether this is the first linearisation, None if there is one alone. An `anchor` is taken in
    as well.
    """

    mean: AnyMatrix
    cov: AnyMatrix
    at: AnyMatrix
    about: AnyMatrix
    first: Number | None
    anchor: Anchor | None = None


class Sighting(NamedTuple):
    """A sighting as linearised: z = value + H (x − m) + e over the whole slice.

    `left` is z − value, `own` and `error` are the covariances of the noise and of the line's error,
    None for zero, and `count` is how many components were measured; others say nothing. `stands` is
    the part of `own` that stands for these, None where there are none. `line` is the linearisation
    by itself, over the sensor's parents.
    """

    line: Line
    left: AnyMatrix
    matrix: AnyMatrix
    own: AnyMatrix
    error: AnyMatrix | None
    count: Any
    stands: AnyMatrix | None = None

    @classmethod
    def of(
        cls,
        w: Writer,
        sensor: Sensor,
        at: Whole,
        point: Point,
        again: Number | None = None,
        rows: Rows | None = None,
    ) -> Sighting:
        """A sensor's sighting at a row, linearised at a point, its angles on the nearest branch.

        `rows` tell the CPD's own row, and those that are linearised with it. Of them, and of
        `again`, see `linearised`.
        """
        m, parents = w.matrices, sensor.parents
        x = point.at.part(parents, (0,))
        about, of = point.about.part(parents, parents), at if rows is None else rows.at
        line = linearised(w, sensor, of, x, about, again, rows)
        keep(w, sensor, at, x, line)
        values = readings(w, sensor, at, line.value)
        left, matrix = values - line.value, m.widened(line.matrix, parents, point.at.shape[0])
        if not sensor.missing:
            return cls(line, left, matrix, line.own, line.error, float(sensor.height))
        known = [value == value for value in m.beside(values)]
        truths = m.truths(known, sensor.height)
        left, matrix, own = step.seen(truths, left, matrix, line.own)
        error = None if line.error is None else step.known_part(line.error, truths)
        missing = w.sum([1.0 - truth.number() for truth in known])
        stands = own - step.known_part(own, truths) if sensor.weighs else None
        return cls(line, left, matrix, own, error, float(sensor.height) - missing, stands)

    def weighed(self, weight: Any) -> AnyMatrix:
        """The noise covariance R / w by a weight w; components that are missing keep unit noise."""
        if self.stands is None:
            return self.own.scaled(1.0 / weight)
        return (self.own - self.stands).scaled(1.0 / weight) + self.stands

    def density(self, of: step.Updated | step.Innovation) -> Any:
        """The log-density of the measured components, by the square and the volume of an update."""
        return -0.5 * (of.square + LOG_2PI * self.count) - of.volume

    @property
    def noise(self) -> AnyMatrix:
        """The covariance of e."""
        return self.own if self.error is None else self.own + self.error
