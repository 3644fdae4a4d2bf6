"""gtsam's ISAM2 on a pose graph pose by pose."""

from __future__ import annotations

import gtsam
import numpy as np

from benchmarks.libraries.gtsam_robots import KNOWN, coordinates
from benchmarks.timing import Contender
from benchmarks.work.asked import Array
from benchmarks.work.pose_graphs import Surveyed, arriving

Step = tuple[int, gtsam.Pose2, bool, list[gtsam.BetweenFactorPose2]]


def growing(work: Surveyed, *, skip: int = 1) -> Contender:
    """Each pose with its edges to those before it, and its own estimate: at the end all, (N, 3).

    By QR, since by Cholesky the graph M3500 becomes indeterminate at its pose 695. Variables are
    linearised anew at each so many additions, where they are beyond a tenth of a metre or radian.
    """
    steps = _steps(work)
    known = gtsam.noiseModel.Isotropic.Sigma(3, KNOWN)
    first = gtsam.Pose2(*work.graph.poses[0])

    def call() -> Array:
        settings = gtsam.ISAM2Params()
        settings.setRelinearizeThreshold(0.1)
        settings.relinearizeSkip = skip
        settings.setFactorization("QR")
        isam = gtsam.ISAM2(settings)
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        factors.add(gtsam.PriorFactorPose2(0, first, known))
        values.insert(0, first)
        isam.update(factors, values)
        here = first
        for key, (before, move, onward, between) in enumerate(steps, start=1):
            factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            for factor in between:
                factors.add(factor)
            at = here if before == key - 1 else isam.calculateEstimatePose2(before)
            values.insert(key, at.compose(move if onward else move.inverse()))
            isam.update(factors, values)
            here = isam.calculateEstimatePose2(key)
        found = isam.calculateEstimate()
        return np.array([coordinates(found.atPose2(key)) for key in range(len(steps) + 1)])

    return Contender(call, work.units)


def _steps(work: Surveyed) -> list[Step]:
    """By pose, from the second: by which edge it comes in, and the factors that it brings."""
    edges, found = work.graph.edges, []
    for rows in arriving(work):
        leading = max(rows, key=lambda row: min(edges.first[row], edges.second[row]))
        one, other = int(edges.first[leading]), int(edges.second[leading])
        between = [
            gtsam.BetweenFactorPose2(
                int(edges.first[row]),
                int(edges.second[row]),
                gtsam.Pose2(*edges.motions[row]),
                gtsam.noiseModel.Gaussian.Information(edges.information[row]),
            )
            for row in rows
        ]
        move = gtsam.Pose2(*edges.motions[leading])
        found.append((min(one, other), move, one < other, between))
    return found
