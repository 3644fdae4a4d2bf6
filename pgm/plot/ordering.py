"""The order of nodes within their layers, so that few arrows cross."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import networkx as nx
import numpy as np

_STARTS = 4
_SWEEPS = 8


def ordered(
    layers: list[list[int]], links: Iterable[tuple[int, int]]
) -> tuple[list[list[int]], int]:
    """Layers with few crossings between each and the next, and how many there are.

    Sweeps down and up put each node at the mean place of its neighbours, then swap neighbours in
    a layer where that helps; from several starts, the best is taken.

    Parameters
    ----------
    layers : list of list of int
    links : iterable of (int, int)
        Each from one layer to the next.

    References
    ----------
    Sugiyama, Tagawa & Toda, Methods for visual understanding of hierarchical systems, 1981.
    """
    links = list(links)
    graph = nx.Graph()
    graph.add_nodes_from(sorted(node for layer in layers for node in layer))
    graph.add_edges_from(links)
    best, fewest = layers, -1
    busiest = sorted(graph, key=lambda node: (-graph.degree[node], node))
    for start in [layers[0][0], *busiest[:_STARTS]]:
        near = {node: k for k, node in enumerate(_from(graph, start))}
        current = [sorted(layer, key=near.__getitem__) for layer in layers]
        for sweep in range(_SWEEPS):
            _sweep(current, graph, down=sweep % 2 == 0)
            _swap(current, graph)
            found = sum(_crossings(graph, a, b) for a, b in pairwise(current))
            if fewest < 0 or found < fewest:
                best, fewest = [list(layer) for layer in current], found
        if fewest == 0:
            break
    return best, fewest


def _from(graph: nx.Graph, start: int) -> list[int]:
    """All nodes, depth first, the start's component first."""
    found = list(nx.dfs_preorder_nodes(graph, start))
    return found + [node for node in graph if node not in set(found)]


def _sweep(layers: list[list[int]], graph: nx.Graph, *, down: bool) -> None:
    order = range(1, len(layers)) if down else range(len(layers) - 2, -1, -1)
    for k in order:
        place = {node: at for at, node in enumerate(layers[k - 1 if down else k + 1])}
        # Nodes without neighbours there stay where they are.
        mean = {
            node: float(np.mean(at)) if (at := _places(graph, node, place)) else float(here)
            for here, node in enumerate(layers[k])
        }
        layers[k].sort(key=mean.__getitem__)


def _swap(layers: list[list[int]], graph: nx.Graph) -> None:
    """Swap neighbours in a layer as long as that leaves fewer crossings."""
    for k, layer in enumerate(layers):
        beside = [
            {node: at for at, node in enumerate(layers[j])}
            for j in (k - 1, k + 1)
            if 0 <= j < len(layers)
        ]
        seen = {node: [_places(graph, node, place) for place in beside] for node in layer}
        changed = True
        while changed:
            changed = False
            for at in range(len(layer) - 1):
                left, right = seen[layer[at]], seen[layer[at + 1]]
                gain = sum(
                    (a > b) - (a < b)
                    for one, other in zip(left, right, strict=True)
                    for a in one
                    for b in other
                )
                if gain > 0:
                    layer[at], layer[at + 1] = layer[at + 1], layer[at]
                    changed = True


def _places(graph: nx.Graph, node: int, place: dict[int, int]) -> list[int]:
    return [place[other] for other in graph[node] if other in place]


def _crossings(graph: nx.Graph, upper: list[int], lower: list[int]) -> int:
    place = {node: at for at, node in enumerate(lower)}
    ends = np.array(
        [(at, there) for at, node in enumerate(upper) for there in _places(graph, node, place)]
    ).reshape(-1, 2)
    above, below = (np.sign(column[:, None] - column) for column in ends.T)
    return int((above * below < 0).sum()) // 2
