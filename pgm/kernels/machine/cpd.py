"""A CPD at one of its rows, linearised at a belief over its parents."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Any, NamedTuple

from pgm.kernels import step
from pgm.kernels.machine.called import called_at, tangent
from pgm.kernels.machine.numbers import Number
from pgm.kernels.machine.told import Function, Lines, Points, Row
from pgm.kernels.machine.traces import written
from pgm.kernels.machine.wholes import Whole
from pgm.kernels.machine.writer import Writer, held
from pgm.kernels.numbers import Matrix, inner, most, nearest_whole, where

# As of `gaussian` and `linearisers.regression`: the least share of a root that is regular; and the
# error of a line that is none of rounding, as a part of a value's square, or of the square of what
# rounding may be at most.
REGULAR, _PLAIN, _SURELY = 1e-11, 1e-16, 1.0 / 64.0


class Line(NamedTuple):
    """A linearisation y = F (x − m) + value + e at a mean m, F being (d, n).

    The covariance of e is that of the CPD's `own` noise, and that of the line's `error`, None for
    zero. `sure` is a truth: whether all of it is right, so far as can be told.
    """

    matrix: Matrix
    value: Matrix
    own: Matrix
    error: Matrix | None
    sure: Number

    @property
    def noise(self) -> Matrix:
        """The covariance of e."""
        return self.own if self.error is None else self.own + self.error


def evaluated(
    w: Writer, row: Row, at: Whole, x: Sequence[Any], *, slope: Matrix | None = None
) -> tuple[list[Any], list[Any]]:
    """The value of a CPD's function at its row, and the derivative, row by row, if it is asked.

    It is asked by the covariance of the belief, over which a derivative by differences is taken.
    """
    if row.called is not None:
        if slope is not None:
            return tangent(w, row, at, x, slope)
        return called_at(w, row.called, at, [x])[0], []
    function = row.function
    assert function is not None
    places = {column: k for k, column in enumerate(function.observed)}
    observed = None if row.inputs is None else w.at(row.inputs, at)
    known = dict(zip(function.hidden, x, strict=True))

    def of(argument: int, component: int) -> Any:
        column = argument, component
        if column not in known:
            assert observed is not None
            known[column] = observed.load(places[column])
        return known[column]

    return traced(w, function, of, slope=slope is not None)


def traced(
    w: Writer, function: Function, inputs: Any, *, slope: bool
) -> tuple[list[Any], list[Any]]:
    """The value of a trace, and its derivative, of which zeros are floats."""
    outputs = [*function.value, *(function.slope if slope else ())]
    due = [k for k in outputs if k is not None]
    found = dict(zip(due, written(w.code, function, due, inputs), strict=True))
    every = [0.0 if k is None else found[k] for k in outputs]
    return every[: len(function.value)], every[len(function.value) :]


def linearised(
    w: Writer, row: Row, at: Whole, mean: Matrix, cov: Matrix, again: Number | None = None
) -> Line:
    """A CPD linearised at a belief over its parents, a mean (n × 1) and a covariance (n × n).

    `again` says that it has been, in this step and at this belief; None that it has not.
    """
    noise = w.symmetric(row.noise, at)
    if row.called is not None and row.called.lines is not None:
        lines = row.called.lines
        place = at % lines.rows
        with w.code.when(w.true.lane(0) if again is None else ~again):
            if lines.cov is not None:
                w.keep(row.called.points, mean)
                w.keep(lines.cov, cov)
                w.ask(row.called.number, 0, at)
            else:
                _put(w, lines, place, _curved(w, row, at, mean, cov, noise))
        return _again(w, lines, place, noise)
    if not row.curved:
        assert row.matrix is not None
        assert row.offset is not None
        matrix = w.matrix(row.matrix, at)
        value = matrix @ mean + w.column(row.offset, at)
        return Line(matrix, value, noise, None, w.true)
    return _curved(w, row, at, mean, cov, noise)


def _curved(w: Writer, row: Row, at: Whole, mean: Matrix, cov: Matrix, noise: Matrix) -> Line:
    x = [number for (number,) in mean.rows]
    if row.points is not None and x:
        return _regressed(w, row, at, mean, cov, noise)
    value, slope = evaluated(w, row, at, x, slope=cov)
    size = len(x)
    matrix = Matrix([slope[i * size : (i + 1) * size] for i in range(row.height)])
    return Line(matrix, Matrix.column(value), noise, None, w.true)


def _put(w: Writer, lines: Lines, place: Whole, line: Line) -> None:
    w.keep(lines.value, line.value, place)
    w.keep(lines.matrix, line.matrix, place)
    w.keep(lines.sure, Matrix([[line.sure.number()]]), place)
    if line.error is not None:
        w.keep(lines.error, line.error, place)


def _again(w: Writer, lines: Lines, place: Whole, noise: Matrix) -> Line:
    matrix, value = w.matrix(lines.matrix, place), w.column(lines.value, place)
    error = None if lines.error is None else w.symmetric(lines.error, place)
    return Line(matrix, value, noise, error, w.at(lines.sure, place).load(0) > 0.0)


def keep(w: Writer, row: Row, at: Whole, mean: Matrix, line: Line) -> None:
    """Keep a linearisation, where that is asked for; its noise is kept by whoever weighs it."""
    if row.curved and row.matrix is not None:
        assert row.offset is not None
        w.keep(row.matrix, line.matrix, at)
        w.keep(row.offset, line.value - line.matrix @ mean, at)


def _regressed(w: Writer, row: Row, at: Whole, mean: Matrix, cov: Matrix, noise: Matrix) -> Line:
    rule, x = row.points, [number for (number,) in mean.rows]
    assert rule is not None
    root = cov.root()
    lower = root.matrix
    moves = [[inner(line, s) for line in lower.rows] for s in rule.points]
    points = [[a + b for a, b in zip(x, move, strict=True)] for move in moves]
    centred = rule.centred or not row.angles
    if not centred:
        points.append(x)
    if row.called is not None:
        values = called_at(w, row.called, at, points)
    else:
        values = [evaluated(w, row, at, point)[0] for point in points]
    reference = values[0] if centred else values.pop()
    off = [[a - b for a, b in zip(each, reference, strict=True)] for each in values]
    if row.angles:
        _about(w, row, at, x, cov, moves, off)
    found = step.regress(root, _constant(rule), Matrix(off))
    error = _told_from_rounding(row, x, reference, off, found)
    value = Matrix.column(reference) + found.value
    return Line(found.matrix, value, noise, error, root.share > REGULAR)


def _constant(rule: Points) -> step.Rule:
    size = range(len(rule.signs))
    signs = Matrix([rule.signs[i] if i == j else 0.0 for j in size] for i in size)
    parts = Matrix(rule.mean), Matrix(rule.slope), Matrix(rule.rest)
    return step.Rule(*parts, signs if rule.signs else None)


def _about(
    w: Writer,
    row: Row,
    at: Whole,
    x: list[Any],
    cov: Matrix,
    moves: list[list[Any]],
    off: list[list[Any]],
) -> None:
    """Wrap offsets of angles about their tangent, where some of them exceed half a turn."""
    far = {}
    for i in row.angles:
        far[i] = abs(off[0][i]) > pi
        for each in off[1:]:
            far[i] = far[i] | (abs(each[i]) > pi)
    offsets = {(p, i): held(w.code, each[i]) for p, each in enumerate(off) for i in row.angles}
    any_far = next(iter(far.values()))
    for truth in far.values():
        any_far = any_far | truth
    with w.code.when(w.code.some(any_far)):
        slope, size = evaluated(w, row, at, x, slope=cov)[1], len(x)
        for (p, i), variable in offsets.items():
            line = inner(slope[i * size : (i + 1) * size], moves[p])
            rest = off[p][i] - line
            turned = rest - step.TURN * nearest_whole(rest / step.TURN) + line
            variable.set(where(far[i], turned, off[p][i]))
    for (p, i), variable in offsets.items():
        off[p][i] = variable.get()


def _told_from_rounding(
    row: Row, x: list[Any], reference: list[Any], off: list[list[Any]], found: step.Regressed
) -> Matrix:
    """The error of a line, zero in components in which it may be rounding of the values."""
    rule, error = row.points, found.error
    assert rule is not None
    plain = max(_PLAIN, _SURELY * rule.rounding**2)
    sound = []
    for i in range(row.height):
        slopes = [found.moment[j, i] for j in range(len(x))]
        size = reference[i] * reference[i] + inner(slopes, slopes)
        summands, farthest = abs(reference[i]), abs(off[0][i])
        for j, number in enumerate(x):
            summands = summands + abs(found.matrix[i, j] * number)
        for each in off[1:]:
            farthest = most(farthest, abs(each[i]))
        rounding = rule.rounding * (summands + farthest)
        variance = error[i, i]
        sound.append(
            (variance + rule.variances[i] > plain * size)
            | (abs(variance) > rounding * rounding)
        )
    size = range(row.height)
    return Matrix(
        [where(sound[i] & sound[j], error[i, j], 0.0) for j in size] for i in size
    )
