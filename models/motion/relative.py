"""Poses and points as one pose sees them, and where such a sight puts them."""

import numpy as np
from numpy.typing import NDArray

from models.motion import planar
from models.motion.steps import increment, increment_by_control, increment_by_state

Array = NDArray[np.float64]


def relative(x: Array, y: Array) -> Array:
    """A pose or a point y in the frame of a pose x: the motion from x to y, −x ⊕ y.

        forward =  cos θ (y_east − east) + sin θ (y_north − north)
        left    = −sin θ (y_east − east) + cos θ (y_north − north)
        turn    = θ_y − θ

    Parameters
    ----------
    x : array, shape (..., 3)
        East [m], north [m], heading [rad].
    y : array, shape (..., 3) or (..., 2)
        A pose likewise; or a point, east [m] and north [m].

    Returns
    -------
    array, shape (..., 3) or (..., 2)
        Forward [m], left [m], and of a pose the turn [rad], which is not wrapped.

    Examples
    --------
    >>> relative(np.array([1.0, 0.0, np.pi / 2]), np.array([1.0, 2.0, np.pi])).round(3).tolist()
    [2.0, 0.0, 1.571]
    """
    cos, sin, east, north = _apart(x, y)
    out = np.empty_like(y, dtype=float, shape=(*x.shape[:-1], y.shape[-1]))
    out[..., 0], out[..., 1] = cos * east + sin * north, cos * north - sin * east
    out[..., 2:] = y[..., 2:] - x[..., 2:][..., : y.shape[-1] - 2]
    return out


def relative_by_state(x: Array, y: Array) -> Array:
    """Differentiate `relative` by (east, north, heading); returns ``(..., 3 or 2, 3)``."""
    cos, sin, east, north = _apart(x, y)
    out = planar.matrices(x, 3)
    out[..., 0, 0], out[..., 0, 1] = -cos, -sin
    out[..., 1, 0], out[..., 1, 1] = sin, -cos
    out[..., 0, 2] = cos * north - sin * east
    out[..., 1, 2] = -cos * east - sin * north
    out[..., 2, 2] = -1.0
    return out[..., : y.shape[-1], :]


def relative_by_other(x: Array, y: Array) -> Array:
    """Differentiate `relative` by y: a turn by −θ and 1; returns a square for each."""
    out = planar.matrices(x, y.shape[-1])
    out[..., 0, 0] = out[..., 1, 1] = np.cos(x[..., 2])
    out[..., 0, 1] = np.sin(x[..., 2])
    out[..., 1, 0] = -out[..., 0, 1]
    out[..., 2, 2:] = 1.0
    return out[..., : y.shape[-1], :]


def place(x: Array, s: Array) -> Array:
    """The point (..., 2) that a pose x sees at s = (forward [m], left [m])."""
    return increment(x, _still(s))[..., :2]


def place_by_state(x: Array, s: Array) -> Array:
    """Differentiate `place` by (east, north, heading); returns ``(..., 2, 3)``."""
    return increment_by_state(x, _still(s))[..., :2, :]


def place_by_sight(x: Array, s: Array) -> Array:
    """Differentiate `place` by (forward, left); returns ``(..., 2, 2)``."""
    return increment_by_control(x, _still(s))[..., :2, :2]


def retreat(x: Array, u: Array) -> Array:
    """The pose from which the motion u = (forward, left, turn) leads to x, x ⊕ (−u)."""
    return increment(x, _inverse(u))


def retreat_by_state(x: Array, u: Array) -> Array:
    """Differentiate `retreat` by (east, north, heading); returns ``(..., 3, 3)``."""
    return increment_by_state(x, _inverse(u))


def retreat_by_control(x: Array, u: Array) -> Array:
    """Differentiate `retreat` by (forward, left, turn); returns ``(..., 3, 3)``."""
    before = retreat(x, u)
    out = -increment_by_control(before, u)
    out[..., 0, 2] = before[..., 1] - x[..., 1]
    out[..., 1, 2] = x[..., 0] - before[..., 0]
    return out


def _apart(x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Cosine and sine of the heading, and how far east and north y is of x."""
    cos, sin = np.cos(x[..., 2]), np.sin(x[..., 2])
    return cos, sin, y[..., 0] - x[..., 0], y[..., 1] - x[..., 1]


def _still(s: Array) -> Array:
    """A sight as a motion that does not turn."""
    return np.concatenate([s, np.zeros_like(s[..., :1])], axis=-1)


def _inverse(u: Array) -> Array:
    """The motion back: −u seen from its end."""
    cos, sin = np.cos(u[..., 2]), np.sin(u[..., 2])
    forward, left = u[..., 0], u[..., 1]
    return np.stack([-cos * forward - sin * left, sin * forward - cos * left, -u[..., 2]], axis=-1)
