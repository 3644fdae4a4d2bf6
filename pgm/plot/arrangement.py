"""Where the clusters and sepsets of a graph stand: chains in rows, trees in layers, the rest free.

All lengths are points; y grows upwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import networkx as nx
import numpy as np

from pgm.clustergraph.checks import Edge
from pgm.kernels.arrays import Array
from pgm.plot.canvas import Box, Point, Size

GAP = 12.0
STUB = 30.0
# Room of a chain, in points, where no axes limits it: about the width of a page.
_PAGE = 12.0 * 72.0
# Where a sepset may stand on a straight edge, the best place first.
_PARTS = (0.5, 0.4, 0.6, 0.3, 0.7)


@dataclass
class Arrangement:
    """Points of clusters and sepsets, and the lines that join them.

    Attributes
    ----------
    clusters : dict of int to Point
    sepsets : dict of (int, int) to Point
    routes : dict of (int, int) to list of Point
        The corners of the line from cluster to cluster.
    """

    clusters: dict[int, Point] = field(default_factory=dict)
    sepsets: dict[Edge, Point] = field(default_factory=dict)
    routes: dict[Edge, list[Point]] = field(default_factory=dict)

    def box(self, clusters: Mapping[int, Size], sepsets: Mapping[Edge, Size]) -> Box:
        """The bounds of everything."""
        shapes = [(at, clusters[k]) for k, at in self.clusters.items()]
        shapes += [(at, sepsets[edge]) for edge, at in self.sepsets.items()]
        shapes += [(at, Size(0.0, 0.0)) for route in self.routes.values() for at in route]
        return Box(
            min(x - 0.5 * size.width for (x, _), size in shapes),
            min(y - 0.5 * size.height for (_, y), size in shapes),
            max(x + 0.5 * size.width for (x, _), size in shapes),
            max(y + 0.5 * size.height for (_, y), size in shapes),
        )

    def put_below(self, other: Arrangement, top: float, bottom: float) -> None:
        """Add another arrangement, whose bounds reach up to `top`, below `bottom`."""
        shift = bottom - top

        def move(at: Point) -> Point:
            return at[0], at[1] + shift

        self.clusters |= {k: move(at) for k, at in other.clusters.items()}
        self.sepsets |= {edge: move(at) for edge, at in other.sepsets.items()}
        self.routes |= {edge: [move(at) for at in route] for edge, route in other.routes.items()}


def arrange(
    graph: nx.Graph,
    clusters: Mapping[int, Size],
    sepsets: Mapping[Edge, Size],
    room: Size | None,
) -> Arrangement:
    """Arrange clusters so that no shape lies on another.

    Parameters
    ----------
    graph : networkx.Graph
        Nodes are indices of clusters.
    clusters, sepsets : mapping to Size
        How large the shapes are.
    room : Size or None
        Of the axes; a chain takes as many rows as make it largest there. None for a page.
    """
    whole = Arrangement()
    for nodes in nx.connected_components(graph):
        piece = graph.subgraph(sorted(nodes))
        degrees = [degree for _, degree in piece.degree]
        if not nx.is_tree(piece):
            part = _free(piece, clusters, sepsets)
        elif max(degrees) > 2:
            part = _tree(piece, clusters, sepsets)
        else:
            part = _chain(_path(piece), clusters, sepsets, room)
        if whole.clusters:
            lowest = whole.box(clusters, sepsets).bottom
            whole.put_below(part, part.box(clusters, sepsets).top, lowest - 2.0 * GAP)
        else:
            whole = part
    return whole


def key(i: int, j: int) -> Edge:
    """An edge as the graph's sepsets name it, lower index first."""
    return (i, j) if i < j else (j, i)


def _path(graph: nx.Graph) -> list[int]:
    start = min(node for node, degree in graph.degree if degree < 2)
    return list(nx.dfs_preorder_nodes(graph, start))


