"""A CPD at one of its rows, linearised at a belief over its parents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from functools import reduce
from math import pi
from operator import or_
from typing import NamedTuple

from pgm.kernels import step
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.traces import Inputs
from pgm.kernels.machine.emitter.variables import held
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.called import Rows, tangent, values_at
from pgm.kernels.machine.sweeps.told import Points, Row, Sensor
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import inner, where
from pgm.kernels.step import AnyMatrix

# As of `gaussian` and `linearisers.regression`: the least share of a root that is regular; and the
# error of a line that is none of rounding, as a part of a value's square, or of the square of what
# rounding may be at most.
REGULAR, _PLAIN, _SURELY = 1e-11, 1e-16, 1.0 / 64.0


class Line(NamedTuple):
    """A linearisation y = F (x − m) + value + e at a mean m, F being (d, n).

    The covariance of e is that of the CPD's `own` noise, and that of the line's `error`, None for
    zero. `sure` is a truth: whether all of it is right, so far as can be told.
    """

    matrix: AnyMatrix
    value: AnyMatrix
    own: AnyMatrix
    error: AnyMatrix | None
    sure: Number

    @property
    def noise(self) -> AnyMatrix:
        """The covariance of e."""
        return self.own if self.error is None else self.own + self.error


def inputs(w: Writer, row: Row, at: Whole) -> Inputs:
    """Where the observed arguments of a CPD's function are, at its row."""
    if row.function is None:
        return {}
    observed = dict.fromkeys(argument for argument, _ in row.function.observed)
    cells = {a: w.at(array, at) for a, array in zip(observed, row.inputs, strict=True)}
    return {column: (cells[column[0]], column[1]) for column in row.function.observed}


def value_at(w: Writer, row: Row, at: Whole, mean: AnyMatrix) -> AnyMatrix:
    """The value of a CPD's function at its row, the only one of a step where it is called."""
    if row.called is not None:
        return values_at(w, row.called, Rows.alone(at), mean.T).T
    assert row.function is not None
    return w.matrices.value(row.function, mean, inputs(w, row, at))


def linearised(
    w: Writer,
    row: Row,
    at: Whole,
    mean: AnyMatrix,
    cov: AnyMatrix,
    again: Number | None = None,
    rows: Rows | None = None,
) -> Line:
    """A CPD linearised at a belief over its parents, a mean (n × 1) and a covariance (n × n).

    `again` says that it has been, in this step and at this belief; None that it has not. `rows` are
    those of the step; None where it has one.
    """
    noise = w.symmetric(row.noise, at)
    if row.called is not None:
        return _called(w, row, rows or Rows.alone(at), mean, cov, noise, again)
    if row.function is None:
        assert row.matrix is not None
        assert row.offset is not None
        matrix = w.matrix(row.matrix, at)
        offset = w.column(row.offset, at)
        for shift, values in zip(row.shifts, row.inputs, strict=False):
            offset = offset + w.matrix(shift) @ w.column(values, at)
        return Line(matrix, matrix @ mean + offset, noise, None, w.true)
    if row.points is not None and mean.shape[0]:
        return _regressed(w, row, Rows.alone(at), mean, cov, noise)
    value, matrix = w.matrices.slope(row.function, mean, inputs(w, row, at))
    return Line(matrix, value, noise, None, w.true)


