"""Driving with constant speed and turn rate: circular arcs."""

from dataclasses import dataclass
from math import isfinite
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from models.motion import planar
from models.motion.planar import Partials
from models.sinc import sinc, sinc_slope

Array = NDArray[np.float64]


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
    u = planar.shared(u)
    return planar.move(x, *_arc(x, u[..., 0], u[..., 1], u[..., 2]))


def velocity_by_state(x: Array, u: Array) -> Array:
    """Differentiate `velocity` by (east, north, heading); returns ``(..., 3, 3)``."""
    u = planar.shared(u)
    length, course, _ = _arc(x, u[..., 0], u[..., 1], u[..., 2])
    return planar.by_state(x, length * np.cos(course), length * np.sin(course))


def velocity_by_control(x: Array, u: Array) -> Array:
    """Differentiate `velocity` by (v, ω, Δt); returns ``(..., 3, 3)``, right at ω = 0 too."""
    v, omega, dt = u[..., 0], u[..., 1], u[..., 2]
    length, course, _ = _arc(x, v, omega, dt)
    return planar.by_control(x, length, course, *_arc_partials(v, omega, dt))


def arc(x: Array, u: Array) -> Array:
    """Go a distance along a circular arc while turning, as an odometer and a gyro tell.

    `velocity` with d = v Δt and φ = ω Δt: two parts of an arc, one after the other, are the whole,
    which is not so of `travelled`.

    Parameters
    ----------
    x : array, shape (..., 3)
        East [m], north [m], heading [rad].
    u : array, shape (..., 3)
        Distance d [m], turn φ [rad], duration Δt [s], which moves nothing.

    Returns
    -------
    array, shape (..., 3)
        The state after the step; the heading is not wrapped.

    Examples
    --------
    >>> quarter = arc(np.array([0.0, 0.0, 0.0]), np.array([np.pi, np.pi / 2, 1.0]))
    >>> quarter.round(4).tolist()
    [2.0, 2.0, 1.5708]
    """
    u = planar.shared(u)
    return planar.move(x, *_arc(x, u[..., 0], u[..., 1], 1.0))


def arc_by_state(x: Array, u: Array) -> Array:
    """Differentiate `arc` by (east, north, heading); returns ``(..., 3, 3)``."""
    u = planar.shared(u)
    length, course, _ = _arc(x, u[..., 0], u[..., 1], 1.0)
    return planar.by_state(x, length * np.cos(course), length * np.sin(course))


def arc_by_control(x: Array, u: Array) -> Array:
    """Differentiate `arc` by (distance, turn, Δt), the last column 0; returns ``(..., 3, 3)``."""
    distance, turn = u[..., 0], u[..., 1]
    length, course, _ = _arc(x, distance, turn, 1.0)
    by_distance, by_turn, _ = _arc_partials(distance, turn, 1.0)
    return planar.by_control(x, length, course, by_distance, by_turn, (0.0, 0.0, 0.0))


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
        if not (isinstance(self.dt, Real) and isfinite(self.dt) and self.dt > 0):
            raise ValueError(
                f"Velocity: dt is {self.dt!r}; give the duration of a step, in seconds"
            )

    def __call__(self, x: Array, u: Array) -> Array:
        """Return the state ``(..., 3)`` after a step from x ``(..., 3)`` under u ``(..., 2)``."""
        u = planar.shared(u)
        return planar.move(x, *_arc(x, u[..., 0], u[..., 1], self.dt))

    def by_state(self, x: Array, u: Array) -> Array:
        """Differentiate by (east, north, heading); returns ``(..., 3, 3)``."""
        u = planar.shared(u)
        length, course, _ = _arc(x, u[..., 0], u[..., 1], self.dt)
        return planar.by_state(x, length * np.cos(course), length * np.sin(course))

    def by_control(self, x: Array, u: Array) -> Array:
        """Differentiate by (v, ω); returns ``(..., 3, 2)``."""
        v, omega = u[..., 0], u[..., 1]
        length, course, _ = _arc(x, v, omega, self.dt)
        return planar.by_control(x, length, course, *_arc_partials(v, omega, self.dt)[:2])


def _arc(x: Array, v: Array, omega: Array, dt: Array | float) -> tuple[Array, Array, Array]:
    """Chord of a circular arc: its length, its course, and the turn along it."""
    turn = omega * dt
    half = 0.5 * turn
    return v * dt * sinc(half), x[..., 2] + half, turn


def _arc_partials(v: Array, omega: Array, dt: Array | float) -> tuple[Partials, Partials, Partials]:
    """Differentiate `_arc` by v, ω and Δt; by Δt, v (a sinc a)' = v cos a."""
    half = 0.5 * omega * dt
    return (
        (dt * sinc(half), 0.0, 0.0),
        (0.5 * v * dt * dt * sinc_slope(half), 0.5 * dt, dt),
        (v * np.cos(half), 0.5 * omega, omega),
    )
