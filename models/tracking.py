"""How a tracked target moves when nobody tells its controls.

The state of constant velocity is x = (east [m], north [m], v_east [m/s], v_north [m/s]); that of
the coordinated turn has the turn rate ω [rad/s], anticlockwise, as a fifth component. What is not
known of the motion enters as noise whose covariance is given here, and which may be singular.

Sources: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation
(2001).
"""

from dataclasses import dataclass
from math import isfinite
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from models.sinc import sinc, sinc_slope

Array = NDArray[np.float64]


def constant_velocity(dt: float | Array) -> Array:
    """The transition matrix of constant velocity over a step, p' = p + Δt v, v' = v.

    Parameters
    ----------
    dt : float or array, shape (...)
        Duration of the step [s].

    Returns
    -------
    array, shape (..., 4, 4)

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan (2001), section 6.2.2.

    Examples
    --------
    >>> (constant_velocity(2.0) @ [0.0, 0.0, 1.0, -1.0]).tolist()
    [2.0, -2.0, 1.0, -1.0]
    """
    return _plane(1.0, dt, 0.0, 1.0)


def steady(x: Array, dt: Array) -> Array:
    """The target's state ``(..., 4)`` after a duration ``(..., 1)`` [s] of constant velocity."""
    moved: Array = (steady_by_state(x, dt) @ x[..., None])[..., 0]
    return moved


def steady_by_state(x: Array, dt: Array) -> Array:
    """Differentiate `steady` by the state: `constant_velocity`, ``(..., 4, 4)``."""
    return constant_velocity(dt[..., 0])


def white_acceleration(dt: float | Array, density: float) -> Array:
    """The covariance over a step of white-noise acceleration, independent east and north.

        q [[Δt³/3, Δt²/2], [Δt²/2, Δt]] for a coordinate and its velocity

    Parameters
    ----------
    dt : float or array, shape (...)
        Duration of the step [s].
    density : float
        The power spectral density q [m²/s³], 0 or more; 0 is an exact constant velocity.

    Returns
    -------
    array, shape (..., 4, 4)
        Of full rank where q > 0.

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan (2001), section 6.2.2.
    """
    return density * _plane(dt**3 / 3, dt**2 / 2, dt**2 / 2, dt)


def held_acceleration(dt: float, std: float) -> Array:
    """The covariance over a step of an acceleration that is drawn anew, and held, at each step.

        Γ σ² Γᵀ for a coordinate and its velocity, Γ = (Δt²/2, Δt)

    Parameters
    ----------
    dt : float
        Duration of the step [s].
    std : float
        σ, of the acceleration in each coordinate [m/s²].

    Returns
    -------
    array, shape (4, 4)
        Of rank 2: position and velocity err together.

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan (2001), section 6.3.2.
    """
    gain = np.array([dt**2 / 2, dt])
    return std**2 * _plane(*np.outer(gain, gain).ravel())


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
        Duration of every step [s], positive.

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
        east, north = x[..., 2], x[..., 3]
        along, across, cos, sin = self._turn(x[..., 4])
        out = np.empty(x.shape)
        out[..., 0] = x[..., 0] + along * east - across * north
        out[..., 1] = x[..., 1] + across * east + along * north
        out[..., 2] = cos * east - sin * north
        out[..., 3] = sin * east + cos * north
        out[..., 4] = x[..., 4]
        return out

    def by_state(self, x: Array) -> Array:
        """Differentiate by the state; returns ``(..., 5, 5)``, right at ω = 0 too."""
        dt, east, north = self.dt, x[..., 2], x[..., 3]
        along, across, cos, sin = self._turn(x[..., 4])
        half = 0.5 * dt * x[..., 4]
        along_slope = dt**2 * sinc_slope(2 * half)
        across_slope = dt**2 * (
            0.5 * np.cos(half) * sinc(half) + 0.5 * np.sin(half) * sinc_slope(half)
        )
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

    def noise(self, acceleration: float, turn_acceleration: float) -> Array:
        """The covariance of accelerations that are drawn anew, and held, at each step.

        Parameters
        ----------
        acceleration : float
            Standard deviation in each coordinate [m/s²].
        turn_acceleration : float
            Standard deviation of the turn rate's change [rad/s²].

        Returns
        -------
        array, shape (5, 5)
            Of rank 3.
        """
        out = np.zeros((5, 5))
        out[:4, :4] = held_acceleration(self.dt, acceleration)
        out[4, 4] = (self.dt * turn_acceleration) ** 2
        return out

    def _turn(self, omega: Array) -> tuple[Array, Array, Array, Array]:
        """Return s, c, cos a and sin a; 1 − cos a = 2 sin² (a/2) loses no digits."""
        turn = self.dt * omega
        half = 0.5 * turn
        along = self.dt * sinc(turn)
        return along, self.dt * np.sin(half) * sinc(half), np.cos(turn), np.sin(turn)


def _plane(*entries: float | Array) -> Array:
    """The same (2, 2) block, entry by entry, for (east, v_east) and for (north, v_north)."""
    block = np.stack(np.broadcast_arrays(*entries), axis=-1)
    out: Array = np.kron(block.reshape(*block.shape[:-1], 2, 2), np.eye(2))
    return out
