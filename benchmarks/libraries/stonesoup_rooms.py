"""Stone Soup's point mass filter on as many cells, which does less.

Its motion is linear, x' = F x + n, and knows no heading: here a robot that stands still, with the
same noise. Its sensor is the same function of arrays, bearings as plain numbers that are not
wrapped, which takes it the least time. Axes have an odd number of cells, as its convolution wants.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from stonesoup.base import Property
from stonesoup.functions import grid_creation
from stonesoup.models.base import GaussianModel, LinearModel
from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
from stonesoup.models.transition.base import TransitionModel
from stonesoup.predictor.pointmass import PointMassPredictor
from stonesoup.types.array import CovarianceMatrix, StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import PointMassState
from stonesoup.updater.pointmass import PointMassUpdater

import pgm
from benchmarks.timing import Contender
from benchmarks.work import rooms
from benchmarks.work.robots import Array, Robots
from models import sensors

CELLS = tuple(cells | 1 for cells in rooms.CELLS)
WIDTHS = 4.0  # standard deviations on either side that a grid covers, its default


class Still(TransitionModel, LinearModel, GaussianModel):  # type: ignore[misc]
    """No motion but noise."""

    noise_covar: np.ndarray = Property()
    ndim_state = 3

    def covar(self, **kwargs: Any) -> Any:
        """Covariance of the motion's noise."""
        return self.noise_covar

    def matrix(self, **kwargs: Any) -> Any:
        """F."""
        return np.eye(3)


class Sight(NonLinearGaussianMeasurement):  # type: ignore[misc]
    """Range and bearing of one beacon."""

    beacon: np.ndarray = Property()
    ndim_meas = 2

    def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
        """Sense states, (2, points)."""
        return sensors.range_bearing(np.asarray(state.state_vector).T, self.beacon).T


def filtering(work: Robots) -> Contender:
    """One run: the probabilities of cells at each step."""
    sights = [
        [
            Sight(
                ndim_state=3,
                mapping=(0, 1, 2),
                noise_covar=CovarianceMatrix(work.sensor_cov),
                beacon=beacon,
            )
            for beacon in beacons
        ]
        for beacons in work.landmarks
    ]
    predictor = PointMassPredictor(Still(noise_covar=CovarianceMatrix(work.motion_cov)))
    updater = PointMassUpdater(None)

    def call() -> list[Array]:
        state, found = _start(work), []
        for k in range(work.steps):
            state = predictor.predict(state, timestamp=k + 1)
            for sight, reading in zip(sights[k], work.readings[0, k], strict=True):
                seen = Detection(StateVector(reading), timestamp=k + 1, measurement_model=sight)
                state = updater.update(SingleHypothesis(state, seen))
            found.append(np.asarray(state.weight))
        return found

    return Contender(call, work.steps * int(np.prod(CELLS)))


def _start(work: Robots) -> Any:
    """The first pose's normal density on a grid of its own."""
    _, cov = work.start
    (prior,) = work.network.prior
    assert isinstance(prior, pgm.GaussianCPD)
    mean = np.array(prior.mean)
    points, steps, axes, _, turned = grid_creation(mean[:, None], cov, WIDTHS, 3, np.array(CELLS))
    gap = points - mean[:, None]
    weight = np.exp(-0.5 * np.sum(gap * np.linalg.solve(cov, gap), axis=0))
    weight /= weight.sum() * np.prod(steps)
    return PointMassState(
        state_vector=StateVectors(points),
        weight=weight,
        grid_delta=np.array(steps),
        grid_dim=axes,
        center=mean[:, None],
        eigVec=turned,
        Npa=np.array(CELLS),
        timestamp=0,
    )
