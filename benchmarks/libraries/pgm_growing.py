"""pgm's growing map on a pose graph pose by pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.asked import Array
from benchmarks.work.pose_graphs import Surveyed, arriving
from models import motion
from models.pose_graphs import PoseGraphNetwork, pose_graph_network
from pgm.cpds import CPD

Step = tuple[int, Array, bool, list[CPD], dict[pgm.Variable, Array]]


def growing(work: Surveyed, *, compiled: bool = False) -> Contender:
    """Each pose with its edges to those before it, and its own mean: at the end all, (N, 3).

    CPDs are declared beforehand, as those of a robot would be by a plate.
    """
    made = pose_graph_network(work.graph)
    held, priors = made.poses[0], _priors(made)
    steps = _steps(work, made, priors)

    def call() -> Array:
        grown = pgm.GrowingMap(compiled=compiled)
        grown = grown.add([priors[0]], {held: made.evidence[held]})
        here = made.evidence[held]
        for key, (before, move, onward, cpds, evidence) in enumerate(steps, start=1):
            if before != key - 1:
                here = grown.means([made.poses[before]])[0] if before else made.evidence[held]
            pose = made.poses[key]
            guess = (motion.increment if onward else motion.retreat)(here, move)
            grown = grown.add(cpds, evidence, start={pose: guess})
            here = grown.means([pose])[0]
        return np.concatenate([[made.evidence[held]], grown.means(made.poses[1:])])

    return Contender(call, work.units)


def _priors(made: PoseGraphNetwork) -> tuple[pgm.GaussianCPD, ...]:
    """Flat priors of the poses: a growing map is of CPDs."""
    anywhere = pgm.GaussianCPD(made.poses[0], made.graph.poses[0], np.inf)
    return pgm.plate(anywhere, {made.poses[0]: made.poses}, mean=made.graph.poses)


def _measured(made: PoseGraphNetwork) -> tuple[pgm.NonlinearGaussianCPD, ...]:
    """The edges as CPDs of what was measured."""
    edges, poses = made.graph.edges, made.poses
    z = pgm.variables((f"z{row}" for row in range(len(edges))), poses[0].components, ("heading",))
    one, other = pgm.variables("one other", poses[0].components, ("heading",))
    seen = pgm.NonlinearGaussianCPD(
        z[0],
        given=(one, other),
        function=motion.relative,
        cov=np.eye(3),
        jacobian={one: motion.relative_by_state, other: motion.relative_by_other},
    )
    over = {
        z[0]: z,
        one: [poses[row] for row in edges.first],
        other: [poses[row] for row in edges.second],
    }
    covs = [factor.cov for factor in made.edges if isinstance(factor.cov, np.ndarray)]
    return pgm.plate(seen, over, cov=np.stack(covs))


def _steps(work: Surveyed, made: PoseGraphNetwork, priors: Sequence[pgm.GaussianCPD]) -> list[Step]:
    """By pose, from the second: by which edge it comes in, and the CPDs and evidence it brings."""
    edges, found = work.graph.edges, []
    measured = _measured(made)
    for key, rows in enumerate(arriving(work), start=1):
        leading = max(rows, key=lambda row: min(edges.first[row], edges.second[row]))
        one, other = int(edges.first[leading]), int(edges.second[leading])
        cpds: list[CPD] = [priors[key], *(measured[row] for row in rows)]
        evidence = {measured[row].child: edges.motions[row] for row in rows}
        found.append((min(one, other), edges.motions[leading], one < other, cpds, evidence))
    return found
