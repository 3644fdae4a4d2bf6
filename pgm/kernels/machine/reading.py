"""The measurements of a step taken into its belief, one sighting after another."""

from __future__ import annotations

from typing import Any

from pgm.kernels import step
from pgm.kernels.arrays import LAST_PLACES, LOG_2PI
from pgm.kernels.gaussian import NEARLY_SINGULAR
from pgm.kernels.machine.cpd import Line, keep, linearised
from pgm.kernels.machine.numbers import Number
from pgm.kernels.machine.told import Forward, Sensor
from pgm.kernels.machine.wholes import Whole
from pgm.kernels.machine.writer import Carried, Writer
from pgm.kernels.numbers import Matrix, least, most, sqrt, where

# The part of S (10 + rᵀ S⁻¹ r) that noise has to exceed in all directions. Below, a belief that is
# linearised again, or any, is not known to a billionth of a deviation: an order of sums shows. A
# measurement that leaves a thousandth of each variance is never so sharp.
_CURVED, _STRAIGHT, _MILD = 1e-6, 1e-8, 1e-3
# A length rᵀ S⁻¹ r from which on little or nothing can be told.
_FARTHEST = 1e12


class Taken:
    """A belief that takes in measurements: its moments, their log-density, and whether it is sure.

    `curved` is whether a measurement of the step has to be linearised.
    """

    def __init__(self, w: Writer, mean: Matrix, cov: Matrix) -> None:
        self.moments = Carried(w.code, mean, cov)
        self._density, self._sure = w.code.variable(0.0), w.code.variable(True)

    @property
    def density(self) -> Number:
        """The log-density of the measurements that are taken in."""
        return self._density.get()

    @property
    def sure(self) -> Number:
        """Whether all of it is right, so far as can be told."""
        return self._sure.get()

    def begin(self, mean: Matrix, cov: Matrix) -> None:
        """Begin again, at a predicted belief."""
        self.moments.set(mean, cov)
        self._density.set(0.0)
        self._sure.set(True)

    def take(self, mean: Matrix, cov: Matrix, density: Number, sure: Number) -> None:
        """Go on to a belief that knows one measurement more."""
        self.moments.set(mean, cov)
        self._density.set(self.density + density)
        self._sure.set(self.sure & sure)


def taken(w: Writer, chain: Forward, at: Whole, mean: Matrix, cov: Matrix) -> Taken:
    """The belief given the measurements of a step, whose predicted moments are N(mean, cov)."""
    found = Taken(w, mean, cov)
    if not chain.iterated:
        _once(w, chain, at, mean, cov, mean, cov, found)
        return found
    code = w.code
    point = Carried(code, mean, cov)
    settings = w.settings
    tolerance, damping = settings.load(0), settings.load(1)
    linearisations = code.variable(1)
    with code.when(_are_curved(w, chain, at)):
        linearisations.set(w.iterations)
    settled, made, residual = code.variable(False), code.variable(0.0), code.variable(0.0)
    record = w.residuals
    last = code.variable(0)
    with code.loop(linearisations.get()) as k:
        with code.when(k > 0):
            _move(point, found.moments, damping, settled.get())
        found.begin(mean, cov)
        _once(w, chain, at, mean, cov, point.mean, point.cov, found)
        with code.when(k > 0):
            moved = _moved(found.moments, point.mean)
            residual.set(moved)
            made.set(where(settled.get(), made.get(), k.number()))
            settled.set(settled.get() | (moved <= tolerance))
            _at_most(record, k - 1, moved)
            last.set(k)
        code.leave_when(code.every(settled.get()))
        code.leave_unless(code.some(found.sure))
    with code.when(linearisations.get() > 1):
        most_often = linearisations.get()
        with code.loop(most_often - 1, last.get()) as later:
            _at_most(record, later, residual.get())
        _at_most(record, most_often - 1, made.get())
        _at_most(record, most_often, where(settled.get(), 0.0, 1.0))
    return found


def _are_curved(w: Writer, chain: Forward, at: Whole) -> Number:
    """Whether some measurement of a step has to be linearised."""
    found = w.code.constant(False).lane(0)
    for sensor in chain.sensors:
        if sensor.function is None:
            continue
        if sensor.bounds is None:
            return w.code.constant(True).lane(0)
        first, last = w.sightings(sensor, at)
        found = found | (first < last)
    return found


