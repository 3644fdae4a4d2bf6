"""CPDs and networks for steps of uneven duration, which is a component of an input."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm
from models import motion, tracking
from models.networks.covariances import diagonal, variances
from models.networks.observations import sees_landmark
from models.networks.variables import (
    clock,
    fix,
    gyro_bias,
    pose,
    target,
    timed_velocity,
    travelled,
)
from pgm.cpds import Noise

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Grows:
    """Variances of a noise that grows with the duration of a step, of parts as of the whole.

    Parameters
    ----------
    variances : tuple of float
        Of each component after one second.
    place : int
        Which component of the input is the duration [s].
    """

    variances: tuple[float, ...]
    place: int

    def __call__(self, u: Array) -> Array:
        """Variances (..., d) of a step under u."""
        grown: Array = np.array(self.variances) * u[..., self.place, None]
        return grown


def grows(std: npt.ArrayLike, duration: pgm.Variable) -> Noise:
    """A noise whose standard deviations grow with √Δt.

    Parameters
    ----------
    std : float or sequence of float
        After one second.
    duration : Variable
        The input with a component called ``dt`` [s].
    """
    after = tuple(np.atleast_1d(variances(std)).tolist())
    if "dt" not in duration.components:
        raise ValueError(f'grows: {duration!r} has no component called "dt"')
    growth = Grows(after, duration.components.index("dt"))
    return pgm.noise(growth, given=duration, diagonal=True)


def drives(std: Sequence[float]) -> pgm.NonlinearGaussianCPD:
    """The motion under velocities that hold for a duration, an arc.

    Parameters
    ----------
    std : sequence of float
        Standard deviations of the noise after one second [m, m, rad].
    """
    return _moves(
        timed_velocity, motion.velocity, motion.velocity_by_state, motion.velocity_by_control, std
    )


def rolls(std: Sequence[float]) -> pgm.NonlinearGaussianCPD:
    """The motion that an odometer and a gyro tell, an arc; its noise is as that of `drives`."""
    return _moves(travelled, motion.arc, motion.arc_by_state, motion.arc_by_control, std)


def drifts(std: Sequence[float]) -> pgm.NonlinearGaussianCPD:
    """The motion of `rolls` where the gyro has a bias, a state of the network."""
    return pgm.NonlinearGaussianCPD(
        pose,
        given=(pose.previous, travelled, gyro_bias.previous),
        function=motion.drifting,
        cov=grows(std, travelled),
        jacobian={
            pose.previous: motion.drifting_by_state,
            travelled: motion.drifting_by_control,
            gyro_bias.previous: motion.drifting_by_bias,
        },
    )


def stays(state: pgm.Variable) -> pgm.LinearGaussianCPD:
    """A state that never changes, such as a calibration: p(c[t] | c[t−1]) is exact."""
    return pgm.LinearGaussianCPD(state, given={state.previous: 1.0}, cov=0.0)


def walks(state: pgm.Variable, std: npt.ArrayLike, duration: pgm.Variable) -> pgm.LinearGaussianCPD:
    """A state that walks at random, such as a bias.

    Parameters
    ----------
    state : Variable
    std : float or sequence of float
        Standard deviations of its change after one second; a component of 0 stays.
    duration : Variable
        The input with a component called ``dt`` [s].
    """
    each = np.broadcast_to(np.asarray(std, dtype=float), (state.dimension,))
    return pgm.LinearGaussianCPD(state, given={state.previous: 1.0}, cov=grows(each, duration))


def uneven_range_bearing(
    *,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    start_std: Sequence[float] = (0.1, 0.1, 0.05),
    motion_std: Sequence[float] = (0.03, 0.03, 0.02),
    sensor_std: Sequence[float] = (0.2, 0.05),
) -> pgm.DynamicBayesianNetwork:
    """A robot driven by velocities, for steps of any duration, that sees landmarks.

    Parameters
    ----------
    start, start_std, sensor_std
        As of `range_bearing`.
    motion_std : sequence of float
        Standard deviations of the motion's noise after one second [m, m, rad].
    """
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, mean=start, cov=diagonal(start_std))],
        transition=[drives(motion_std)],
        observation=[sees_landmark(sensor_std)],
    )


def uneven_constant_velocity(
    *,
    start: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    start_std: Sequence[float] = (1.0, 1.0, 1.0, 1.0),
    acceleration_density: float = 0.1,
    sensor_std: Sequence[float] = (0.5, 0.5),
) -> pgm.DynamicBayesianNetwork:
    """A target of nearly constant velocity, read whenever it is: `clock` has the durations.

    Parameters
    ----------
    start, start_std, acceleration_density, sensor_std
        As of `constant_velocity`.
    """
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(target, mean=start, cov=diagonal(start_std))],
        transition=[
            pgm.NonlinearGaussianCPD(
                target,
                given=(target.previous, clock),
                function=tracking.steady,
                cov=pgm.noise(
                    lambda dt: tracking.white_acceleration(dt[..., 0], acceleration_density),
                    given=clock,
                ),
                jacobian={target.previous: tracking.steady_by_state},
            )
        ],
        observation=[
            pgm.LinearGaussianCPD(fix, given={target: np.eye(2, 4)}, cov=diagonal(sensor_std))
        ],
    )


def _moves(
    control: pgm.Variable,
    function: Callable[[Array, Array], Array],
    by_state: Callable[[Array, Array], Array],
    by_control: Callable[[Array, Array], Array],
    std: Sequence[float],
) -> pgm.NonlinearGaussianCPD:
    return pgm.NonlinearGaussianCPD(
        pose,
        given=(pose.previous, control),
        function=function,
        cov=grows(std, control),
        jacobian={pose.previous: by_state, control: by_control},
    )