def _called(
    w: Writer,
    row: Row,
    rows: Rows,
    mean: AnyMatrix,
    cov: AnyMatrix,
    noise: AnyMatrix,
    again: Number | None,
) -> Line:
    called = row.called
    assert called is not None
    lines, place = called.lines, rows.place
    with nullcontext() if again is None else w.code.when(~again), w.matrices.scratch():
        if lines.cov is not None:
            with rows.begin(w.code):
                w.keep(called.points, mean)
                w.keep(lines.cov, cov)
                rows.ask(w, called, 0)
        elif row.points is not None and mean.shape[0]:
            line = _regressed(w, row, rows, mean, cov, noise)
            w.keep(lines.value, line.value, place)
            w.keep(lines.matrix, line.matrix, place)
            w.keep(lines.error, line.error, place)
            w.at(lines.sure, place).store(0, line.sure.number())
        else:
            tangent(w, row, rows, mean, cov)
            w.at(lines.sure, place).store(0, 1.0)
    error = None if lines.error is None else w.symmetric(lines.error, place)
    matrix, value = w.matrix(lines.matrix, place), w.column(lines.value, place)
    return Line(matrix, value, noise, error, w.at(lines.sure, place).load(0) > 0.0)


def keep(w: Writer, row: Row, at: Whole, mean: AnyMatrix, line: Line) -> None:
    """Keep a linearisation, where that is asked for; its noise is kept by whoever weighs it."""
    if row.curved and row.matrix is not None:
        assert row.offset is not None
        w.keep(row.matrix, line.matrix, at)
        w.keep(row.offset, line.value - line.matrix @ mean, at)


def readings(w: Writer, sensor: Sensor, at: Whole, value: AnyMatrix) -> AnyMatrix:
    """A sensor's readings at a row, with angles on the branch nearest to a value, and kept so."""
    found = on_branch(w, w.column(sensor.readings, at), value, sensor.angles)
    w.keep(sensor.moved, found, at)
    return found


def on_branch(w: Writer, vector: AnyMatrix, value: AnyMatrix, angles: Sequence[int]) -> AnyMatrix:
    """The vector with its angles on the branch nearest to those of a value."""
    near = {k: step.nearest(vector[k, 0], value[k, 0]) for k in angles}
    return w.matrices.replaced(vector, near)


def _regressed(
    w: Writer, row: Row, rows: Rows, mean: AnyMatrix, cov: AnyMatrix, noise: AnyMatrix
) -> Line:
    rule, m = row.points, w.matrices
    assert rule is not None
    fixed = {j: cov[j, j] == 0.0 for j in rule.known}
    root = (cov.independent(w.varies(cov)) if fixed else cov).root()
    # The mean comes first: of angles, its value is the one about which the others are.
    extra = 0 if rule.centred or not row.angles else 1
    centre = ((0.0,) * mean.shape[0],) * extra
    moves = m.constant((*centre, *rule.points)) @ root.matrix.T
    if fixed:
        columns = {j: m.beside(moves.part(range(moves.shape[0]), (j,))) for j in fixed}
        still = {j: [where(fixed[j], 0.0, x) for x in each] for j, each in columns.items()}
        moves = m.with_columns(moves, still)
    points = m.shifted(moves, mean)
    if row.called is not None:
        values = values_at(w, row.called, rows, points)
    else:
        assert row.function is not None
        values = m.values(row.function, points, inputs(w, row, rows.at))
    reference = values.part((0,), range(row.height)).T
    if extra:
        every = range(1, points.shape[0])
        moves = moves.part(every, range(mean.shape[0]))
        values = values.part(every, range(row.height))
    off = m.shifted(values, reference.scaled(-1.0))
    if row.angles:
        off = _about(w, row, rows, mean, cov, moves, off)
    found = step.regress(root, _constant(w, rule), off)
    if fixed:
        found = found._replace(matrix=_tangential(w, row, rows, mean, cov, found.matrix, fixed))
    error = _told_from_rounding(w, row, mean, reference, off, found)
    return Line(found.matrix, reference + found.value, noise, error, root.share > REGULAR)


def _constant(w: Writer, rule: Points) -> step.Rule:
    size = range(len(rule.signs))
    constant = w.matrices.constant
    signs = [[rule.signs[i] if i == j else 0.0 for j in size] for i in size]
    mean, slope, rest = constant(rule.mean), constant(rule.slope), constant(rule.rest)
    return step.Rule(mean, slope, rest, constant(signs) if signs else None)


