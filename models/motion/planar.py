"""Go straight and turn: the step that the motion models share, and its derivatives."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Partials = tuple[Array | float, Array | float, Array | float]


def shared(u: Array) -> Array:
    """Controls (..., d) without the repeats that broadcasting makes, which it makes again."""
    if 0 not in u.strides[:-1]:
        return u
    return u[tuple(slice(None if stride else 1) for stride in u.strides[:-1])]


def state(x: Array, east: Array, north: Array, heading: Array) -> Array:
    """Stack components to states, in memory as the states x are."""
    out = np.empty_like(x, dtype=float)
    out[..., 0], out[..., 1], out[..., 2] = east, north, heading
    return out


def matrices(x: Array, columns: int) -> Array:
    """Zeros (..., 3, columns) for states x; entries of many states are contiguous in memory."""
    memory = np.zeros((3, columns, *x.shape[:-1]))
    return memory.transpose(*range(2, memory.ndim), 0, 1)


def move(x: Array, length: Array, course: Array, turn: Array) -> Array:
    """Go straight for ``length`` along ``course`` (from east), and turn."""
    return state(
        x,
        x[..., 0] + length * np.cos(course),
        x[..., 1] + length * np.sin(course),
        x[..., 2] + turn,
    )


def by_state(x: Array, east: Array, north: Array) -> Array:
    """Jacobian by x of any model that moved the robot by (east, north)."""
    out = matrices(x, 3)
    out[..., 0, 0] = out[..., 1, 1] = out[..., 2, 2] = 1.0
    out[..., 0, 2] = -north
    out[..., 1, 2] = east
    return out


def by_control(x: Array, length: Array, course: Array, *columns: Partials) -> Array:
    """Chain rule through `move`: a column is ∂(length, course, turn) by one component of u."""
    cos, sin = np.cos(course), np.sin(course)
    out = matrices(x, len(columns))
    for j, (by_length, by_course, by_turn) in enumerate(columns):
        out[..., 0, j] = by_length * cos - by_course * length * sin
        out[..., 1, j] = by_length * sin + by_course * length * cos
        out[..., 2, j] = by_turn
    return out
