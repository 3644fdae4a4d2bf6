"""Models whose noise is to be learnt: the growth model, and a target that turns, seen by radar."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import pgm
from experiments.iterated import growth
from models.tracking import CoordinatedTurn
from pgm.learning import Covariance
from pgm.variables import Variable

# Variances to begin with, as a multiple of the true ones.
START = 5.0
target = Variable("target", components=("east", "north", "v_east", "v_north", "turn"))
radar = Variable("radar", components=("range", "bearing"), angles=("bearing",))
RADAR_STD = np.array([5.0, 0.02])  # m, rad
TURN = CoordinatedTurn(dt=1.0)


@dataclass(frozen=True, eq=False)
class Problem:
    """A model, and the noise of it that is learnt.

    Attributes
    ----------
    truth : DynamicBayesianNetwork
    start : DynamicBayesianNetwork
        With all the learnt variances `START` times as large.
    learn : mapping
    inputs : callable
        The evidence that a recording of so many steps begins with.
    shares : mapping of str to callable
        By name, the learnt number of a model, as a part of the true one.
    """

    truth: pgm.DynamicBayesianNetwork
    start: pgm.DynamicBayesianNetwork
    learn: Mapping[Variable, Any]
    inputs: Callable[[int], dict[Variable, Any]]
    shares: Mapping[str, Callable[[pgm.DynamicBayesianNetwork], float]]


def problems() -> dict[str, Problem]:
    """The problems by name."""
    return {"growth": _growth(), "turn": _turn()}


def _growth() -> Problem:
    truth = growth.network(2)

    def inputs(steps: int) -> dict[Variable, Any]:
        return {growth.clock: np.arange(float(steps))[:, None]}

    return Problem(
        truth,
        _wider(truth),
        {growth.state: Covariance(), growth.reading: Covariance()},
        inputs,
        {
            "process": lambda model: float(_cov(model.transition[0])[0, 0]),
            "sensor": lambda model: float(_cov(model.observation[0])[0, 0]),
        },
    )


def _turn() -> Problem:
    noise = TURN.noise(acceleration=0.5, turn_acceleration=0.01)
    start = [0.0, 300.0, 10.0, 0.0, 0.05]
    truth = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(target, start, np.square([20.0, 20.0, 2.0, 2.0, 0.02]))],
        transition=[
            pgm.NonlinearGaussianCPD(
                target, target.previous, TURN, noise, jacobian={target.previous: TURN.by_state}
            )
        ],
        observation=[pgm.NonlinearGaussianCPD(radar, target, _seen, np.square(RADAR_STD))],
    )

    def share(axis: int) -> Callable[[pgm.DynamicBayesianNetwork], float]:
        true = RADAR_STD[axis] ** 2
        return lambda model: float(_cov(model.observation[0])[axis, axis] / true)

    return Problem(
        truth,
        _wider(truth),
        {target: Covariance("scaled"), radar: Covariance("diagonal")},
        lambda steps: {},
        {
            "process": lambda model: float(np.trace(_cov(model.transition[0])) / np.trace(noise)),
            "range": share(0),
            "bearing": share(1),
        },
    )


def _seen(x: np.ndarray[Any, np.dtype[np.float64]]) -> Any:
    east, north = x[..., 0], x[..., 1]
    return np.stack([np.hypot(east, north), np.arctan2(north, east)], axis=-1)


def _cov(cpd: Any) -> Any:
    return cpd.cov


def _wider(model: pgm.DynamicBayesianNetwork) -> pgm.DynamicBayesianNetwork:
    """The model with larger noise of its motion and sensor."""

    def wider(cpd: Any) -> pgm.NonlinearGaussianCPD:
        parts = cpd.child, cpd.given, cpd.function, START * cpd.cov
        return pgm.NonlinearGaussianCPD(*parts, jacobian=cpd.jacobian)

    return model.replace(
        transition=map(wider, model.transition), observation=map(wider, model.observation)
    )
