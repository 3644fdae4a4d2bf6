"""Functions that the program calls for machine code: their values, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pgm.kernels import step
from pgm.kernels.machine.told import Called, Row
from pgm.kernels.machine.wholes import Whole
from pgm.kernels.machine.writer import Writer
from pgm.kernels.numbers import Matrix, least, most, nearest_whole, sqrt, where

# As of `differences`: the least step, as a part of a deviation, in itself, and beside a number; and
# the multiples of a step at which a function is called.
_PART, _STEP, _BESIDE = 1e-2, 1e-4, 1e-9
_AROUND = 1.0, -1.0, 2.0, -2.0
# As of `gaussian.lengths`: a deviation given another component counts tenfold, and to a thousandth.
_TENFOLD, _LEAST = 10.0, 1e-3


def called_at(
    w: Writer, called: Called, at: Whole, points: Sequence[Sequence[Any]]
) -> list[list[Any]]:
    """The values of a function at points, in one call."""
    w.keep(called.points, Matrix(list(point) for point in points))
    w.ask(called.number, len(points), at)
    cells, (_, height) = w.at(called.values), called.values.shape
    return [[cells.load(k * height + i) for i in range(height)] for k in range(len(points))]


def tangent(
    w: Writer, row: Row, at: Whole, x: Sequence[Any], cov: Matrix
) -> tuple[list[Any], list[Any]]:
    """The value of a function, and the derivative, row by row, by differences of fourth order.

    Steps are set by the covariance of the belief about x, as in `differences.jacobian`.
    """
    assert row.called is not None
    points, steps = [list(x)], []
    for j, (number, length) in enumerate(zip(x, lengths(cov), strict=True)):
        due = most(most(_PART * length, w.code.constant(_STEP)), _BESIDE * abs(number))
        taken = (number + due) - number
        steps.append(taken)
        for multiple in _AROUND:
            points.append([*x[:j], number + multiple * taken, *x[j + 1 :]])
    value, *values = called_at(w, row.called, at, points)
    slope = []
    for i in range(row.height):
        for j, taken in enumerate(steps):
            a, b, c, d = (values[4 * j + k][i] for k in range(4))
            near, far = a - b, c - d
            if i in row.angles:
                near, far = _wrapped(near), _wrapped(far)
            slope.append((8.0 * near - far) / (12.0 * taken))
    return value, slope


def lengths(cov: Matrix) -> list[Any]:
    """The length over which a function may vary along each component, as `gaussian.lengths`."""
    stds = [sqrt(most(variance, 0.0)) for variance in cov.diagonal]
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
