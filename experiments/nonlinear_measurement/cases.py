"""One step of a robot, and five sensors that read its place after it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from models import motion, sensors
from models.networks import distance, fix, landmark, pose, sighting, velocity

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]

CONTROL = np.array([1.0, 0.5])  # speed [m/s] and turn rate [rad/s], for one second
START_STD = 0.2  # of either coordinate [m]
MOTION_STD = (0.05, 0.05, 0.05)  # m, m, rad
RANGE_STD = 0.1  # m
BEARING_STD = 0.05  # rad
FIX_STD = 0.1  # m
HEADINGS = (0.1, 0.3, 0.6)  # standard deviations of the first heading [rad]


@dataclass(frozen=True)
class Sensor:
    """A sensor that is read after the step.

    Attributes
    ----------
    title : str
    variable : Variable
        A reading: `sighting` (range and bearing), `distance` or `fix` (position).
    landmarks : tuple
        Places (east, north) [m], a reading of each; none for a position.
    """

    title: str
    variable: pgm.Variable
    landmarks: tuple[tuple[float, float], ...] = ()

    @property
    def bearing(self) -> bool:
        """Whether it tells of the heading too."""
        return self.variable == sighting


SENSORS = {
    "far": Sensor("range and bearing, far", sighting, ((3.0, 2.0),)),
    "near": Sensor("range and bearing, near", sighting, ((1.6, 0.9),)),
    "two_ranges": Sensor("two ranges", distance, ((3.0, 2.0), (3.0, -2.0))),
    "collinear": Sensor("collinear ranges", distance, ((4.0, 0.3), (-2.0, 0.2))),
    "position": Sensor("linear position", fix),
}

_FUNCTIONS: dict[pgm.Variable, tuple[Callable[..., Any], Callable[..., Any], Array]] = {
    sighting: (
        sensors.range_bearing,
        sensors.range_bearing_by_state,
        np.diag([RANGE_STD**2, BEARING_STD**2]),
    ),
    distance: (sensors.range_only, sensors.range_only_by_state, np.array([[RANGE_STD**2]])),
}


@dataclass(frozen=True, eq=False)
class Case:
    """A sensor, a first heading's deviation, and simulations.

    Attributes
    ----------
    sensor : Sensor
    heading_std : float
        Of the first heading [rad].
    model : DynamicBayesianNetwork
    evidence : mapping
        Control and readings of all simulations.
    truth : ndarray
        (runs, 3): the poses after the step.
    readings : ndarray
        (runs, readings, d): ranges [m] and bearings [rad], or positions [m].
    """

    sensor: Sensor
    heading_std: float
    model: pgm.DynamicBayesianNetwork
    evidence: Mapping[pgm.Variable, Any]
    truth: Array
    readings: Array


def declare(sensor: Sensor, heading_std: float) -> pgm.DynamicBayesianNetwork:
    """The network of one sensor."""
    drive = motion.Velocity(dt=1.0)
    if sensor.landmarks:
        function, derivative, cov = _FUNCTIONS[sensor.variable]
        seen: pgm.NonlinearGaussianCPD | pgm.LinearGaussianCPD = pgm.NonlinearGaussianCPD(
            sensor.variable,
            given=(pose, landmark),
            function=function,
            cov=cov,
            jacobian={pose: derivative},
            grouped=True,
        )
    else:
        seen = pgm.LinearGaussianCPD(
            sensor.variable, given={pose: np.eye(2, 3)}, cov=FIX_STD**2 * np.eye(2)
        )
    return pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(
                pose, mean=np.zeros(3), cov=np.diag([START_STD, START_STD, heading_std]) ** 2
            )
        ],
        transition=[
            pgm.NonlinearGaussianCPD(
                pose,
                given=(pose.previous, velocity),
                function=drive,
                cov=np.diag(MOTION_STD) ** 2,
                jacobian={pose.previous: drive.by_state},
            )
        ],
        observation=[seen],
    )


def simulate(
    sensor: Sensor, heading_std: float, runs: int, seed: int | np.random.Generator
) -> Case:
    """Draw poses and readings; one seed's random numbers are common to all sensors and s."""
    model = declare(sensor, heading_std)
    inputs: dict[pgm.Variable, Any] = {velocity: CONTROL[None]}
    if sensor.landmarks:
        places = np.array(sensor.landmarks)
        step = np.ones(len(places), dtype=int)
        inputs[sensor.variable] = pgm.sightings(step=step, given={landmark: places})
    sample = model.sample(inputs, runs=runs, rng=seed)
    return Case(
        sensor, heading_std, model, sample.evidence, sample[pose][:, 1], sample[sensor.variable]
    )
