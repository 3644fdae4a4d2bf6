"""Driving with two wheels on one axle."""

from dataclasses import dataclass
from math import isfinite
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from models.motion.arcs import Velocity

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DifferentialDrive:
    """Two wheels that turn at constant speeds, without slip: an exact arc.

        v = r (ω_R + ω_L) / 2,    ω = r (ω_R − ω_L) / L

    and then the motion of `Velocity`, over steps of one fixed duration; u = (ω_L, ω_R) [rad/s].

    Parameters
    ----------
    radius : float
        Of the wheels, r [m], positive.
    wheelbase : float
        The distance between the wheels, L [m], positive.
    dt : float
        Duration of every step [s], positive.

    Raises
    ------
    ValueError
        Where one of them is not a positive, finite number.

    Notes
    -----
    The kinematics of Siegwart, Nourbakhsh and Scaramuzza (2011), section 3.2.

    Examples
    --------
    >>> drive = DifferentialDrive(radius=0.1, wheelbase=0.3, dt=2.0)
    >>> drive(np.array([0.0, 0.0, 0.0]), np.array([5.0, 5.0])).tolist()
    [1.0, 0.0, 0.0]
    """

    radius: float
    wheelbase: float
    dt: float

    def __post_init__(self) -> None:
        for name in ("radius", "wheelbase"):
            value = getattr(self, name)
            if not (isinstance(value, Real) and isfinite(value) and float(value) > 0):
                raise ValueError(
                    f"DifferentialDrive: {name} is {value!r}; give a length above 0, in metres"
                )
        Velocity(self.dt)  # refuses a duration that is none

    def __call__(self, x: Array, u: Array) -> Array:
        """Return the state ``(..., 3)`` after a step from x ``(..., 3)`` under u ``(..., 2)``."""
        return Velocity(self.dt)(x, self.velocity(u))

    def velocity(self, u: Array) -> Array:
        """Return the speed [m/s] and turn rate [rad/s] of wheel speeds, ``(..., 2)``."""
        left, right = u[..., 0], u[..., 1]
        out = np.empty_like(u, dtype=float)
        out[..., 0] = 0.5 * self.radius * (right + left)
        out[..., 1] = self.radius / self.wheelbase * (right - left)
        return out

    def by_state(self, x: Array, u: Array) -> Array:
        """Differentiate by (east, north, heading); returns ``(..., 3, 3)``."""
        return Velocity(self.dt).by_state(x, self.velocity(u))

    def by_control(self, x: Array, u: Array) -> Array:
        """Differentiate by (ω_L, ω_R); returns ``(..., 3, 2)``."""
        ahead, bend = 0.5 * self.radius, self.radius / self.wheelbase
        by_velocity = Velocity(self.dt).by_control(x, self.velocity(u))
        straight, bent = ahead * by_velocity[..., 0], bend * by_velocity[..., 1]
        out = np.empty_like(by_velocity)
        out[..., 0], out[..., 1] = straight - bent, straight + bent
        return out