def _about(
    w: Writer,
    row: Row,
    rows: Rows,
    mean: AnyMatrix,
    cov: AnyMatrix,
    moves: AnyMatrix,
    off: AnyMatrix,
) -> AnyMatrix:
    """Offsets of angles about their tangent, where some of them exceed half a turn."""
    m = w.matrices
    columns = {i: m.beside(off.part(range(off.shape[0]), (i,))) for i in row.angles}
    far = {i: w.together(or_, [abs(x) > pi for x in columns[i]]) for i in row.angles}
    some = reduce(or_, far.values())
    if some is False:  # angles that are the same everywhere
        return off
    wrapped = {i: [held(w.code, x) for x in columns[i]] for i in row.angles}
    with w.code.when(w.code.some(some)):
        slope = _slope(w, row, rows, mean, cov)
        for i in row.angles:
            lines = m.beside(moves @ slope.part((i,), range(mean.shape[0])).T)
            for variable, x, line in zip(wrapped[i], columns[i], lines, strict=True):
                rest = x - line
                turned = rest - step.turns(rest) + line
                variable.set(where(far[i], turned, x))
    return m.with_columns(off, {i: [x.get() for x in wrapped[i]] for i in row.angles})


def _slope(w: Writer, row: Row, rows: Rows, mean: AnyMatrix, cov: AnyMatrix) -> AnyMatrix:
    """The derivative of a CPD's function at a mean, of the row at hand."""
    if row.called is not None:
        return tangent(w, row, rows, mean, cov, alone=True)
    assert row.function is not None
    slope: AnyMatrix = w.matrices.slope(row.function, mean, inputs(w, row, rows.at))[1]
    return slope


def _tangential(
    w: Writer,
    row: Row,
    rows: Rows,
    mean: AnyMatrix,
    cov: AnyMatrix,
    matrix: AnyMatrix,
    fixed: Mapping[int, Number],
) -> AnyMatrix:
    """The slope of a line, in components that are `fixed` that of the tangent: its limit there."""
    m, every = w.matrices, range(row.height)

    def numbers(of: AnyMatrix, j: int) -> list[Number]:
        return m.beside(of.part(every, (j,)))

    columns = {j: [held(w.code, x) for x in numbers(matrix, j)] for j in fixed}
    with w.code.when(w.code.some(reduce(or_, fixed.values()))):
        slope = _slope(w, row, rows, mean, cov)
        for j, truth in fixed.items():
            for variable, x in zip(columns[j], numbers(slope, j), strict=True):
                variable.set(where(truth, x, variable.get()))
    return m.with_columns(matrix, {j: [x.get() for x in each] for j, each in columns.items()})


def _told_from_rounding(
    w: Writer,
    row: Row,
    mean: AnyMatrix,
    reference: AnyMatrix,
    off: AnyMatrix,
    found: step.Regressed,
) -> AnyMatrix:
    """The error of a line, zero in components in which it may be rounding of the values."""
    rule, error, m = row.points, found.error, w.matrices
    assert rule is not None
    plain = max(_PLAIN, _SURELY * rule.rounding**2)
    size = range(mean.shape[0])
    values, farthest = m.beside(reference), m.largest(off)
    slopes = list(zip(*(m.row(found.moment, j) for j in size), strict=True))
    lines = list(zip(*(m.row(found.matrix.T, j) for j in size), strict=True))
    least_of = m.beside(m.constant([rule.variances]).T)
    x = [abs(mean[j, 0]) for j in size]
    sound = []
    for k, variance in enumerate(m.diagonal(error)):
        whole = values[k] * values[k] + inner(slopes[k], slopes[k])
        summands = abs(values[k]) + inner([abs(f) for f in lines[k]], x) + farthest[k]
        rounding = rule.rounding * summands
        sound.append(
            (variance + least_of[k] > plain * whole) | (abs(variance) > rounding * rounding)
        )
    return step.known_part(error, m.truths(sound, error.shape[0]))