def _move(point: Carried, found: Carried, damping: Number, settled: Number) -> None:
    """Move the point of linearisation to the belief that was found, where it has not settled."""
    def mixed(a: Any, b: Any) -> Any:
        return where(settled, a, damping * a + (1.0 - damping) * b)

    def mix(a: Matrix, b: Matrix) -> Matrix:
        return Matrix(
            [mixed(x, y) for x, y in zip(*rows, strict=True)]
            for rows in zip(a.rows, b.rows, strict=True)
        )

    point.set(mix(point.mean, found.mean), mix(point.cov, found.cov))


def _moved(found: Carried, point: Matrix) -> Any:
    """How far a mean is from where it was linearised, in deviations, as `moments.moved`."""
    residual: Any = 0.0
    for (new,), (old,), variance in zip(
        found.mean.rows, point.rows, found.cov.diagonal, strict=True
    ):
        size, other = abs(new), abs(old)
        unit = where(variance > 0.0, sqrt(variance), most(size, 1.0))
        left = abs(new - old) - LAST_PLACES * most(size, other)
        left = where(left < 0.0, 0.0, left) / unit  # NaN stays
        residual = where(residual > left, residual, left)
    return residual


def _at_most(record: Any, place: Whole, value: Any) -> None:
    """Let a number of a record be no less than a value."""
    known = record.load(place)
    record.store(place, where(known > value, known, value))


def _once(
    w: Writer,
    chain: Forward,
    at: Whole,
    mean: Matrix,
    cov: Matrix,
    point: Matrix,
    about: Matrix,
    found: Taken,
) -> None:
    """Take the measurements of a step, linearised at a belief, into N(mean, cov)."""
    fresh = point is mean  # no measurement has moved the belief from the point yet
    for sensor in chain.sensors:
        if sensor.bounds is None:
            _read(w, sensor, at, cov, point, about, found, fresh=fresh)
        else:
            first, last = w.sightings(sensor, at)
            with w.code.loop(last, first) as row:
                _read(w, sensor, row, cov, point, about, found)
        fresh = False


def _read(
    w: Writer,
    sensor: Sensor,
    at: Whole,
    before: Matrix,
    point: Matrix,
    about: Matrix,
    found: Taken,
    *,
    fresh: bool = False,
) -> None:
    """Take in a sighting, linearised at a belief; `before` is the covariance before its step."""
    parents, size = sensor.parents, point.shape[0]
    x = point.part(parents, (0,))
    line = linearised(w, sensor, at, x, about.part(parents, parents))
    keep(w, sensor, at, x, line)
    values = [number for (number,) in w.column(sensor.readings, at).rows]
    for k in sensor.angles:
        values[k] = step.nearest(values[k], line.value[k, 0])
    w.keep(sensor.moved, Matrix.column(values), at)
    residual, matrix, noise = Matrix.column(values) - line.value, _widened(line, sensor, size), line.noise
    mean, cov = found.moments.mean, found.moments.cov
    if not fresh:
        residual = residual - matrix @ (mean - point)
    count: Any = float(sensor.height)
    if sensor.missing:
        known = [value == value for value in values]
        residual, matrix, noise = step.seen(known, residual, matrix, noise)
        count = w.sum([truth.number() for truth in known])
    after = step.update(mean, cov, matrix, residual, noise)
    limit = _STRAIGHT if sensor.function is None else _CURVED
    part = least(limit * (10.0 + after.square), w.code.constant(_MILD))
    whole = step.predict(before, matrix, noise)
    sure = (
        line.sure
        & (after.share > NEARLY_SINGULAR)
        & (after.square < _FARTHEST)
        & _is_positive(noise - whole.scaled(part))
    )
    density = -0.5 * (after.square + LOG_2PI * count) - after.volume
    found.take(after.mean, after.cov, density, sure)


def _is_positive(matrix: Matrix) -> Number:
    """Whether a matrix is positive definite."""
    return (matrix[0, 0] > 0.0) & (step.open_share(matrix) > 0.0)


def _widened(line: Line, sensor: Sensor, size: int) -> Matrix:
    """The matrix of a linearisation over the whole slice."""
    if sensor.parents == tuple(range(size)):
        return line.matrix
    place = {parent: k for k, parent in enumerate(sensor.parents)}
    return Matrix(
        [row[place[j]] if j in place else 0.0 for j in range(size)] for row in line.matrix.rows
    )
