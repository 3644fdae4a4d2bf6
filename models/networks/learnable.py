"""What is learnt of a robot's sensors and odometer, declared ready for `pgm.fit`.

A sensor for each landmark, with a bias and a noise of its own; and an odometer and a gyro with
scales and a bias, which are parents without a CPD: `pgm.learning.Parameter`s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from models import motion, sensors
from models.networks.covariances import variances
from models.networks.uneven import grows
from models.networks.variables import pose, travelled
from pgm.cpds import RobustNoise

Array = npt.NDArray[np.float64]

# Factors of the distance that an odometer counted and of the turn that a gyro told, and the bias
# by which the gyro tells too much [rad/s].
correction = pgm.Variable("correction", components=("distance", "turn", "rate"))


@dataclass(frozen=True)
class Biased:
    """A sensor's reading of the landmark at a place, plus a bias."""

    function: Any
    place: tuple[float, ...]

    def __call__(self, x: Array, bias: Array) -> Array:
        """The reading (..., d) from poses (..., 3), with a bias (..., d)."""
        place = np.broadcast_to(np.array(self.place), (*x.shape[:-1], len(self.place)))
        found: Array = self.function(x, place) + bias
        return found


@dataclass(frozen=True, eq=False)
class EachLandmark:
    """The sensors of landmarks, by name: their readings, biases, and CPDs."""

    readings: Mapping[str, pgm.Variable]
    biases: Mapping[str, pgm.Variable]
    cpds: Sequence[pgm.NonlinearGaussianCPD]

    @property
    def learn(self) -> dict[pgm.Variable, Any]:
        """What `pgm.fit` is to learn: bias and noise of each landmark."""
        found: dict[pgm.Variable, Any] = {
            bias: pgm.learning.Parameter(np.zeros(bias.dimension)) for bias in self.biases.values()
        }
        return found | {z: pgm.learning.Covariance("diagonal") for z in self.readings.values()}

    def evidence(
        self, values: npt.ArrayLike, step: npt.ArrayLike, names: Sequence[str]
    ) -> dict[pgm.Variable, Any]:
        """The readings (M, d) at steps (M,) as evidence, each of the landmark of its name."""
        found, rows = {}, np.asarray(values, dtype=float)
        for name in dict.fromkeys(names):
            own = np.array([each == name for each in names])
            found[self.readings[name]] = pgm.sightings(rows[own], step=np.asarray(step)[own])
        return found


def sees_each(
    child: pgm.Variable,
    sensor: sensors.Sensor,
    places: Mapping[str, Sequence[float]],
    std: float | Sequence[float],
    noise: RobustNoise | None = None,
) -> EachLandmark:
    """Sensors of landmarks at known places, each with a bias and a noise of its own.

    Parameters
    ----------
    child : Variable
        The reading, whose components and angles those of each landmark have.
    sensor : Sensor
        From pose and place to the reading.
    places : mapping of str
        By name, (east, north) [m].
    std : float or sequence of float
        Standard deviations to begin with.
    noise : RobustNoise, optional
    """
    parts, angles = child.components, child.angles
    readings = {n: pgm.Variable(f"{child.name} of {n}", parts, angles) for n in places}
    biases = {n: pgm.Variable(f"bias of {n}", parts) for n in places}
    cpds = [
        pgm.NonlinearGaussianCPD(
            readings[name],
            (pose, biases[name]),
            Biased(sensor.function, tuple(map(float, place))),
            variances(std),
            noise=noise,
        )
        for name, place in places.items()
    ]
    return EachLandmark(readings, biases, cpds)


def rolls_corrected(std: Sequence[float]) -> pgm.NonlinearGaussianCPD:
    """The motion of `rolls` with scales of odometer and gyro and a bias of the gyro, a parent.

    Distance d, turn φ and duration Δt count as (c₁ d, c₂ φ − c₃ Δt), c being `correction`: learn
    ``{correction: pgm.learning.Parameter([1, 1, 0])}``.
    """
    return pgm.NonlinearGaussianCPD(
        pose, (pose.previous, travelled, correction), corrected, grows(std, travelled)
    )


def corrected(x: Array, u: Array, c: Array) -> Array:
    """The pose (..., 3) after an arc of corrected odometry u (..., 3), by c (..., 3)."""
    told = [c[..., 0] * u[..., 0], c[..., 1] * u[..., 1] - c[..., 2] * u[..., 2], u[..., 2]]
    return motion.arc(x, np.stack(told, axis=-1))
