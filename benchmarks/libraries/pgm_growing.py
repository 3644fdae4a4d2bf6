"""pgm's growing map on a pose graph pose by pose."""

from __future__ import annotations

from itertools import chain

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
    held, steps = made.poses[0], _steps(work, made)
    priors = {cpd.child: cpd for cpd in made.network.cpds}

    def call() -> Array:
        grown = pgm.GrowingMap(compiled=compiled)
        grown = grown.add([priors[held]], {held: made.evidence[held]})
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


def _steps(work: Surveyed, made: PoseGraphNetwork) -> list[Step]:
    """By pose, from the second: by which edge it comes in, and the CPDs and evidence it brings."""
    edges, found = work.graph.edges, []
    own = {cpd.child.name: cpd for cpd in made.network.cpds}
    for key, rows in enumerate(arriving(work), start=1):
        leading = max(rows, key=lambda row: min(edges.first[row], edges.second[row]))
        one, other = int(edges.first[leading]), int(edges.second[leading])
        seen = [own[f"z{row}"] for row in rows]
        cpds = list(chain([own[made.poses[key].name]], seen))
        evidence = {cpd.child: made.evidence[cpd.child] for cpd in seen}
        found.append((min(one, other), edges.motions[leading], one < other, cpds, evidence))
    return found
