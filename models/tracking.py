"""How a tracked target moves when nobody tells its controls.

The state of constant velocity is x = (east [m], north [m], v_east [m/s], v_north [m/s]), with
``axes=1`` or 3 that of a line or of space; that of constant acceleration has the accelerations
behind it, and that of the coordinated turn the turn rate ω [rad/s], anticlockwise. What is not
known of the motion enters as noise whose covariance is given here, and which may be singular.

Durations may differ from step to step: of durations (T,) matrices and covariances are stacks,
which `pgm.LinearGaussianCPD` takes as they are. Any other linear motion in continuous time is
discretised by `models.continuous`.

Sources: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation
(2001).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from models.continuous import durations
from models.sinc import sinc, sinc_slope

Array = NDArray[np.float64]


def constant_velocity(dt: npt.ArrayLike, *, axes: int = 2) -> Array:
    """The transition matrix of constant velocity over a step, p' = p + Δt v, v' = v.

    Parameters
    ----------
    dt : float or array, shape (...)
        Duration of the step [s], 0 or more. Of durations (T,) the stack (T, 2 axes, 2 axes) is what
        a `pgm.LinearGaussianCPD` takes for steps that differ.
    axes : int
        Of the place: 1 along a line, 2 in the plane, 3 in space. All positions come first, then
        all velocities.

    Returns
    -------
    array, shape (..., 2 axes, 2 axes)

    Raises
    ------
    ValueError
        Where a duration is negative or not finite.

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan (2001), section 6.2.2.

    Examples
    --------
    >>> (constant_velocity(2.0) @ [0.0, 0.0, 1.0, -1.0]).tolist()
    [2.0, -2.0, 1.0, -1.0]
    """
    return _each(axes, _steadily(durations(dt)))


def constant_acceleration(dt: npt.ArrayLike, *, axes: int = 2) -> Array:
    """The transition matrix of constant acceleration, p' = p + Δt v + Δt²/2 a, v' = v + Δt a.

    Parameters
    ----------
    dt, axes
        As of `constant_velocity`. Positions come first, then velocities, then accelerations.

    Returns
    -------
    array, shape (..., 3 axes, 3 axes)

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan (2001), section 6.2.3.

    Examples
    --------
    >>> (constant_acceleration(2.0, axes=1) @ [0.0, 0.0, 3.0]).tolist()
    [6.0, 6.0, 3.0]
    """
    dt = durations(dt)
    return _each(axes, [[1.0, dt, dt**2 / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])


def steady(x: Array, dt: Array) -> Array:
    """The target's state ``(..., 4)`` after a duration ``(..., 1)`` [s] of constant velocity."""
    moved: Array = (steady_by_state(x, dt) @ x[..., None])[..., 0]
    return moved


def steady_by_state(x: Array, dt: Array) -> Array:
    """Differentiate `steady` by the state: `constant_velocity`, ``(..., 4, 4)``."""
    return _each(2, _steadily(dt[..., 0]))


