"""Sensors at the robot's reference point that read what geometry has, and their derivatives."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def pose(x: Array) -> Array:
    """Sense the whole state: east [m], north [m] and heading [rad], ``(..., 3)``; x itself."""
    return x


def pose_by_state(x: Array) -> Array:
    """Differentiate `pose`: the identity, ``(..., 3, 3)``."""
    return _identity(x, 3)


def position(x: Array) -> Array:
    """Sense east [m] and north [m], ``(..., 2)``; a view of x."""
    here: Array = x[..., :2]
    return here


def position_by_state(x: Array) -> Array:
    """Differentiate `position`: the first two rows of the identity, ``(..., 2, 3)``."""
    return _identity(x, 2)


def heading(x: Array) -> Array:
    """Sense the heading [rad], ``(..., 1)``, as an inertial unit does; a view of x, not wrapped."""
    ahead: Array = x[..., 2:3]
    return ahead


def heading_by_state(x: Array) -> Array:
    """Differentiate `heading`: the last row of the identity, ``(..., 1, 3)``."""
    return _identity(x, 3)[..., 2:, :]


def range_only(x: Array, m: Array) -> Array:
    """Sense the distance to a landmark.

        r = √((m_east − east)² + (m_north − north)²)

    Parameters
    ----------
    x : array, shape (..., 3)
        East [m], north [m], heading [rad].
    m : array, shape (..., 2)
        The landmark's east [m] and north [m].

    Returns
    -------
    array, shape (..., 1)
        The range [m].

    Examples
    --------
    >>> range_only(np.array([1.0, 1.0, 0.0]), np.array([4.0, 5.0])).tolist()
    [5.0]
    """
    return _offset(x, m)[2][..., None]


def range_only_by_state(x: Array, m: Array) -> Array:
    """Differentiate `range_only` by (east, north, heading), ``(..., 1, 3)``; NaN at range 0."""
    east, north, _ = _sight(x, m)
    out = _zeros(x, 1)
    out[..., 0, 0] = -east
    out[..., 0, 1] = -north
    return out


def range_only_by_landmark(x: Array, m: Array) -> Array:
    """Differentiate `range_only` by (m_east, m_north), ``(..., 1, 2)``; NaN at range 0."""
    return _by_landmark(range_only_by_state(x, m))


def bearing_only(x: Array, m: Array) -> Array:
    """Sense the direction to a landmark from the robot's heading, as a camera does.

        β = atan2(m_north − north, m_east − east) − θ

    Parameters
    ----------
    x : array, shape (..., 3)
        East [m], north [m], heading [rad].
    m : array, shape (..., 2)
        The landmark's east [m] and north [m].

    Returns
    -------
    array, shape (..., 1)
        The bearing [rad], anticlockwise from straight ahead, wrapped to [−π, π).

    Examples
    --------
    >>> bearing_only(np.array([1.0, 1.0, 0.0]), np.array([1.0, 3.0])).round(4).tolist()
    [1.5708]
    """
    return range_bearing(x, m)[..., 1:]


def bearing_only_by_state(x: Array, m: Array) -> Array:
    """Differentiate `bearing_only` by (east, north, heading), ``(..., 1, 3)``; NaN at range 0."""
    return range_bearing_by_state(x, m)[..., 1:, :]


def bearing_only_by_landmark(x: Array, m: Array) -> Array:
    """Differentiate `bearing_only` by (m_east, m_north), ``(..., 1, 2)``; NaN at range 0."""
    return range_bearing_by_landmark(x, m)[..., 1:, :]


def range_bearing(x: Array, m: Array) -> Array:
    """Sense the distance to a landmark and its direction from the robot's heading.

        r = √((m_east − east)² + (m_north − north)²)
        β = atan2(m_north − north, m_east − east) − θ

    Parameters
    ----------
    x : array, shape (..., 3)
        East [m], north [m], heading [rad].
    m : array, shape (..., 2)
        The landmark's east [m] and north [m].

    Returns
    -------
    array, shape (..., 2)
        Range [m] and bearing [rad], anticlockwise from straight ahead, wrapped to [−π, π).

    Notes
    -----
    The feature model of Thrun, Burgard and Fox (2005), section 6.6, known correspondence.

    Examples
    --------
    >>> range_bearing(np.array([1.0, 1.0, 0.0]), np.array([1.0, 3.0])).round(4).tolist()
    [2.0, 1.5708]
    """
    east, north, distance = _offset(x, m)
    out = np.empty_like(x, dtype=float, shape=(*x.shape[:-1], 2))
    out[..., 0] = distance
    out[..., 1] = _wrap(np.arctan2(north, east) - x[..., 2])
    return out


def range_bearing_by_state(x: Array, m: Array) -> Array:
    """Differentiate `range_bearing` by (east, north, heading), ``(..., 2, 3)``; NaN at range 0."""
    west, south, distance = _sight(m, x)
    out = _zeros(x, 2)
    out[..., 0, 0] = west
    out[..., 0, 1] = south
    out[..., 1, 0] = -south / distance
    out[..., 1, 1] = west / distance
    out[..., 1, 2] = -1.0
    return out


def range_bearing_by_landmark(x: Array, m: Array) -> Array:
    """Differentiate `range_bearing` by (m_east, m_north), ``(..., 2, 2)``; NaN at range 0."""
    return _by_landmark(range_bearing_by_state(x, m))


def _offset(x: Array, m: Array) -> tuple[Array, Array, Array]:
    """Return how far east and north the landmark is of the robot, and the range."""
    east, north = m[..., 0] - x[..., 0], m[..., 1] - x[..., 1]
    return east, north, np.sqrt(east * east + north * north)  # np.hypot takes five times as long


def _sight(x: Array, m: Array) -> tuple[Array, Array, Array]:
    """Return the unit vector (east, north) to the landmark, NaN at range 0, and the range."""
    east, north, distance = _offset(x, m)
    with np.errstate(invalid="ignore"):
        return east / distance, north / distance, distance


def _by_landmark(by_state: Array) -> Array:
    """Only the landmark's offset from the robot counts: to move one is to move the other back."""
    moved: Array = -by_state[..., :2]
    return moved


def _identity(x: Array, rows: int) -> Array:
    """Return the first ``rows`` rows of the 3 × 3 identity, once for every state."""
    out = _zeros(x, rows)
    for k in range(rows):
        out[..., k, k] = 1.0
    return out


def _zeros(x: Array, rows: int) -> Array:
    """Zeros (..., rows, 3) for states x; entries of many states are contiguous in memory."""
    memory = np.zeros((rows, 3, *x.shape[:-1]))
    return memory.transpose(*range(2, memory.ndim), 0, 1)


def _wrap(angle: Array) -> Array:
    """Move angles to [−π, π) by whole turns."""
    wrapped = angle - 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))
    lowest: Array = np.maximum(wrapped, -np.pi)  # rounding can pass that end by a last digit
    return lowest
