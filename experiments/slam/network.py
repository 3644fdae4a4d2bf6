"""The map and the way as one network without time, and what is inferred in it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import numpy.typing as npt

import pgm
from experiments.slam.drive import SENSOR_STD, Drive
from experiments.unsettled import unsettled
from models import motion, sensors
from models.networks import landmark, pose
from models.unknown_landmarks import place, reading
from pgm.cpds import CPD

Array = npt.NDArray[np.float64]

# The odometer's step.
moved = pgm.Variable("u", components=("forward", "left", "turn"))
# A landmark's prior: anywhere within so many metres [m].
ANYWHERE = 30.0
SCHEDULE = pgm.Calibration(iterations=50, tolerance=1e-6)


@dataclass(frozen=True, eq=False)
class Map:
    """Beliefs of all poses and landmarks, of several runs.

    Attributes
    ----------
    poses, landmarks : Gaussian
        Stacked (runs, T+1) and (runs, L), L being the landmarks that were seen.
    posterior : Posterior
    graph : ClusterGraph
    seconds : dict of str to float
        What declaring, compiling and inferring took.
    """

    poses: pgm.Gaussian
    landmarks: pgm.Gaussian
    posterior: pgm.results.Posterior
    graph: pgm.ClusterGraph
    seconds: dict[str, float]


def network(drive: Drive) -> pgm.BayesianNetwork:
    """The network; the odometer's steps are inputs.

        p(x[0]) Π p(x[t] | x[t−1], u[t]) Π p(m{k}) Π p(z{k}[t] | x[t], m{k})

    The first pose is known, so that the map has a frame. Landmarks that are not seen are left out.
    """
    cpds: list[CPD] = [pgm.GaussianCPD(pose.at(0), drive.truth[0], 0.0)]
    cov = np.diag(np.square(drive.motion_std))
    for t in range(1, drive.steps + 1):
        before, step = pose.at(t - 1), moved.at(t)
        cpds.append(
            pgm.NonlinearGaussianCPD(
                pose.at(t),
                given=(before, step),
                function=motion.increment,
                cov=cov,
                jacobian={before: motion.increment_by_state, step: motion.increment_by_control},
            )
        )
    cpds += [pgm.GaussianCPD(place(k), np.zeros(2), ANYWHERE**2) for k in drive.seen.tolist()]
    for t, k in zip(drive.step.tolist(), drive.landmark.tolist(), strict=True):
        at, mark = pose.at(t), place(k)
        cpds.append(
            pgm.NonlinearGaussianCPD(
                reading(t, k),
                given=(at, mark),
                function=sensors.range_bearing,
                cov=np.diag(np.square(SENSOR_STD)),
                jacobian={
                    at: sensors.range_bearing_by_state,
                    mark: sensors.range_bearing_by_landmark,
                },
            )
        )
    return pgm.BayesianNetwork(cpds)


def evidence(drive: Drive) -> dict[pgm.Variable, Array]:
    """Steps of the odometer and sightings, (runs, d) each."""
    steps = {moved.at(t + 1): drive.odometry[:, t] for t in range(drive.steps)}
    return steps | {
        reading(t, k): drive.sightings[:, row]
        for row, (t, k) in enumerate(zip(drive.step.tolist(), drive.landmark.tolist(), strict=True))
    }


@unsettled()
def mapped(drive: Drive, poses: Array | None = None) -> Map:
    """Infer the map and the way.

    Parameters
    ----------
    drive : Drive
    poses : ndarray, optional
        (runs, T+1, 3): where to linearise first; dead reckoning without. Landmarks begin where
        their first sightings from there put them.
    """
    begun = perf_counter()
    made = network(drive)
    declared = perf_counter()
    graph = pgm.compile(made)
    compiled = perf_counter()
    poses = drive.reckoned() if poses is None else poses
    x = [pose.at(t) for t in range(drive.steps + 1)]
    m = [place(k) for k in drive.seen.tolist()]
    start = dict(zip(x, poses.swapaxes(0, 1), strict=True))
    start |= dict(zip(m, drive.placed(poses).swapaxes(0, 1), strict=True))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.PrecisionWarning)  # a table has the digits
        posterior = pgm.infer(graph, evidence(drive), schedule=SCHEDULE, start=start)
    ways = pgm.Gaussian(
        pose, posterior.means(x), posterior.covs(x), steps=np.arange(drive.steps + 1)
    )
    marks = pgm.Gaussian(landmark, posterior.means(m), posterior.covs(m))
    seconds = {
        "declare": declared - begun,
        "compile": compiled - declared,
        "infer": perf_counter() - compiled,
    }
    return Map(ways, marks, posterior, graph, seconds)
