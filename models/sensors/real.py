"""Sensors that stand elsewhere on the robot, and whose scales and offsets are off."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from models import motion
from models.sensors import ideal

Array = NDArray[np.float64]
Function = Callable[..., Array]


@dataclass(frozen=True)
class Sensor:
    """A sensor and its derivatives.

    Attributes
    ----------
    function : callable
        ``function(x, *others)``, values (..., d).
    derivatives : tuple of callable
        By each argument in turn, called like the function: (..., d, n).
    """

    function: Function
    derivatives: tuple[Function, ...]


RANGE = Sensor(ideal.range_only, (ideal.range_only_by_state, ideal.range_only_by_landmark))
BEARING = Sensor(ideal.bearing_only, (ideal.bearing_only_by_state, ideal.bearing_only_by_landmark))
RANGE_BEARING = Sensor(
    ideal.range_bearing, (ideal.range_bearing_by_state, ideal.range_bearing_by_landmark)
)
POSE = Sensor(ideal.pose, (ideal.pose_by_state,))
POSITION = Sensor(ideal.position, (ideal.position_by_state,))
HEADING = Sensor(ideal.heading, (ideal.heading_by_state,))


def mounted(sensor: Sensor, mount: Sequence[float] | None = None) -> Sensor:
    """Put a sensor elsewhere on the robot: h(x ⊕ a, …) in place of h(x, …).

    Parameters
    ----------
    sensor : Sensor
        Of a pose x, and of others.
    mount : sequence of float, optional
        a: where the sensor is, forward [m] and left [m] of the robot's reference point, and by how
        much it is turned to the left [rad]. Without it, a is a last argument of the sensor.

    Raises
    ------
    ValueError
        Where the mount is not three finite numbers.

    Examples
    --------
    A robot that looks north, its antenna 2 m ahead and 1 m to the left:

    >>> antenna = mounted(POSITION, (2.0, 1.0, 0.0))
    >>> antenna.function(np.array([5.0, 0.0, np.pi / 2])).round(12).tolist()
    [4.0, 2.0]
    """
    made = _Mounted(sensor, _numbers("mount", mount, ("forward", "left", "turn")))
    others = (partial(made.by_other, k) for k in range(1, len(sensor.derivatives)))
    own = (made.by_mount,) if mount is None else ()
    return Sensor(made, (made.by_state, *others, *own))


def calibrated(sensor: Sensor, calibration: Sequence[float] | None = None) -> Sensor:
    """Give a sensor a scale s and an offset o: its first component is s h₁ + o in place of h₁.

    Parameters
    ----------
    sensor : Sensor
        Its other components stay.
    calibration : sequence of float, optional
        (s, o), the offset in the unit of the first component. Without it, the calibration is a last
        argument of the sensor.

    Raises
    ------
    ValueError
        Where the calibration is not two finite numbers.

    Examples
    --------
    >>> radio = calibrated(RANGE, (1.07, 0.5))
    >>> radio.function(np.zeros(3), np.array([6.0, 8.0])).round(12).tolist()
    [11.2]
    """
    made = _Calibrated(sensor, _numbers("calibration", calibration, ("scale", "offset")))
    others = (partial(made.by, k) for k in range(len(sensor.derivatives)))
    own = (made.by_calibration,) if calibration is None else ()
    return Sensor(made, (*others, *own))


@dataclass(frozen=True)
class _Mounted:
    sensor: Sensor
    mount: tuple[float, ...] | None

    def __call__(self, x: Array, *others: Array) -> Array:
        at, others = self._placed(x, others)
        return self.sensor.function(at, *others)

    def by_state(self, x: Array, *others: Array) -> Array:
        at, others = self._placed(x, others)
        out = self.sensor.derivatives[0](at, *others).copy(order="K")
        east, north = at[..., 0] - x[..., 0], at[..., 1] - x[..., 1]
        out[..., 2] += east[..., None] * out[..., 1] - north[..., None] * out[..., 0]
        return out

    def by_other(self, k: int, x: Array, *others: Array) -> Array:
        at, others = self._placed(x, others)
        return self.sensor.derivatives[k](at, *others)

    def by_mount(self, x: Array, *others: Array) -> Array:
        (at, others), mount = self._placed(x, others), others[-1]
        by_pose = self.sensor.derivatives[0](at, *others)
        product: Array = by_pose @ motion.increment_by_control(x, mount)
        return product

    def _placed(self, x: Array, others: tuple[Array, ...]) -> tuple[Array, tuple[Array, ...]]:
        """The sensor's own pose, and its other arguments."""
        if self.mount is None:
            return motion.increment(x, others[-1]), others[:-1]
        return motion.increment(x, np.array(self.mount)), others


@dataclass(frozen=True)
class _Calibrated:
    sensor: Sensor
    calibration: tuple[float, ...] | None

    def __call__(self, *given: Array) -> Array:
        given, scale, offset = self._read(given)
        out = self.sensor.function(*given).astype(float, order="K")
        out[..., 0] = scale * out[..., 0] + offset
        return out

    def by(self, k: int, *given: Array) -> Array:
        given, scale, _ = self._read(given)
        out = self.sensor.derivatives[k](*given).astype(float, order="K")
        out[..., 0, :] *= scale[..., None]
        return out

    def by_calibration(self, *given: Array) -> Array:
        given, _, _ = self._read(given)
        value = self.sensor.function(*given)
        out = np.zeros((*value.shape, 2))
        out[..., 0, 0] = value[..., 0]
        out[..., 0, 1] = 1.0
        return out

    def _read(self, given: tuple[Array, ...]) -> tuple[tuple[Array, ...], Array, Array]:
        """The sensor's own arguments, scale and offset."""
        if self.calibration is None:
            given, last = given[:-1], given[-1]
        else:
            last = np.array(self.calibration)
        return given, last[..., 0], last[..., 1]


def _numbers(
    name: str, values: Sequence[float] | None, parts: tuple[str, ...]
) -> tuple[float, ...] | None:
    if values is None:
        return None
    numbers = np.asarray(values, dtype=float)
    if numbers.shape != (len(parts),) or not np.isfinite(numbers).all():
        raise ValueError(f"{name}: found {values!r}; give finite numbers ({', '.join(parts)})")
    return tuple(numbers.tolist())
