"""The places of the clusters and sepsets of a graph: chains in rows, other graphs in layers."""

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from typing import cast

import networkx as nx
import numpy as np

from pgm.clustergraph.cluster import Edge
from pgm.plot.diagrams.canvas import Size
from pgm.plot.diagrams.layered import layered, rooted
from pgm.plot.diagrams.layout import GAP, PAGE, Layout, Node, best, folded, gaps, packed

# Another way to draw a graph must be better by this factor to be taken.
_BETTER = 1.1


def arrange(graph: nx.Graph, sizes: Mapping[Node, Size], room: Size | None) -> Layout:
    """Arrange clusters and sepsets so that no shape lies on another and no line runs over one.

    graph: Nodes are indices of clusters. If it is directed, from clusters to their children.
    sizes: Of the clusters, by index, and of the sepsets, by edge.
    room: Of the axes, which is made good use of. None for a page.
    """
    parts = []
    plain = graph.to_undirected(as_view=True)
    for nodes in nx.connected_components(plain):
        piece = plain.subgraph(sorted(nodes))
        if is_chain(piece):
            parts.append(_chain(_path(piece), sizes, room))
        elif graph.is_directed():
            root = next(node for node in nodes if not graph.in_degree(node))
            halves = _halves(nx.dfs_edges(graph, root))
            drawn = _along(piece, rooted(halves, sizes, room, gap=1.2 * GAP))
            parts.append(folded(drawn, sizes, gaps(drawn, sizes), room))
        else:
            parts.append(_layers(piece, sizes, room))
    return packed(parts, sizes, room)


def key(i: int, j: int) -> Edge:
    """An edge as the graph's sepsets name it, lower index first."""
    return (i, j) if i < j else (j, i)


def _path(graph: nx.Graph) -> list[int]:
    start = min(node for node, degree in graph.degree if degree < 2)
    return list(nx.dfs_preorder_nodes(graph, start))


def _chain(order: list[int], sizes: Mapping[Node, Size], room: Size | None) -> Layout:
    edges = [key(*edge) for edge in pairwise(order)]
    width = max(sizes[k].width for k in order)
    height = max(sizes[k].height for k in order)
    between = max((sizes[edge].width for edge in edges), default=0.0)
    across, down = width + between + 2.0 * GAP, height + 3.0 * GAP
    per_row = _per_row(len(order), across, down, room)

    points = [(across * (k % per_row), -down * (k // per_row)) for k in range(len(order))]
    result = Layout(dict(zip(order, points, strict=True)))
    for edge, (start, end) in zip(edges, pairwise(points), strict=True):
        beside = start[0] + 0.5 * across
        result.points[edge] = (beside, start[1])
        route = [start, end]
        if start[1] != end[1]:
            # Round the end of the row, between the rows, and in again from the left.
            right = beside + 0.5 * between + GAP
            left = end[0] - 0.5 * width - GAP
            middle = 0.5 * (start[1] + end[1])
            corners = [(right, start[1]), (right, middle), (left, middle), (left, end[1])]
            route = [start, *corners, end]
        result.lines[edge] = np.array(route)
    return result


def _per_row(count: int, across: float, down: float, room: Size | None) -> int:
    widest = max(1, int(PAGE.width // across))
    if room is not None or down * math.ceil(count / widest) > 2.0 * PAGE.height:
        # As large as can be in the room, or on a page if they run far down.
        room = room or PAGE
        scales = [
            min(room.width / (across * n), room.height / (down * -(-count // n)))
            for n in range(1, count + 1)
        ]
        widest = 1 + int(np.argmax(scales))
    lines = -(-count // widest)
    return -(-count // lines)


def _layers(graph: nx.Graph, sizes: Mapping[Node, Size], room: Size | None) -> Layout:
    layouts = (
        layered(_halves(directed.edges), sizes, room, gap=1.2 * GAP)
        for directed in _directions(graph)
    )
    drawn = _along(graph, best(layouts, sizes, room, _BETTER))
    return folded(drawn, sizes, gaps(drawn, sizes), room)


def _halves(arrows: Iterable[Edge]) -> nx.DiGraph:
    halves = nx.DiGraph()
    for i, j in arrows:
        halves.add_edge(i, key(i, j))
        halves.add_edge(key(i, j), j)
    return halves


def _along(graph: nx.Graph, whole: Layout) -> Layout:
    lines: dict[Node, np.ndarray] = {}
    for i, j in (key(*edge) for edge in graph.edges):
        pieces = [whole.points[i]]
        for one, other in ((i, (i, j)), ((i, j), j)):
            curve = whole.lines.get((one, other))
            pieces += whole.lines[other, one][::-1].tolist() if curve is None else curve.tolist()
            pieces.append(whole.points[other])
        lines[i, j] = np.array(pieces)
    return Layout(whole.points, lines, whole.crossings)


def outward(graph: nx.Graph) -> list[Edge]:
    """The edges, each away from where a picture begins: the end of a chain, a root, or a centre."""
    plain = graph.to_undirected(as_view=True)
    found: list[Edge] = []
    for nodes in nx.connected_components(plain):
        piece = plain.subgraph(sorted(nodes))
        if graph.is_directed():
            found += graph.edges(sorted(nodes))
        elif is_chain(piece):
            found += pairwise(_path(piece))
        else:
            found += _outward(piece, min(nx.center(piece))).edges
    return found


def is_chain(graph: nx.Graph) -> bool:
    """Whether a graph is a chain of one cluster or more, undirected."""
    return (
        not graph.is_directed()
        and nx.is_tree(graph)
        and max(degree for _, degree in graph.degree) <= 2
    )


def _directions(graph: nx.Graph) -> Iterator[nx.DiGraph]:
    """Acyclic directions of the edges: outward from a centre, through it, and from one end."""
    centre = min(nx.center(graph))
    away = _outward(graph, centre)
    yield away
    if nx.is_tree(graph):
        # Half of the tree stands before the centre, half after it.
        branches = [{node, *nx.descendants(away, node)} for node in away.successors(centre)]
        before: set[int] = set()
        for branch in sorted(branches, key=lambda branch: (-len(branch), min(branch))):
            if len(before) + len(branch) <= len(graph) // 2:
                before |= branch
        yield nx.DiGraph((j, i) if j in before else (i, j) for i, j in away.edges)
    else:
        yield _outward(graph, min(nx.periphery(graph)))


def _outward(graph: nx.Graph, start: int) -> nx.DiGraph:
    distance = nx.single_source_shortest_path_length(graph, start)

    def rank(node: int) -> tuple[int, int]:
        return cast(int, distance[node]), node

    return nx.DiGraph((i, j) if rank(i) < rank(j) else (j, i) for i, j in graph.edges)
