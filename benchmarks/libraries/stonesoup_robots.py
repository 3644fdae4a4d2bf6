"""Stone Soup's extended and unscented filters and smoothers, given the functions of `models`.

Its own type for bearings wraps them. A step's number serves as its time stamp, by which the models
find its control and its landmark.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from stonesoup.base import Property
from stonesoup.models.base import GaussianModel
from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
from stonesoup.models.transition.base import TransitionModel
from stonesoup.predictor.kalman import ExtendedKalmanPredictor, UnscentedKalmanPredictor
from stonesoup.smoother.kalman import ExtendedKalmanSmoother, UnscentedKalmanSmoother
from stonesoup.types.angle import Bearing
from stonesoup.types.array import CovarianceMatrix, StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.updater.kalman import ExtendedKalmanUpdater, UnscentedKalmanUpdater

from benchmarks.timing import Contender
from benchmarks.work.robots import DRIVE, Array, Robots
from models import sensors

PARTS = {
    "taylor": (ExtendedKalmanPredictor, ExtendedKalmanUpdater, ExtendedKalmanSmoother),
    "unscented": (UnscentedKalmanPredictor, UnscentedKalmanUpdater, UnscentedKalmanSmoother),
}
OPTIONS: dict[str, dict[str, float]] = {
    "taylor": {},
    "unscented": {"alpha": (5.0 / 3.0) ** 0.5, "beta": 2.0, "kappa": 0.0},  # λ = n − 1
}


class Drive(TransitionModel, GaussianModel):  # type: ignore[misc]
    """The motion under the controls of one run."""

    controls: np.ndarray = Property()
    noise_covar: np.ndarray = Property()
    ndim_state = 3

    def covar(self, **kwargs: Any) -> Any:
        """Covariance of the motion's noise."""
        return self.noise_covar

    def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
        """Move states, (3, points)."""
        x = np.asarray(state.state_vector).T
        return DRIVE(x, self.controls[state.timestamp]).T.view(StateVectors)

    def jacobian(self, state: Any, **kwargs: Any) -> Any:
        """Differentiate at one state."""
        return DRIVE.by_state(np.asarray(state.state_vector)[:, 0], self.controls[state.timestamp])


class Sight(NonLinearGaussianMeasurement):  # type: ignore[misc]
    """Range and bearing of the landmark that each step sees."""

    landmarks: np.ndarray = Property()
    ndim_meas = 2

    def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
        """Sense states, (2, points)."""
        x = np.asarray(state.state_vector).T
        reading = sensors.range_bearing(x, self.landmarks[state.timestamp - 1])
        return StateVectors([reading[:, 0], [Bearing(each) for each in reading[:, 1]]])

    def jacobian(self, state: Any, **kwargs: Any) -> Any:
        """Differentiate at one state."""
        x = np.asarray(state.state_vector)[:, 0]
        return sensors.range_bearing_by_state(x, self.landmarks[state.timestamp - 1])


def filtering(rule: str, work: Robots) -> Contender:
    """Run by run: means (runs, T, 3) and covariances."""

    def call() -> tuple[Array, Array]:
        tracks = [_moments(_forward(rule, work, run)) for run in range(work.runs)]
        return np.stack([means for means, _ in tracks]), np.stack([covs for _, covs in tracks])

    return Contender(call, work.runs * work.steps)


def online(rule: str, work: Robots) -> Contender:
    """One robot in its loop: means (T, 3) and covariances."""
    return Contender(lambda: _moments(_forward(rule, work, 0)), work.steps)


def smoothing(rule: str, work: Robots) -> Contender:
    """One run, forward and back: means (T, 3) and covariances."""
    _, _, kind = PARTS[rule]
    smoother = kind(None, **OPTIONS[rule])  # each prediction brings its model
    return Contender(lambda: _moments(smoother.smooth(Track(_forward(rule, work, 0)))), work.steps)


def _forward(rule: str, work: Robots, run: int) -> list[Any]:
    predictor_kind, updater_kind, _ = PARTS[rule]
    options = OPTIONS[rule]
    mean, cov = work.start
    state = GaussianState(StateVector(mean), CovarianceMatrix(cov), timestamp=0)
    drive = Drive(controls=work.of(run), noise_covar=CovarianceMatrix(work.motion_cov))
    sight = Sight(
        ndim_state=3,
        mapping=(0, 1, 2),
        noise_covar=CovarianceMatrix(work.sensor_cov),
        landmarks=work.landmarks[:, 0],
    )
    predictor, updater = predictor_kind(drive, **options), updater_kind(sight, **options)
    states = []
    for k, (away, side) in enumerate(work.readings[run, :, 0], start=1):
        prediction = predictor.predict(state, timestamp=k)
        seen = Detection(StateVector([away, Bearing(side)]), timestamp=k)
        state = updater.update(SingleHypothesis(prediction, seen))
        states.append(state)
    return states


def _moments(states: Any) -> tuple[Array, Array]:
    means = [np.asarray(state.state_vector, dtype=float)[:, 0] for state in states]
    covs = [np.asarray(state.covar, dtype=float) for state in states]
    return np.stack(means), np.stack(covs)
