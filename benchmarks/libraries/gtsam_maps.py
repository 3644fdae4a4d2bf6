"""gtsam on pose graphs and maps of landmarks: Levenberg–Marquardt, and all marginals.

Its poses are changed in their own frame, in which its covariances are. The first one is held by a
prior that leaves it no room. Its error of a measured motion is a logarithm, ours a difference.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gtsam
import numpy as np

from benchmarks.libraries.gtsam_robots import KNOWN, Built, coordinates, turned
from benchmarks.timing import Contender
from benchmarks.work import landmarks
from benchmarks.work.asked import Beliefs
from benchmarks.work.landmarks import Map
from benchmarks.work.pose_graphs import Surveyed


def marginals(kind: str, work: Any) -> Contender:
    """The graph built beforehand."""
    graph, values = BUILT[kind](work)
    return Contender(lambda: _solved(graph, values, work.units), work.units)


def whole(kind: str, work: Any) -> Contender:
    """From numbers to marginals: built and solved."""
    return Contender(lambda: _solved(*BUILT[kind](work), work.units), work.units)


def _solved(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, poses: int) -> list[Beliefs]:
    """Of all poses but the first, then of landmarks."""
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    marginals = gtsam.Marginals(graph, found)
    moved, seen = range(1, poses), range(poses, values.size())
    means = np.array([coordinates(found.atPose2(key)) for key in moved])
    covs = turned(means, np.array([marginals.marginalCovariance(key) for key in moved]))
    if not seen:
        return [(means, covs)]
    places = np.array([found.atPoint2(key) for key in seen])
    return [(means, covs), (places, np.array([marginals.marginalCovariance(key) for key in seen]))]


def _surveyed(work: Surveyed) -> Built:
    """A graph of measured motions."""
    edges = work.graph.edges
    graph, values = _begun(work.graph.poses)
    for one, other, move, information in zip(
        edges.first.tolist(),
        edges.second.tolist(),
        edges.motions.tolist(),
        edges.information,
        strict=True,
    ):
        noise = gtsam.noiseModel.Gaussian.Information(information)
        graph.add(gtsam.BetweenFactorPose2(one, other, gtsam.Pose2(*move), noise))
    return graph, values


def _mapped(work: Map) -> Built:
    """A graph of odometry and sightings."""
    graph, values = _begun(work.poses)
    sigmas = gtsam.noiseModel.Diagonal.Sigmas
    moved, seen = sigmas(landmarks.ODOMETRY_STD), sigmas(landmarks.SIGHT_STD[::-1])
    wide = gtsam.noiseModel.Isotropic.Sigma(2, landmarks.PLACE_STD)
    for k, step in enumerate(work.odometry.tolist()):
        graph.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(*step), moved))
    first = len(work.poses)
    for key, place in enumerate(work.places, start=first):
        values.insert(key, place)
        graph.add(gtsam.PriorFactorPoint2(key, np.zeros(2), wide))
    for who, what, (away, side) in zip(
        work.who.tolist(), (first + work.what).tolist(), work.sights.tolist(), strict=True
    ):
        graph.add(gtsam.BearingRangeFactor2D(who, what, gtsam.Rot2(side), away, seen))
    return graph, values


def _begun(poses: np.ndarray) -> Built:
    """A graph in which the first pose is known, and values of all."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, pose in enumerate(poses.tolist()):
        values.insert(key, gtsam.Pose2(*pose))
    known = gtsam.noiseModel.Isotropic.Sigma(3, KNOWN)
    graph.add(gtsam.PriorFactorPose2(0, values.atPose2(0), known))
    return graph, values


BUILT: dict[str, Callable[[Any], Built]] = {"surveyed": _surveyed, "mapped": _mapped}
