"""The optimum of a pose graph, with the covariances of all poses.

The network is static, poses of the whole drive in one tree of clusters (`models.pose_graphs`); it
is solved by linearising again at the beliefs, Gauss–Newton where that is Taylor's.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.pose_graphs.given import ITERATIONS
from experiments.unsettled import unsettled
from models.networks import pose
from models.pose_graphs import PoseGraphNetwork, pose_graph_network, squared_errors
from pgm.recordings import PoseGraph

Array = npt.NDArray[np.float64]

TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Prepared:
    """A pose graph's network and its junction tree.

    Attributes
    ----------
    made : PoseGraphNetwork
    compiled : ClusterGraph
    seconds : float
        What declaring and compiling took.
    """

    made: PoseGraphNetwork
    compiled: pgm.ClusterGraph
    seconds: float


@dataclass(frozen=True, eq=False)
class Solved:
    """Poses from one start by one lineariser.

    Attributes
    ----------
    poses, landmarks : ndarray
        (N, 3), (L, 2).
    covs : ndarray
        (N, 3, 3): of the poses.
    errors : ndarray
        Of each edge, then of each sighting.
    status : Status
    seconds : float
        What inferring took, with all covariances.
    weights : ndarray
        Of each edge, then of each sighting: 1 where their noise is Gaussian.
    """

    poses: Array
    landmarks: Array
    covs: Array
    errors: Array
    status: Any
    seconds: float
    weights: Array

    @property
    def beliefs(self) -> pgm.Gaussian:
        """Of the poses, stacked (N,)."""
        return pgm.Gaussian(pose, self.poses, self.covs)


def prepared(graph: PoseGraph, noise: pgm.RobustNoise | None = None) -> Prepared:
    """Declare and compile the network of a pose graph, with some noise of its closures."""
    begun = perf_counter()
    made = pose_graph_network(graph, noise)
    compiled = pgm.compile(made.network)
    return Prepared(made, compiled, perf_counter() - begun)


@unsettled()
def solve(
    ready: Prepared,
    start: tuple[Array, Array],
    lineariser: pgm.Lineariser | None = None,
    iterations: int = ITERATIONS,
) -> Solved:
    """Linearise at a start, and then at the beliefs until they stay."""
    made, begun = ready.made, perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.PrecisionWarning)  # the table has the digits
        posterior = pgm.infer(
            ready.compiled,
            made.evidence,
            schedule=pgm.Calibration(iterations=iterations, tolerance=TOLERANCE),
            start=made.start(*start),
            lineariser=lineariser or pgm.Taylor(),
        )
    poses, landmarks = made.means(posterior)
    covs, _ = made.covs(posterior)
    seconds = perf_counter() - begun
    errors = squared_errors(made.graph, poses, landmarks)
    weights = made.weights(posterior)
    return Solved(poses, landmarks, covs, errors, posterior.status, seconds, weights)
