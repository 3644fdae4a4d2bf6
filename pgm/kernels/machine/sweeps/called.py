"""Functions that the program calls for machine code: their values, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pgm.kernels import step
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.told import Called, Row
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import least, most, nearest_whole, sqrt, where
from pgm.kernels.step import AnyMatrix

# As of `differences`: the least step, as a part of a deviation, in itself, and beside a number; and
# the multiples of a step at which a function is called.
_PART, _STEP, _BESIDE = 1e-2, 1e-4, 1e-9
_AROUND = 1.0, -1.0, 2.0, -2.0
# As of `gaussian.lengths`: a deviation given another component counts tenfold, and to a thousandth.
_TENFOLD, _LEAST = 10.0, 1e-3


def values_at(w: Writer, called: Called, at: Whole, points: AnyMatrix) -> AnyMatrix:
    """The values of a function at points, row by row, in one call."""
    w.keep(called.points, points)
    count, height = points.shape[0], called.values.shape[1]
    w.ask(called.number, count, at)
    return w.matrices.matrix(w.at(called.values), count, height)


def tangent(w: Writer, row: Row, at: Whole, mean: AnyMatrix, cov: AnyMatrix) -> AnyMatrix:
    """The derivative of a function by differences of fourth order, which is put among its lines.

    So is the value. Steps are set by the covariance of the belief, as in `differences.jacobian`.
    """
    called = row.called
    assert called is not None
    size = mean.shape[0]
    x = [mean[j, 0] for j in range(size)]
    points, steps = [x], []
    for j, (number, length) in enumerate(zip(x, _lengths(cov, size), strict=True)):
        due = most(most(_PART * length, w.code.constant(_STEP)), _BESIDE * abs(number))
        steps.append((number + due) - number)
        for multiple in _AROUND:
            points.append([*x[:j], number + multiple * steps[-1], *x[j + 1 :]])
    _store(w.at(called.points), [number for point in points for number in point])
    w.ask(called.number, len(points), at)
    values, place = w.at(called.values), at % called.lines.rows
    found = [
        [values.load(k * row.height + i) for i in range(row.height)] for k in range(len(points))
    ]
    slope = []
    for i in range(row.height):
        for j, taken in enumerate(steps):
            a, b, c, d = (found[4 * j + k][i] for k in range(1, 5))
            near, far = a - b, c - d
            if i in row.angles:
                near, far = _wrapped(near), _wrapped(far)
            slope.append((8.0 * near - far) / (12.0 * taken))
    _store(w.at(called.lines.value, place), found[0])
    _store(w.at(called.lines.matrix, place), slope)
    return w.matrix(called.lines.matrix, place)


def _store(cells: Any, numbers: Sequence[Any]) -> None:
    for k, number in enumerate(numbers):
        cells.store(k, number)


def _lengths(cov: AnyMatrix, size: int) -> list[Any]:
    """The length over which a function may vary along each component, as `gaussian.lengths`."""
    stds = [sqrt(most(cov[i, i], 0.0)) for i in range(size)]
    units = [where(std > 0.0, std, 1.0) for std in stds]
    found = []
    for i, std in enumerate(stds):
        shared: Any = 0.0 * std
        for j, unit in enumerate(units):
            if i != j:
                correlation = cov[i, j] / units[i] / unit
                shared = most(shared, correlation * correlation)
        left = _TENFOLD * sqrt(most(1.0 - shared, 0.0))
        found.append(std * most(least(left, 1.0), _LEAST))
    return found


def _wrapped(angle: Any) -> Any:
    return angle - step.TURN * nearest_whole(angle / step.TURN)
