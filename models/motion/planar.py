"""Go straight and turn: the step that the motion models share, and its derivatives."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Partials = tuple[Array | float, Array | float, Array | float]


def move(x: Array, length: Array, course: Array, turn: Array) -> Array:
    """Go straight for ``length`` along ``course`` (from east), and turn."""
    out = np.empty(x.shape)
    out[..., 0] = x[..., 0] + length * np.cos(course)
    out[..., 1] = x[..., 1] + length * np.sin(course)
    out[..., 2] = x[..., 2] + turn
    return out


def by_state(x: Array, east: Array, north: Array) -> Array:
    """Jacobian by x of any model that moved the robot by (east, north)."""
    out = np.zeros((*x.shape[:-1], 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = out[..., 2, 2] = 1.0
    out[..., 0, 2] = -north
    out[..., 1, 2] = east
    return out


def by_control(x: Array, length: Array, course: Array, *columns: Partials) -> Array:
    """Chain rule through `move`: a column is ∂(length, course, turn) by one component of u."""
    cos, sin = np.cos(course), np.sin(course)
    out = np.empty((*x.shape[:-1], 3, len(columns)))
    for j, (by_length, by_course, by_turn) in enumerate(columns):
        out[..., 0, j] = by_length * cos - by_course * length * sin
        out[..., 1, j] = by_length * sin + by_course * length * cos
        out[..., 2, j] = by_turn
    return out
