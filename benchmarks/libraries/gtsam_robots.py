"""gtsam: the most probable poses of a whole drive, and all their marginals.

Its sensors look at landmarks that are variables, so each has a prior that leaves it no room. Its
poses are changed in their own frame, in which its covariances are, and the motion's noise, too: it
must be isotropic in the plane.
"""

from __future__ import annotations

import gtsam
import numpy as np

from benchmarks.timing import Contender
from benchmarks.work.robots import DRIVE, Array, Robots

KNOWN = 1e-6  # standard deviation of a known landmark [m]

OPTIMISERS = {
    "gauss_newton": gtsam.GaussNewtonOptimizer,
    "levenberg_marquardt": gtsam.LevenbergMarquardtOptimizer,
}
Built = tuple[gtsam.NonlinearFactorGraph, gtsam.Values]


def smoothing(method: str, work: Robots) -> Contender:
    """Optimum and marginals, the graph built beforehand: means (T, 3) and covariances."""
    graph, values = _build(work)
    optimise = OPTIMISERS[method]

    def call() -> tuple[Array, Array]:
        found = optimise(graph, values).optimize()
        marginals = gtsam.Marginals(graph, found)
        keys = range(1, work.steps + 1)
        means = np.array([coordinates(found.atPose2(key)) for key in keys])
        return means, turned(means, np.stack([marginals.marginalCovariance(k) for k in keys]))

    return Contender(call, work.steps)


def optimising(method: str, work: Robots) -> Contender:
    """The optimum alone: means (T, 3)."""
    graph, values = _build(work)

    def call() -> Array:
        found = OPTIMISERS[method](graph, values).optimize()
        return np.array([coordinates(found.atPose2(key)) for key in range(1, work.steps + 1)])

    return Contender(call, work.steps)


def building(work: Robots) -> Contender:
    """The graph and its first values, in Python."""
    return Contender(lambda: _build(work), work.steps)


def _build(work: Robots) -> Built:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    diagonal = gtsam.noiseModel.Diagonal.Sigmas
    motion = diagonal(np.sqrt(np.diag(work.motion_cov)))
    sight = diagonal(np.sqrt(np.diag(work.sensor_cov))[::-1])  # bearing first
    known = gtsam.noiseModel.Isotropic.Sigma(2, KNOWN)
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), diagonal(np.sqrt(np.diag(work.start[1])))))
    for key, pose in enumerate(work.dead_reckoning(0)):
        values.insert(key, gtsam.Pose2(*pose))
    for k, change in enumerate(DRIVE(np.zeros((work.steps, 3)), work.controls)):
        graph.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(*change), motion))
    places, keys = np.unique(work.landmarks.reshape(-1, 2), axis=0, return_inverse=True)
    first = work.steps + 1
    for key, place in enumerate(places, start=first):
        values.insert(key, place)
        graph.add(gtsam.PriorFactorPoint2(key, place, known))
    for k, seen in enumerate(first + keys.reshape(work.landmarks.shape[:2])):
        for key, (away, side) in zip(seen.tolist(), work.readings[0, k], strict=True):
            graph.add(gtsam.BearingRangeFactor2D(k + 1, key, gtsam.Rot2(side), away, sight))
    return graph, values


def coordinates(pose: gtsam.Pose2) -> tuple[float, float, float]:
    return pose.x(), pose.y(), pose.theta()


def turned(means: Array, covs: Array) -> Array:
    """Covariances from the robot's frame to that of the map."""
    cos, sin = np.cos(means[:, 2]), np.sin(means[:, 2])
    turn = np.zeros((len(means), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = cos
    turn[:, 0, 1], turn[:, 1, 0] = -sin, sin
    turn[:, 2, 2] = 1.0
    world: Array = turn @ covs @ turn.swapaxes(-1, -2)
    return world
