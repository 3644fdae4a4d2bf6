"""Three problems: the network for the cluster graph, and the same model for the textbook."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

import pgm
from experiments.textbook import (
    Belief,
    Step,
    extended_kalman_filter,
    kalman_filter,
    unscented_kalman_filter,
)
from models import sensors
from models.motion import Velocity
from models.networks import linear_velocity, point, pose, speed, velocity, velocity_position

Array = npt.NDArray[np.float64]
OneStep = Callable[[Belief, Array, Array], Step]

DT = 1.0  # s
# Standard deviations: the start, a step's motion, a reading [m, m, rad].
START, MOTION, SENSOR = (0.25, 0.15), (0.25, 0.2), (0.3, 0.3)
START_POSE, MOTION_POSE = (0.15, 0.25, 0.15), (0.15, 0.15, 0.1)
# The five controls of the figures: velocities east and north [m/s]; speeds and turns [m/s, rad/s].
STRAIGHT = np.array([[1.0, 0.2], [1.0, 0.4], [1.2, 0.1], [1.0, -0.3], [1.1, 0.3]])
TURNS = np.array([[1.0, 0.3], [1.2, 0.5], [1.0, 0.4], [1.1, -0.5], [1.2, -0.7]])


@dataclass(frozen=True, eq=False)
class Problem:
    """A filter of the textbook and what the cluster graph needs to be the same.

    Attributes
    ----------
    title : str
        The name of the filter, without the word.
    network : DynamicBayesianNetwork
    state, control : Variable
    lineariser : Lineariser
        Irrelevant where the network is linear.
    one_step : callable
        The textbook's filter.
    initial : Belief
        The textbook's, at step 0.
    controls : ndarray
        (5, 2): those of the figure.
    colour : str
        Of the figure.
    """

    title: str
    network: pgm.DynamicBayesianNetwork
    state: pgm.Variable
    control: pgm.Variable
    lineariser: pgm.Lineariser
    one_step: OneStep
    initial: Belief
    controls: Array
    colour: str


def problems() -> dict[str, Problem]:
    """The linear robot, then the robot that drives arcs with either linearisation."""
    drive, plane = Velocity(dt=DT), np.eye(2)
    kalman = partial(
        kalman_filter,
        A=plane,
        B=DT * plane,
        C=plane,
        process_noise=_cov(MOTION),
        sensor_noise=_cov(SENSOR),
    )
    extended = partial(
        extended_kalman_filter,
        g=drive,
        G=drive.by_state,
        h=sensors.position,
        H=sensors.position_by_state,
        process_noise=_cov(MOTION_POSE),
        sensor_noise=_cov(SENSOR),
    )
    unscented = partial(
        unscented_kalman_filter,
        g=drive,
        h=sensors.position,
        process_noise=_cov(MOTION_POSE),
        sensor_noise=_cov(SENSOR),
    )
    line = linear_velocity(DT, start_std=START, motion_std=MOTION, sensor_std=SENSOR)
    arcs = velocity_position(DT, start_std=START_POSE, motion_std=MOTION_POSE, sensor_std=SENSOR)
    taylor, sigma = pgm.Taylor(), pgm.Unscented()
    at, posed = Belief(np.zeros(2), _cov(START)), Belief(np.zeros(3), _cov(START_POSE))
    return {
        "kalman": Problem("Kalman", line, point, speed, taylor, kalman, at, STRAIGHT, "#762A83"),
        "extended": Problem(
            "extended Kalman", arcs, pose, velocity, taylor, extended, posed, TURNS, "#009E73"
        ),
        "unscented": Problem(
            "unscented Kalman", arcs, pose, velocity, sigma, unscented, posed, TURNS, "#0072B2"
        ),
    }


def _cov(std: Sequence[float]) -> Array:
    return np.diag(np.square(std))