def white_acceleration(dt: npt.ArrayLike, density: float, *, axes: int = 2) -> Array:
    """The covariance over a step of white-noise acceleration, independent along each axis.

        q [[Δt³/3, Δt²/2], [Δt²/2, Δt]] for a coordinate and its velocity

    Parameters
    ----------
    dt, axes
        As of `constant_velocity`.
    density : float
        The power spectral density q [m²/s³], 0 or more; 0 is an exact constant velocity.

    Returns
    -------
    array, shape (..., 2 axes, 2 axes)
        Of full rank where q > 0 and Δt > 0.

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan (2001), section 6.2.2.
    """
    dt = durations(dt)
    return density * _each(axes, [[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])


def white_jerk(dt: npt.ArrayLike, density: float, *, axes: int = 2) -> Array:
    """The covariance over a step of white-noise jerk, of a nearly constant acceleration.

        q [[Δt⁵/20, Δt⁴/8, Δt³/6], [Δt⁴/8, Δt³/3, Δt²/2], [Δt³/6, Δt²/2, Δt]]

    Parameters
    ----------
    dt, axes
        As of `constant_acceleration`.
    density : float
        The power spectral density q [m²/s⁵], 0 or more.

    Returns
    -------
    array, shape (..., 3 axes, 3 axes)

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan (2001), section 6.2.3.
    """
    dt = durations(dt)
    block = [
        [dt**5 / 20, dt**4 / 8, dt**3 / 6],
        [dt**4 / 8, dt**3 / 3, dt**2 / 2],
        [dt**3 / 6, dt**2 / 2, dt],
    ]
    return density * _each(axes, block)


def held_acceleration(dt: npt.ArrayLike, std: float, *, axes: int = 2) -> Array:
    """The covariance over a step of an acceleration that is drawn anew, and held, at each step.

        Γ σ² Γᵀ for a coordinate and its velocity, Γ = (Δt²/2, Δt)

    It is piecewise constant white noise: unlike `white_acceleration` it depends on how time is cut
    into steps, which is right where the steps are those of the acceleration.

    Parameters
    ----------
    dt, axes
        As of `constant_velocity`.
    std : float
        σ, of the acceleration along each axis [m/s²].

    Returns
    -------
    array, shape (..., 2 axes, 2 axes)
        Of rank 1 for each axis: position and velocity err together.

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan (2001), section 6.3.2.
    """
    dt = durations(dt)
    return std**2 * _each(axes, _outer([dt**2 / 2, dt]))


def jumping_acceleration(dt: npt.ArrayLike, std: float, *, axes: int = 2) -> Array:
    """The covariance over a step of an acceleration that jumps as the step begins.

        Γ σ² Γᵀ for a coordinate, its velocity and its acceleration, Γ = (Δt²/2, Δt, 1)

    A Wiener process of accelerations that are piecewise constant, beside `constant_acceleration`.

    Parameters
    ----------
    dt, axes
        As of `constant_acceleration`.
    std : float
        σ, of the jump along each axis [m/s²], whatever the duration.

    Returns
    -------
    array, shape (..., 3 axes, 3 axes)
        Of rank 1 for each axis.

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan (2001), section 6.3.3.
    """
    dt = durations(dt)
    return std**2 * _each(axes, _outer([dt**2 / 2, dt, 1.0 + 0.0 * dt]))


def known_turn(dt: npt.ArrayLike, rate: npt.ArrayLike) -> Array:
    """The transition matrix of a turn at a known rate ω [rad/s], anticlockwise.

    At ω = 0 it is that of constant velocity. Where the rate is not known it is a state: see
    `CoordinatedTurn`.

    Parameters
    ----------
    dt : float or array, shape (...)
        Duration of the step [s], 0 or more.
    rate : float or array, shape (...)
        ω; both broadcast.

    Returns
    -------
    array, shape (..., 4, 4)

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan (2001), section 11.7.
    """
    along, across, cos, sin = _turn(durations(dt), np.asarray(rate, dtype=float))
    rows = [
        [1.0, 0.0, along, -across],
        [0.0, 1.0, across, along],
        [0.0, 0.0, cos, -sin],
        [0.0, 0.0, sin, cos],
    ]
    return _each(1, rows)


@dataclass(frozen=True, slots=True)
class CoordinatedTurn:
    """Turn with a constant rate and a constant speed, a straight line at ω = 0.

    With a = ω Δt, s = Δt sin a / a and c = Δt (1 − cos a) / a,

        east'  = east  + s v_east − c v_north,    v_east'  = v_east cos a − v_north sin a
        north' = north + c v_east + s v_north,    v_north' = v_east sin a + v_north cos a
        ω'     = ω.

    Parameters
    ----------
    dt : float
        Duration of every step [s], positive; where they differ, `turning` takes it as an input.

    Raises
    ------
    ValueError
        Where ``dt`` is not a positive, finite number.

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan (2001), section 11.7, without the division by ω: it is smooth
    through ω = 0 and keeps all its digits there.

    Examples
    --------
    >>> turn = CoordinatedTurn(dt=1.5)
    >>> turn(np.array([0.0, 0.0, 2.0, 0.0, 0.0])).tolist()
    [3.0, 0.0, 2.0, 0.0, 0.0]
    """

    dt: float

    def __post_init__(self) -> None:
        if not (isinstance(self.dt, Real) and isfinite(self.dt) and self.dt > 0):
            raise ValueError(
                f"CoordinatedTurn: dt is {self.dt!r}; give the duration of a step, in seconds"
            )

    def __call__(self, x: Array) -> Array:
        """Return the state ``(..., 5)`` after a step from x ``(..., 5)``."""
        return _turned(x, self.dt)

    def by_state(self, x: Array) -> Array:
        """Differentiate by the state; returns ``(..., 5, 5)``, right at ω = 0 too."""
        return _turned_by_state(x, self.dt)

    def noise(self, acceleration: float, turn_acceleration: float) -> Array:
        """The covariance of accelerations held at each step, (5, 5): `turn_noise`."""
        return turn_noise(self.dt, acceleration, turn_acceleration)


def turning(x: Array, dt: Array) -> Array:
    """The state ``(..., 5)`` after a duration ``(..., 1)`` [s] of a `CoordinatedTurn`."""
    return _turned(x, dt[..., 0])


def turning_by_state(x: Array, dt: Array) -> Array:
    """Differentiate `turning` by the state; returns ``(..., 5, 5)``, right at ω = 0 too."""
    return _turned_by_state(x, dt[..., 0])


def turn_noise(dt: npt.ArrayLike, acceleration: float, turn_acceleration: float) -> Array:
    """The covariance, for a turning target, of accelerations drawn anew, and held, at each step.

    Parameters
    ----------
    dt : float or array, shape (...)
        Duration of the step [s], 0 or more.
    acceleration : float
        Standard deviation in each coordinate [m/s²].
    turn_acceleration : float
        Standard deviation of the turn rate's change [rad/s²].

    Returns
    -------
    array, shape (..., 5, 5)
        Of rank 3.
    """
    every = durations(dt)
    out = np.zeros((*every.shape, 5, 5))
    out[..., :4, :4] = held_acceleration(every, acceleration)
    out[..., 4, 4] = (every * turn_acceleration) ** 2
    return out


def _turned(x: Array, dt: Array | float) -> Array:
    east, north = x[..., 2], x[..., 3]
    along, across, cos, sin = _turn(dt, x[..., 4])
    out = np.empty(x.shape)
    out[..., 0] = x[..., 0] + along * east - across * north
    out[..., 1] = x[..., 1] + across * east + along * north
    out[..., 2] = cos * east - sin * north
    out[..., 3] = sin * east + cos * north
    out[..., 4] = x[..., 4]
    return out


def _turned_by_state(x: Array, dt: Array | float) -> Array:
    east, north = x[..., 2], x[..., 3]
    along, across, cos, sin = _turn(dt, x[..., 4])
    half = 0.5 * dt * x[..., 4]
    along_slope = dt**2 * sinc_slope(2 * half)
    across_slope = dt**2 * (0.5 * np.cos(half) * sinc(half) + 0.5 * np.sin(half) * sinc_slope(half))
    out = np.zeros((*x.shape, 5))
    out[..., 0, 0] = out[..., 1, 1] = out[..., 4, 4] = 1.0
    out[..., 0, 2] = out[..., 1, 3] = along
    out[..., 0, 3] = -across
    out[..., 1, 2] = across
    out[..., 2, 2] = out[..., 3, 3] = cos
    out[..., 2, 3] = -sin
    out[..., 3, 2] = sin
    out[..., 0, 4] = along_slope * east - across_slope * north
    out[..., 1, 4] = across_slope * east + along_slope * north
    out[..., 2, 4] = dt * (-sin * east - cos * north)
    out[..., 3, 4] = dt * (cos * east - sin * north)
    return out


def _turn(dt: Array | float, omega: Array) -> tuple[Array, Array, Array, Array]:
    """Return s, c, cos a and sin a; 1 − cos a = 2 sin² (a/2) loses no digits."""
    turn = dt * omega
    half = 0.5 * turn
    return dt * sinc(turn), dt * np.sin(half) * sinc(half), np.cos(turn), np.sin(turn)


def _steadily(dt: Array) -> list[list[Any]]:
    """The block of constant velocity for a coordinate and its velocity."""
    return [[1.0, dt], [0.0, 1.0]]


def _outer(gain: Sequence[Any]) -> list[list[Any]]:
    """The entries of Γ Γᵀ."""
    return [[a * b for b in gain] for a in gain]


def _each(axes: int, block: Sequence[Sequence[Any]]) -> Array:
    """The same block of numbers, or arrays (...), for the coordinates of each axis."""
    size = len(block)
    entries = np.broadcast_arrays(*(entry for row in block for entry in row))
    stacked = np.stack(entries, axis=-1)
    out: Array = np.kron(stacked.reshape(*stacked.shape[:-1], size, size), np.eye(axes))
    return out
