"""Questions about trees of clusters that hang at their centres."""

from __future__ import annotations

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.factors.axes import States
from pgm.inference.forest import Forest
from pgm.kernels.arrays import Integers


def sepset_to_parent(graph: ClusterGraph, forest: Forest, cluster: int) -> States:
    """The variables that a cluster shares with its parent; of a root none."""
    parent = int(forest.parent[cluster])
    edge = (min(cluster, parent), max(cluster, parent))
    return graph.sepsets[edge] if parent >= 0 else ()  # type: ignore[return-value]


def children(forest: Forest) -> list[list[int]]:
    """The clusters that hang on each."""
    found: list[list[int]] = [[] for _ in forest.parent]
    for k, parent in enumerate(forest.parent.tolist()):
        if parent >= 0:
            found[parent].append(k)
    return found


def roots(forest: Forest) -> Integers:
    """The root of each cluster's tree, (clusters,)."""
    found = np.arange(forest.parent.size)
    for level in forest.levels[1:]:
        found[level] = found[forest.parent[level]]
    return found
