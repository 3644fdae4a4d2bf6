"""Arcs whose turn is measured by a gyro that drifts."""

import numpy as np
from numpy.typing import NDArray

from models.motion import arcs

Array = NDArray[np.float64]


def drifting(x: Array, u: Array, b: Array) -> Array:
    """Go along an `arc` whose turn a gyro measured, with a bias: φ − b Δt in place of φ.

    Parameters
    ----------
    x : array, shape (..., 3)
        East [m], north [m], heading [rad].
    u : array, shape (..., 3)
        Distance [m], measured turn φ [rad], duration Δt [s].
    b : array, shape (..., 1)
        The bias [rad/s], by which the gyro tells too much.

    Returns
    -------
    array, shape (..., 3)
        The state after the step; the heading is not wrapped.
    """
    return arcs.arc(x, _corrected(u, b))


def drifting_by_state(x: Array, u: Array, b: Array) -> Array:
    """Differentiate `drifting` by (east, north, heading); returns ``(..., 3, 3)``."""
    return arcs.arc_by_state(x, _corrected(u, b))


def drifting_by_control(x: Array, u: Array, b: Array) -> Array:
    """Differentiate `drifting` by (distance, turn, Δt); returns ``(..., 3, 3)``."""
    out = arcs.arc_by_control(x, _corrected(u, b))
    out[..., 2] = -b * out[..., 1]
    return out


def drifting_by_bias(x: Array, u: Array, b: Array) -> Array:
    """Differentiate `drifting` by the bias; returns ``(..., 3, 1)``."""
    out: Array = -u[..., 2, None, None] * arcs.arc_by_control(x, _corrected(u, b))[..., 1:2]
    return out


def _corrected(u: Array, b: Array) -> Array:
    """Controls with the turn that the gyro should have told."""
    out = np.empty_like(u, dtype=float, shape=np.broadcast_shapes(u.shape, (*b.shape[:-1], 3)))
    out[..., 0], out[..., 2] = u[..., 0], u[..., 2]
    out[..., 1] = u[..., 1] - u[..., 2] * b[..., 0]
    return out
