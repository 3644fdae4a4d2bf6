"""How a planar robot moves: the state is x = (east [m], north [m], heading θ [rad]).

Each model turns its control u into a step seen from the robot, b(u), and a turn φ(u):

    p' = p + R(θ) b(u),    θ' = θ + φ(u).

So ∂p'/∂θ is the step R(θ) b turned by a quarter, whatever the model. Headings are anticlockwise
from east and stay on one unwrapped chart: no model wraps them.

Functions are called ``function(x, u)`` with equal leading axes (``...``) and return ``(..., 3)``.
The Jacobians ``function_by_state`` and ``function_by_control`` take the same arguments and return
``(..., 3, 3)``: rows are the components of x', columns those of x or of u.
"""

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Partials = tuple[Array | float, Array | float, Array | float]


def velocity(x: Array, u: Array) -> Array:
    """Drive with constant speed and turn rate: a circular arc, or a straight line at ω = 0.

    With the chord c = v Δt sinc(ω Δt / 2), where sinc a = sin a / a,

        east'    = east  + c cos(θ + ω Δt / 2)
        north'   = north + c sin(θ + ω Δt / 2)
        heading' = θ + ω Δt.

    Parameters
    ----------
    x : array, shape (..., 3)
        East [m], north [m], heading [rad].
    u : array, shape (..., 3)
        Speed v [m/s], turn rate ω [rad/s], duration Δt [s].

    Returns
    -------
    array, shape (..., 3)
        The state after the step; the heading is not wrapped.

    Notes
    -----
    This is the velocity model of Thrun, Burgard and Fox (2005), section 5.3, without the division
    by ω: it is smooth through ω = 0 and keeps all its digits there.

    Examples
    --------
    >>> velocity(np.array([0.0, 0.0, 0.0]), np.array([2.0, 0.0, 1.5])).tolist()
    [3.0, 0.0, 0.0]
    """
    return _move(x, *_arc(x, u[..., 0], u[..., 1], u[..., 2]))


def velocity_by_state(x: Array, u: Array) -> Array:
    """Differentiate `velocity` by (east, north, heading); returns ``(..., 3, 3)``."""
    length, course, _ = _arc(x, u[..., 0], u[..., 1], u[..., 2])
    return _by_state(x, length * np.cos(course), length * np.sin(course))


def velocity_by_control(x: Array, u: Array) -> Array:
    """Differentiate `velocity` by (v, ω, Δt); returns ``(..., 3, 3)``, right at ω = 0 too."""
    v, omega, dt = u[..., 0], u[..., 1], u[..., 2]
    length, course, _ = _arc(x, v, omega, dt)
    return _by_control(x, length, course, *_arc_partials(v, omega, dt))


@dataclass(frozen=True, slots=True)
class Velocity:
    """The motion of `velocity` over steps of one fixed duration: u = (v [m/s], ω [rad/s]).

    Parameters
    ----------
    dt : float
        Duration of every step [s], positive.

    Raises
    ------
    ValueError
        Where ``dt`` is not a positive, finite number.

    Examples
    --------
    >>> drive = Velocity(dt=1.5)
    >>> drive(np.array([0.0, 0.0, 0.0]), np.array([2.0, 0.0])).tolist()
    [3.0, 0.0, 0.0]
    """

    dt: float

    def __post_init__(self) -> None:
        if not (isfinite(self.dt) and self.dt > 0):
            raise ValueError(
                f"Velocity: dt is {self.dt!r}; give the duration of a step, in seconds"
            )

    def __call__(self, x: Array, u: Array) -> Array:
        """Return the state ``(..., 3)`` after a step from x ``(..., 3)`` under u ``(..., 2)``."""
        return _move(x, *_arc(x, u[..., 0], u[..., 1], self.dt))

    def by_state(self, x: Array, u: Array) -> Array:
        """Differentiate by (east, north, heading); returns ``(..., 3, 3)``."""
        length, course, _ = _arc(x, u[..., 0], u[..., 1], self.dt)
        return _by_state(x, length * np.cos(course), length * np.sin(course))

    def by_control(self, x: Array, u: Array) -> Array:
        """Differentiate by (v, ω); returns ``(..., 3, 2)``."""
        v, omega = u[..., 0], u[..., 1]
        length, course, _ = _arc(x, v, omega, self.dt)
        return _by_control(x, length, course, *_arc_partials(v, omega, self.dt)[:2])


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
    out = np.empty(x.shape)
    out[..., 0] = x[..., 0] + east
    out[..., 1] = x[..., 1] + north
    out[..., 2] = x[..., 2] + u[..., 2]
    return out


def increment_by_state(x: Array, u: Array) -> Array:
    """Differentiate `increment` by (east, north, heading); returns ``(..., 3, 3)``."""
    return _by_state(x, *_body_step(x, u))