def _chain(
    order: list[int],
    clusters: Mapping[int, Size],
    sepsets: Mapping[Edge, Size],
    room: Size | None,
) -> Arrangement:
    width = max(clusters[k].width for k in order)
    height = max(clusters[k].height for k in order)
    between = max((sepsets[key(*edge)].width for edge in pairwise(order)), default=0.0)
    across, down = width + between + 2.0 * GAP, height + 3.0 * GAP
    per_row = _per_row(len(order), across, down, room)

    result = Arrangement()
    for k, index in enumerate(order):
        result.clusters[index] = (across * (k % per_row), -down * (k // per_row))
    for here, there in pairwise(order):
        start, end = result.clusters[here], result.clusters[there]
        beside = start[0] + 0.5 * across
        result.sepsets[key(here, there)] = (beside, start[1])
        route = [start, end]
        if start[1] != end[1]:
            # Round the end of the row, between the rows, and in again from the left.
            right = beside + 0.5 * between + GAP
            left = end[0] - 0.5 * width - GAP
            middle = 0.5 * (start[1] + end[1])
            corners = [(right, start[1]), (right, middle), (left, middle), (left, end[1])]
            route = [start, *corners, end]
        result.routes[key(here, there)] = route
    return result


def _per_row(count: int, across: float, down: float, room: Size | None) -> int:
    if room is None:
        widest = max(1, int(_PAGE // across))
    else:
        scales = [
            min(room.width / (across * n), room.height / (down * -(-count // n)))
            for n in range(1, count + 1)
        ]
        widest = 1 + int(np.argmax(scales))
    lines = -(-count // widest)
    return -(-count // lines)


def _tree(
    graph: nx.Graph, clusters: Mapping[int, Size], sepsets: Mapping[Edge, Size]
) -> Arrangement:
    """Layers left to right from a centre; a cluster stands at the middle of its subtrees."""
    root = min(nx.center(graph))
    across = (
        max(clusters[k].width for k in graph)
        + max(size.width for size in sepsets.values())
        + 3.0 * GAP
    )
    down = GAP + max(
        max(clusters[k].height for k in graph), 2.0 * max(s.height for s in sepsets.values())
    )
    depth = nx.single_source_shortest_path_length(graph, root)
    tree = nx.dfs_tree(graph, root)
    level: dict[int, float] = {}
    leaves = 0
    for node in nx.dfs_postorder_nodes(tree, root):
        below = [level[child] for child in tree.successors(node)]
        if not below:
            leaves += 1
        level[node] = 0.5 * (min(below) + max(below)) if below else -down * leaves
    points = {node: (across * depth[node], level[node]) for node in graph}
    return _straight(points, dict.fromkeys((key(*edge) for edge in graph.edges), 0.5))


def _free(
    graph: nx.Graph, clusters: Mapping[int, Size], sepsets: Mapping[Edge, Size]
) -> Arrangement:
    """The layout of Kamada and Kawai, stretched until no shape lies on another."""
    # Shapes are wider than high, so the layout's circle becomes an ellipse.
    layout = nx.kamada_kawai_layout(graph)
    points = {k: np.array([1.6, 1.0]) * layout[k] for k in graph}
    at, sizes = [points[k] for k in graph], [clusters[k] for k in graph]
    stretch = max(_needed(at[:k], sizes[:k], at[k], sizes[k]) for k in range(len(at)))
    parts = {}
    for i, j in sorted(key(*edge) for edge in graph.edges):
        # Crossing edges have their middles near each other: one sepset moves along its edge.
        tries = [points[i] + part * (points[j] - points[i]) for part in _PARTS]
        needed = [_needed(at, sizes, middle, sepsets[i, j]) for middle in tries]
        best = next((k for k, one in enumerate(needed) if one <= stretch), int(np.argmin(needed)))
        parts[i, j] = _PARTS[best]
        stretch = max(stretch, needed[best])
        at.append(tries[best])
        sizes.append(sepsets[i, j])
    return _straight(
        {k: (stretch * float(x), stretch * float(y)) for k, (x, y) in points.items()}, parts
    )


def _needed(at: list[Array], sizes: list[Size], new: Array, size: Size) -> float:
    """By how much to stretch a layout so that a new shape lies on none of the others."""
    if not at:
        return 1.0
    apart = np.maximum(np.abs(np.array(at) - new), 1e-9)
    clear = 0.5 * (np.array(sizes) + np.array(size)) + GAP
    return float((clear / apart).min(axis=-1).max())


def _straight(points: dict[int, Point], parts: Mapping[Edge, float]) -> Arrangement:
    """Straight lines between clusters, with the sepsets at some part of them."""
    result = Arrangement(points)
    for (i, j), part in parts.items():
        (x, y), (right, top) = points[i], points[j]
        result.sepsets[i, j] = (x + part * (right - x), y + part * (top - y))
        result.routes[i, j] = [points[i], points[j]]
    return result
