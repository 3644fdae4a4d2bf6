"""Jacobians by central differences of fourth order."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

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

    The function maps points (..., 4n, n) to their values (..., 4n, d) and is called once. The steps
    are those of `steps` for the standard deviations `std` (..., n) of x. `angles` (d,) marks the
    components of the values that are angles.
    """
    return over(function, x, steps(x, std), angles)


def over(function: Callable[[Array], Array], x: Array, step: Array, angles: Mask) -> Array:
    """The Jacobian (..., d, n) of a function at points x (..., n), by differences over given steps.

    The function maps points (..., 4n, n) to their values (..., 4n, d) and is called once. The
    derivatives are central differences of fourth order, with `step` (..., n) the step along each
    component of x. `angles` (d,) marks the components of the values that are angles, whose
    differences are wrapped to [−π, π).
    """
    lead, size = x.shape[:-1], x.shape[-1]
    step = (x + step) - x  # the step that is taken in floating point
    values = function(x[..., None, :] + _stencil(size) * step[..., None, :])
    each = values.reshape(*lead, size, 4, -1)
    near, far = each[..., 0, :] - each[..., 1, :], each[..., 2, :] - each[..., 3, :]
    for k in np.flatnonzero(angles):
        near[..., k], far[..., k] = wrap(near[..., k]), wrap(far[..., k])
    slopes: Array = (8.0 * near - far) / (12.0 * step[..., None])
    return slopes.swapaxes(-1, -2)


@lru_cache(maxsize=64)
def _stencil(size: int) -> Array:
    """The offsets (4n, n) from x, in steps, of the points at which `over` calls the function.

    For each of the n components in turn they are +1, −1, +2 and −2 along that component.
    """
    offsets = np.eye(size)[:, None, :] * np.array([1.0, -1.0, 2.0, -2.0])[:, None]
    stencil: Array = offsets.reshape(4 * size, size)
    stencil.flags.writeable = False
    return stencil