def increment_by_control(x: Array, u: Array) -> Array:
    """Differentiate `increment` by (forward, left, turn): R(θ) and 1; returns ``(..., 3, 3)``."""
    heading = x[..., 2]
    cos, sin = np.cos(heading), np.sin(heading)
    out = np.zeros((*heading.shape, 3, 3))
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
    return _move(x, u[..., 0], x[..., 2] + 0.5 * u[..., 1], u[..., 1])


def travelled_by_state(x: Array, u: Array) -> Array:
    """Differentiate `travelled` by (east, north, heading); returns ``(..., 3, 3)``."""
    distance, course = u[..., 0], x[..., 2] + 0.5 * u[..., 1]
    return _by_state(x, distance * np.cos(course), distance * np.sin(course))


def travelled_by_control(x: Array, u: Array) -> Array:
    """Differentiate `travelled` by (distance, turn, Δt), the last column 0; ``(..., 3, 3)``."""
    course = x[..., 2] + 0.5 * u[..., 1]
    return _by_control(x, u[..., 0], course, (1.0, 0.0, 0.0), (0.0, 0.5, 1.0), (0.0, 0.0, 0.0))


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
    return _move(x, u[..., 1], x[..., 2] + u[..., 0], u[..., 0] + u[..., 2])


def odometry_by_state(x: Array, u: Array) -> Array:
    """Differentiate `odometry` by (east, north, heading); returns ``(..., 3, 3)``."""
    translation, course = u[..., 1], x[..., 2] + u[..., 0]
    return _by_state(x, translation * np.cos(course), translation * np.sin(course))


def odometry_by_control(x: Array, u: Array) -> Array:
    """Differentiate `odometry` by (rot1, trans, rot2); returns ``(..., 3, 3)``."""
    course = x[..., 2] + u[..., 0]
    return _by_control(x, u[..., 1], course, (0.0, 1.0, 1.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


def _move(x: Array, length: Array, course: Array, turn: Array) -> Array:
    """Go straight for ``length`` along ``course`` (from east), and turn."""
    out = np.empty(x.shape)
    out[..., 0] = x[..., 0] + length * np.cos(course)
    out[..., 1] = x[..., 1] + length * np.sin(course)
    out[..., 2] = x[..., 2] + turn
    return out


def _by_state(x: Array, east: Array, north: Array) -> Array:
    """Jacobian by x of any model that moved the robot by (east, north)."""
    out = np.zeros((*x.shape[:-1], 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = out[..., 2, 2] = 1.0
    out[..., 0, 2] = -north
    out[..., 1, 2] = east
    return out


def _by_control(x: Array, length: Array, course: Array, *columns: Partials) -> Array:
    """Chain rule through `_move`: a column is ∂(length, course, turn) by one component of u."""
    cos, sin = np.cos(course), np.sin(course)
    out = np.empty((*x.shape[:-1], 3, len(columns)))
    for j, (by_length, by_course, by_turn) in enumerate(columns):
        out[..., 0, j] = by_length * cos - by_course * length * sin
        out[..., 1, j] = by_length * sin + by_course * length * cos
        out[..., 2, j] = by_turn
    return out


def _body_step(x: Array, u: Array) -> tuple[Array, Array]:
    """Turn (forward, left) into (east, north)."""
    forward, left = u[..., 0], u[..., 1]
    cos, sin = np.cos(x[..., 2]), np.sin(x[..., 2])
    return forward * cos - left * sin, forward * sin + left * cos


def _arc(x: Array, v: Array, omega: Array, dt: Array | float) -> tuple[Array, Array, Array]:
    """Chord of a circular arc: its length, its course, and the turn along it."""
    turn = omega * dt
    half = 0.5 * turn
    return v * dt * _sinc(half), x[..., 2] + half, turn


def _arc_partials(v: Array, omega: Array, dt: Array | float) -> tuple[Partials, Partials, Partials]:
    """Differentiate `_arc` by v, ω and Δt; by Δt, v (a sinc a)' = v cos a."""
    half = 0.5 * omega * dt
    return (
        (dt * _sinc(half), 0.0, 0.0),
        (0.5 * v * dt * dt * _sinc_slope(half), 0.5 * dt, dt),
        (v * np.cos(half), 0.5 * omega, omega),
    )


def _sinc(a: Array) -> Array:
    """Return sin a / a, 1 at a = 0."""
    nonzero = np.where(a == 0.0, 1e-20, a)  # sin a / a rounds to 1 there
    quotient: Array = np.sin(nonzero) / nonzero
    return quotient


def _sinc_slope(a: Array) -> Array:
    """Return the derivative of sin a / a: its series below 1/4, where the quotient cancels."""
    near = np.abs(a) < 0.25
    small, large = np.where(near, a, 0.0), np.where(near, 1.0, a)
    s = small * small
    series = -small / 3 * (1 - s / 10 * (1 - s / 28 * (1 - s / 54 * (1 - s / 88))))
    return np.where(near, series, (np.cos(large) - np.sin(large) / large) / large)
