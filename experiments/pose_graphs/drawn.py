"""A pose graph whose truth is known, and loop closures that are false.

The world is that of Olson's Manhattan graphs: a robot goes along the streets of a town of square
blocks, and at a crossing where it was before, or next to one, it may recognise the place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from models import motion
from pgm.errors import EvidenceError
from pgm.recordings import Edges, PoseGraph

Array = npt.NDArray[np.float64]

STD = (0.05, 0.05, 0.02)  # m, m, rad: of a step, and of a closure
AHEAD = 0.6  # the probability that it goes straight on
RECOGNISED = 0.2  # and that it recognises a place
# A closure is of poses that are so many steps apart at the least, and so near to each other [m].
APART, NEAR = 10, 1.2


def manhattan(poses: int, rng: np.random.Generator) -> tuple[PoseGraph, Array]:
    """Draw a graph, and the true poses (N, 3) [m, m, rad].

    Poses to start from are those of the odometry. The town is so large that the robot is at each
    crossing twice in the mean.
    """
    truth = _streets(poses, rng)
    away = np.linalg.norm(truth[:, None, :2] - truth[:, :2], axis=-1)
    later, earlier = np.nonzero(np.tril(away <= NEAR, -APART))
    known = rng.uniform(size=later.size) < RECOGNISED
    first = np.concatenate([np.arange(poses - 1), later[known]])
    second = np.concatenate([np.arange(1, poses), earlier[known]])
    told = motion.relative(truth[first], truth[second]) + rng.normal(size=(first.size, 3)) * STD
    told[:, 2] = np.remainder(told[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    reckoned = truth[:1].repeat(poses, axis=0)
    for t in range(poses - 1):
        reckoned[t + 1] = motion.increment(reckoned[t], told[t])
    information = np.broadcast_to(np.diag(1.0 / np.square(STD)), (first.size, 3, 3)).copy()
    nothing = np.zeros(0, dtype=np.intp)
    graph = PoseGraph(
        names=np.arange(poses),
        poses=reckoned,
        edges=Edges(first, second, told, information),
        landmark_names=nothing,
        landmarks=np.zeros((0, 2)),
        sightings=Edges(nothing, nothing, np.zeros((0, 2)), np.zeros((0, 2, 2))),
        fixed=nothing,
    )
    return graph, truth


def with_false(graph: PoseGraph, share: float, rng: np.random.Generator) -> PoseGraph:
    """The graph with false closures behind its edges.

    Each says of two poses drawn at random what one of the true closures, drawn too, says of its
    own: a place that looks like another is taken for it.

    Parameters
    ----------
    graph : PoseGraph
    share : float
        How many false closures there are for each that is in the graph.
    rng : numpy.random.Generator

    Raises
    ------
    EvidenceError
        If the graph has no closures to take for others.
    """
    loops, edges = graph.loops, graph.edges
    if not loops.size:
        raise EvidenceError(f"{graph._title} has no loop closures that could be taken for others")
    of = rng.choice(loops, max(1, round(share * loops.size)))
    ends = np.array([rng.choice(len(graph.poses), 2, replace=False) for _ in of])
    return replace(
        graph,
        edges=Edges(
            np.append(edges.first, ends[:, 0]),
            np.append(edges.second, ends[:, 1]),
            np.concatenate([edges.motions, edges.motions[of]]),
            np.concatenate([edges.information, edges.information[of]]),
        ),
    )


def _streets(poses: int, rng: np.random.Generator) -> Array:
    """Poses one metre apart along the streets; where the town ends the robot turns."""
    half = max(2, round(0.35 * np.sqrt(poses)))
    ways = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
    place, turns, found = np.zeros(2, dtype=int), 0, []
    for _ in range(poses):
        found.append((*place, 0.5 * np.pi * turns))
        turn = rng.choice((0, 1, -1), p=(AHEAD, 0.5 - 0.5 * AHEAD, 0.5 - 0.5 * AHEAD))
        while np.abs(place + ways[(turns + turn) % 4]).max() > half:
            turn = 1 if turn == 0 else turn + np.sign(turn)
        turns += turn
        place = place + ways[turns % 4]
    return np.array(found, dtype=np.float64)
