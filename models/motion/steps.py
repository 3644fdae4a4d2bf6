"""Steps that an odometer or a program tells: their lengths and turns."""

import numpy as np
from numpy.typing import NDArray

from models.motion import planar

Array = NDArray[np.float64]


def increment(x: Array, u: Array) -> Array:
    """Add a step measured in the robot's own frame: the composition of two poses, x ⊕ u.

        east'    = east  + f cos θ − l sin θ
        north'   = north + f sin θ + l cos θ
        heading' = θ + φ

    Parameters
    ----------
    x : array, shape (..., 3)
        East [m], north [m], heading [rad].
    u : array, shape (..., 3)
        Forward f [m], left l [m], turn φ [rad].

    Returns
    -------
    array, shape (..., 3)
        The state after the step; the heading is not wrapped.

    Notes
    -----
    Compounding of Smith, Self and Cheeseman (1990), section 3.2.
    """
    east, north = _body_step(x, u)
    return planar.state(x, x[..., 0] + east, x[..., 1] + north, x[..., 2] + u[..., 2])


def increment_by_state(x: Array, u: Array) -> Array:
    """Differentiate `increment` by (east, north, heading); returns ``(..., 3, 3)``."""
    return planar.by_state(x, *_body_step(x, u))


def increment_by_control(x: Array, u: Array) -> Array:
    """Differentiate `increment` by (forward, left, turn): R(θ) and 1; returns ``(..., 3, 3)``."""
    heading = x[..., 2]
    cos, sin = np.cos(heading), np.sin(heading)
    out = planar.matrices(x, 3)
    out[..., 0, 0] = cos
    out[..., 0, 1] = -sin
    out[..., 1, 0] = sin
    out[..., 1, 1] = cos
    out[..., 2, 2] = 1.0
    return out


def travelled(x: Array, u: Array) -> Array:
    """Go the distance an odometer has counted, along the mean of the old and the new heading.

        east'    = east  + d cos(θ + φ / 2)
        north'   = north + d sin(θ + φ / 2)
        heading' = θ + φ

    Parameters
    ----------
    x : array, shape (..., 3)
        East [m], north [m], heading [rad].
    u : array, shape (..., 3)
        Distance d [m], turn φ [rad], duration Δt [s]. The duration moves nothing: it is there for
        a noise that grows with it.

    Returns
    -------
    array, shape (..., 3)
        The state after the step; the heading is not wrapped.

    Notes
    -----
    The second-order Runge–Kutta odometry of Siciliano et al. (2009), section 11.7. It takes the arc
    d for its chord, d sinc(φ / 2), which is too long by d φ² / 24; `velocity` is exact.
    """
    return planar.move(x, u[..., 0], x[..., 2] + 0.5 * u[..., 1], u[..., 1])


def travelled_by_state(x: Array, u: Array) -> Array:
    """Differentiate `travelled` by (east, north, heading); returns ``(..., 3, 3)``."""
    distance, course = u[..., 0], x[..., 2] + 0.5 * u[..., 1]
    return planar.by_state(x, distance * np.cos(course), distance * np.sin(course))


def travelled_by_control(x: Array, u: Array) -> Array:
    """Differentiate `travelled` by (distance, turn, Δt), the last column 0; ``(..., 3, 3)``."""
    course = x[..., 2] + 0.5 * u[..., 1]
    return planar.by_control(
        x, u[..., 0], course, (1.0, 0.0, 0.0), (0.0, 0.5, 1.0), (0.0, 0.0, 0.0)
    )


def odometry(x: Array, u: Array) -> Array:
    """Turn on the spot, go straight, turn again.

        east'    = east  + t cos(θ + r₁)
        north'   = north + t sin(θ + r₁)
        heading' = θ + r₁ + r₂

    Parameters
    ----------
    x : array, shape (..., 3)
        East [m], north [m], heading [rad].
    u : array, shape (..., 3)
        First turn r₁ [rad], translation t [m], second turn r₂ [rad].

    Returns
    -------
    array, shape (..., 3)
        The state after the step; the heading is not wrapped.

    Notes
    -----
    The odometry model of Thrun, Burgard and Fox (2005), section 5.4.
    """
    return planar.move(x, u[..., 1], x[..., 2] + u[..., 0], u[..., 0] + u[..., 2])


def odometry_by_state(x: Array, u: Array) -> Array:
    """Differentiate `odometry` by (east, north, heading); returns ``(..., 3, 3)``."""
    translation, course = u[..., 1], x[..., 2] + u[..., 0]
    return planar.by_state(x, translation * np.cos(course), translation * np.sin(course))


def odometry_by_control(x: Array, u: Array) -> Array:
    """Differentiate `odometry` by (rot1, trans, rot2); returns ``(..., 3, 3)``."""
    course = x[..., 2] + u[..., 0]
    return planar.by_control(
        x, u[..., 1], course, (0.0, 1.0, 1.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    )


def turn_after_move(x: Array, u: Array) -> Array:
    """Go straight ahead, then turn on the spot.

        east'    = east  + d cos θ
        north'   = north + d sin θ
        heading' = θ + φ

    Parameters
    ----------
    x : array, shape (..., 3)
        East [m], north [m], heading [rad].
    u : array, shape (..., 2)
        Distance d [m], turn φ [rad].

    Returns
    -------
    array, shape (..., 3)
        The state after the step; the heading is not wrapped.
    """
    return planar.move(x, u[..., 0], x[..., 2], u[..., 1])


def turn_after_move_by_state(x: Array, u: Array) -> Array:
    """Differentiate `turn_after_move` by (east, north, heading); returns ``(..., 3, 3)``."""
    distance, course = u[..., 0], x[..., 2]
    return planar.by_state(x, distance * np.cos(course), distance * np.sin(course))


def turn_after_move_by_control(x: Array, u: Array) -> Array:
    """Differentiate `turn_after_move` by (distance, turn); returns ``(..., 3, 2)``."""
    return planar.by_control(x, u[..., 0], x[..., 2], (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


def _body_step(x: Array, u: Array) -> tuple[Array, Array]:
    """Turn (forward, left) into (east, north)."""
    forward, left = u[..., 0], u[..., 1]
    cos, sin = np.cos(x[..., 2]), np.sin(x[..., 2])
    return forward * cos - left * sin, forward * sin + left * cos
