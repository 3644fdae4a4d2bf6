"""Jacobians by central differences of fourth order."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgm.kernels.angles import wrap
from pgm.kernels.arrays import Array, Mask


def steps(x: Array, std: Array) -> Array:
    """The steps of differences at points x, (..., n) both: max(10⁻² std, 10⁻⁴, 10⁻⁹ |x|).

    `std` (..., n) are the standard deviations of x.
    """
    found: Array = np.maximum(np.maximum(1e-2 * std, 1e-4), 1e-9 * np.abs(x))
    return found


def jacobian(function: Callable[[Array], Array], x: Array, std: Array, angles: Mask) -> Array:
    """The Jacobian (..., d, n) of a function at points x (..., n), by differences.

    The function maps points (..., 4n, n) to their values (..., 4n, d) and is called once. The step
    along each component is max(10⁻² std, 10⁻⁴, 10⁻⁹ |x|), with the standard deviations `std` (...,
    n) of x. `angles` (d,) marks the components of the values that are angles, whose differences are
    wrapped to [−π, π).
    """
    return over(function, x, steps(x, std), angles)


def over(function: Callable[[Array], Array], x: Array, step: Array, angles: Mask) -> Array:
    """The Jacobian (..., d, n) of a function at points x (..., n), by differences over given steps.

    The function maps points (..., 4n, n) to their values (..., 4n, d) and is called once. The
    derivatives are central differences of fourth order, with `step` (..., n) the step along each
    component of x. `angles` (d,) marks the components of the values that are angles, whose
    differences are wrapped to [−π, π).
    """
    step = taken(x, step)
    moves = step[..., None] * np.eye(x.shape[-1])
    slopes: Array = along(function, x, moves, angles) / (12.0 * step[..., None, :])
    return slopes


def taken(x: Array, step: Array) -> Array:
    """The steps (..., n) from x (..., n) that are taken in floating point: (x + step) − x."""
    found: Array = (x + step) - x
    return found


def along(function: Callable[[Array], Array], x: Array, moves: Array, angles: Mask) -> Array:
    """Twelve times the change of a function along moves (..., m, n) from points x (..., n).

    Of each move v it is 12 J v, (..., d, m), but for terms in the fifth derivative of the function
    f, whose Jacobian is J; see `change`. The function takes points (..., 4m, n) to values
    (..., 4m, d); `angles` (d,) marks the components of the values that are angles, whose
    differences are wrapped to [−π, π).
    """
    lead, (count, size) = x.shape[:-1], moves.shape[-2:]
    points = around(x[..., None, :], moves)
    values = function(points.reshape(*lead, 4 * count, size)).reshape(*lead, count, 4, -1)
    return change(values, angles)


def around(x: Array, moves: Array) -> Array:
    """The points (..., 4, n) about x (..., n), one and two moves (..., n) to either side."""
    found: Array = x[..., None, :] + _AROUND[:, None] * moves[..., None, :]
    return found


def change(values: Array, angles: Mask) -> Array:
    """Twelve times the change of a function by its values (..., m, 4, d) `around` m moves.

    Of each move v it is 8 (f(x + v) − f(x − v)) − (f(x + 2v) − f(x − 2v)), (..., d, m).
    """
    near, far = values[..., 0, :] - values[..., 1, :], values[..., 2, :] - values[..., 3, :]
    for k in np.flatnonzero(angles):
        near[..., k], far[..., k] = wrap(near[..., k]), wrap(far[..., k])
    found: Array = 8.0 * near - far
    return found.swapaxes(-1, -2)


# The multiples of a move at which the function is called.
_AROUND = np.array([1.0, -1.0, 2.0, -2.0])
