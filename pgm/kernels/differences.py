"""Numerical Jacobians by fourth-order central differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Mask


def steps(x: Array, std: Array) -> Array:
    """The steps of `jacobian`."""
    found: Array = np.maximum(np.maximum(1e-2 * std, 1e-4), 1e-9 * np.abs(x))
    return found


def jacobian(function: Callable[[Array], Array], x: Array, std: Array, angles: Mask) -> Array:
    """The Jacobian of a vectorised function at x, (..., n) to (..., d, n), in one call.

    Steps are max(10⁻² std, 10⁻⁴, 10⁻⁹ |x|) a component; differences of values that are angles
    are wrapped. The std may be zero.
    """
    size = x.shape[-1]
    step = steps(x, std)
    step = (x + step) - x  # the step that is taken in floating point
    offsets = np.eye(size)[:, None, :] * np.array([1.0, -1.0, 2.0, -2.0])[:, None]
    points = x[..., None, None, :] + offsets * step[..., None, None, :]
    values = function(points.reshape(*x.shape[:-1], 4 * size, size))
    values = values.reshape(*x.shape[:-1], size, 4, -1)
    near = difference(values[..., 0, :], values[..., 1, :], angles)
    far = difference(values[..., 2, :], values[..., 3, :], angles)
    slopes: Array = (8.0 * near - far) / (12.0 * step[..., None])
    return slopes.swapaxes(-1, -2)
