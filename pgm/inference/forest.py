"""Trees of clusters, rooted at their centres."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.kernels.arrays import Integers


@dataclass(frozen=True, eq=False)
class Forest:
    """The trees of a cluster graph, each hung at its centre, so that few rounds reach all.

    `parent` is −1 at a root; `levels` are the clusters at each depth, the roots first.
    """

    parent: Integers
    depth: Integers
    levels: list[Integers]

    @classmethod
    def of(cls, graph: ClusterGraph) -> Forest:
        """Root the trees of a graph without loops."""
        neighbours = [graph.neighbours(k) for k in range(len(graph))]
        parent = np.full(len(graph), -1, dtype=np.intp)
        depth = np.full(len(graph), -1, dtype=np.intp)
        for first in range(len(graph)):
            if depth[first] < 0:
                root = _centre(neighbours, first)
                depth[root] = 0
                for source, target in _edges(neighbours, root):
                    parent[target], depth[target] = source, depth[source] + 1
        order = np.argsort(depth, kind="stable")
        bounds = np.cumsum(np.bincount(depth))
        return cls(parent, depth, np.split(order, bounds[:-1]))

    @cached_property
    def children(self) -> list[list[int]]:
        """The clusters that hang on each."""
        found: list[list[int]] = [[] for _ in self.parent]
        for k, parent in enumerate(self.parent.tolist()):
            if parent >= 0:
                found[parent].append(k)
        return found

    @cached_property
    def roots(self) -> Integers:
        """The root of each cluster's tree, (clusters,)."""
        found = np.arange(self.parent.size)
        for level in self.levels[1:]:
            found[level] = found[self.parent[level]]
        return found


def _edges(neighbours: list[tuple[int, ...]], root: int) -> list[tuple[int, int]]:
    found, queue = [], deque([(root, -1)])
    while queue:
        at, before = queue.popleft()
        for other in neighbours[at]:
            if other != before:
                found.append((at, other))
                queue.append((other, at))
    return found


def _centre(neighbours: list[tuple[int, ...]], first: int) -> int:
    """The middle of a longest path, which joins the two clusters farthest from one another."""
    edges = _edges(neighbours, first)
    end = edges[-1][1] if edges else first
    before = {target: source for source, target in _edges(neighbours, end)}
    path = [next(reversed(before), end)]
    while path[-1] != end:
        path.append(before[path[-1]])
    return path[len(path) // 2]
