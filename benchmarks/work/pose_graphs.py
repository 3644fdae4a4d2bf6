"""Pose graphs: published ones, where their files are here, and worlds of streets in a grid."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.work.asked import Array, Asked
from models import motion
from models.pose_graphs import pose_graph_network
from pgm.recordings import Edges, PoseGraph, read_pose_graph

DATA = Path(os.environ.get("PGM_DATA") or Path(__file__).parents[3] / "shared" / "data")
# By file: poses and edges, of which a world is drawn where there is no file.
PUBLISHED = {"m3500": (3_500, 5_453), "intel": (1_728, 2_512), "CSAIL": (1_045, 1_172)}
CITY = 10_000, 20_687  # as many as the graph city10000 has
BLOCK = 5  # streets are as many metres apart
EDGE_STD = (0.05, 0.05, 0.02)  # of a measured motion [m, m, rad]
START_STD = (0.2, 0.2, 0.05)  # of the poses to start from [m, m, rad]


@dataclass(frozen=True, eq=False)
class Surveyed:
    """A pose graph whose first pose is held."""

    graph: PoseGraph

    @property
    def units(self) -> int:
        """How many poses it has."""
        return len(self.graph.poses)

    def asked(self) -> Asked:
        """All poses but the held one, from those that the graph has."""
        made = pose_graph_network(self.graph)
        start = made.start(self.graph.poses, self.graph.landmarks)
        return Asked(made.network, made.evidence, (made.poses[1:],), start)


def title(name: str) -> str:
    """The name of a published graph's row, which says where a drawn world stands in for it."""
    return f"graph_{name.lower()}" + ("" if _path(name).is_file() else "_drawn")


def published(name: str, size: int) -> Surveyed:
    """The first poses of a published graph, and the edges among them."""
    return Surveyed(_first(_whole(name), size))


@cache
def _whole(name: str) -> PoseGraph:
    path = _path(name)
    return read_pose_graph(path) if path.is_file() else streets(*PUBLISHED[name])


def _path(name: str) -> Path:
    return DATA / "posegraphs" / f"{name}.g2o"


def _first(graph: PoseGraph, size: int) -> PoseGraph:
    edges = graph.edges
    kept = np.maximum(edges.first, edges.second) < size
    ends = edges.first[kept], edges.second[kept]
    among = Edges(*ends, edges.motions[kept], edges.information[kept])
    return _graph(graph.poses[:size], among)


def arriving(work: Surveyed) -> list[list[int]]:
    """The rows of the edges that each pose has with poses before it, from the second pose on."""
    edges = work.graph.edges
    found: list[list[int]] = [[] for _ in range(work.units)]
    for row, last in enumerate(np.maximum(edges.first, edges.second).tolist()):
        found[last].append(row)
    return found[1:]


def city(size: int) -> Surveyed:
    """A drawn world of so many poses, with as many edges a pose as the graph city10000."""
    poses, edges = CITY
    return Surveyed(streets(size, size * edges // poses))


def streets(poses: int, edges: int, seed: int = 0) -> PoseGraph:
    """A robot that goes a metre at a time along streets, and at crossings straight on, or turns.

    It recognises places where it has been, or a metre from them, which closes loops. The poses to
    start from are the true ones, disturbed, as those of a relaxation are.

    Parameters
    ----------
    poses, edges : int
        There are at least as many edges as lead from pose to pose, and fewer than asked for where
        the robot has not come by its own way often enough.
    seed : int
    """
    rng = np.random.default_rng(seed)
    true = _driven(poses, rng)
    onward = np.stack([np.arange(poses - 1), np.arange(1, poses)], axis=1)
    again = _again(true[:, :2])
    closing = min(len(again), max(edges - len(onward), 0))
    chosen = again[np.sort(rng.choice(len(again), closing, replace=False))]
    first, second = np.concatenate([onward, chosen]).T
    motions = motion.relative(true[first], true[second])
    motions += np.array(EDGE_STD) * rng.standard_normal(motions.shape)
    motions[:, 2] = np.angle(np.exp(1j * motions[:, 2]))
    information = np.broadcast_to(np.diag(np.array(EDGE_STD) ** -2.0), (len(motions), 3, 3))
    start = true + np.array(START_STD) * rng.standard_normal(true.shape)
    start[0] = true[0]
    return _graph(start, Edges(first, second, motions, information))


def _driven(poses: int, rng: np.random.Generator) -> Array:
    """The way of the robot, inside a square that it fills."""
    side = BLOCK * max(round(np.sqrt(poses) / BLOCK), 2)
    ways = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    here, way, turned = np.zeros(2, dtype=int), 0, 0
    places, headings = np.empty((poses, 2)), np.empty(poses)
    for k in range(poses):
        places[k], headings[k] = here, 0.5 * np.pi * turned
        if (here % BLOCK == 0).all():
            ahead = {turn: here + BLOCK * ways[(way + turn) % 4] for turn in (0, 1, -1)}
            onto = [turn for turn, place in ahead.items() if _inside(place, side)]
            turn = int(rng.choice(onto))
            way, turned = (way + turn) % 4, turned + turn
        here = here + ways[way]
    return np.concatenate([places, headings[:, None]], axis=1)


def _inside(place: Array, side: int) -> bool:
    return bool((place >= 0).all() and (place <= side).all())


def _again(places: Array) -> Array:
    """Pairs of poses at most a metre apart that do not follow each other, (pairs, 2)."""
    been: dict[tuple[int, int], list[int]] = {}
    found = []
    for k, (east, north) in enumerate(places.astype(int).tolist()):
        for near in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            before = been.get((east + near[0], north + near[1]), [])
            found += [(j, k) for j in before if k - j > 1]
        been.setdefault((east, north), []).append(k)
    return np.array(found, dtype=int).reshape(-1, 2)


def _graph(poses: Array, edges: Edges) -> PoseGraph:
    """A graph without landmarks."""
    none, numbers = np.zeros(0, dtype=int), np.arange(len(poses))
    sightings = Edges(none, none, np.zeros((0, 2)), np.zeros((0, 2, 2)))
    return PoseGraph(numbers, poses, edges, none, np.zeros((0, 2)), sightings, none)
