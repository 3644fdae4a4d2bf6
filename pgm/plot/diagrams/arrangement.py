"""The places of shapes: of clusters and sepsets, and of the nodes of an unrolled network."""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import cast

import networkx as nx
import numpy as np

from pgm.clustergraph.cluster import Edge
from pgm.kernels.arrays import Array
from pgm.plot.diagrams.canvas import Box, Size
from pgm.plot.diagrams.layered import clear, clipped, in_layers, layered, rooted, rounded
from pgm.plot.diagrams.layout import GAP, PAGE, Layout, Node, best, folded, gaps, packed
from pgm.variables import Variable

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
    """Whether an undirected graph is a chain (a path) of one cluster or more."""
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


# A row of more nodes than this, or than makes a slice about square, goes on in the next.
_WIDEST = 4
_GAP = 24.0
# Between slices, and between arrows that run there.
_BETWEEN, _LANE = 30.0, 5.0
# How far an arrow may bend, as a part of its length; the first that is clear of nodes is taken.
_BENDS = (0.0, 0.12, -0.12, 0.24, -0.24)
Alike = tuple[Variable, Variable, int]


def rows(graph: nx.DiGraph) -> list[list[Variable]]:
    """The templates of an unrolled network, top to bottom.

    Parents in the same slice stand above their children. A variable that the next slice depends
    on has its row to itself, so that its arrow in time meets no other node.
    """
    carried = {parent.template for parent, child in graph.edges if parent.step != child.step}
    result = []
    for members in _row_layers(graph, carried):
        result += [[variable] for variable in members if variable in carried]
        rest = [variable for variable in members if variable not in carried]
        count = math.ceil(len(rest) / max(_WIDEST, math.ceil(math.sqrt(2 * len(rest)))))
        result += [rest[k::count] for k in range(count)]
    return result


def _row_layers(graph: nx.DiGraph, carried: set[Variable]) -> list[list[Variable]]:
    within = _slice(graph, graph.edges)
    if not nx.is_directed_acyclic_graph(within):
        # The prior may order the states otherwise than the transition, which is then followed.
        last = max(node.step for node in graph)
        within = _slice(graph, [edge for edge in graph.edges if edge[1].step == last])
    generations = list(nx.topological_generations(within))
    layer = {node: depth for depth, nodes in enumerate(generations) for node in nodes}
    for node in within:
        if within.in_degree(node) and not within.out_degree(node) and node not in carried:
            layer[node] = len(generations) - 1  # sensors together, at the bottom
    for node in within:
        if not within.in_degree(node) and within.out_degree(node):
            # Roots just above their first child, like the landmark above its sighting.
            layer[node] = min(layer[child] for child in within.successors(node)) - 1
    layers: list[list[Variable]] = [[] for _ in generations]
    for node in within:
        layers[layer[node]].append(node)
    return [members for members in layers if members]


def _slice(graph: nx.DiGraph, edges: Iterable[tuple[Variable, Variable]]) -> nx.DiGraph:
    within = nx.DiGraph()
    within.add_nodes_from(node.template for node in graph)
    within.add_edges_from((a.template, b.template) for a, b in edges if a.step == b.step)
    return within


def sliced(graph: nx.DiGraph, sizes: Mapping[Node, Size], room: Size | None) -> Layout:
    """Slices left to right, each in the same rows, folded where they are too many for one line.

    Within a slice few arrows cross, and none runs over a node. An arrow from slice to slice is
    straight or a bow if that is clear of nodes in all slices; else it runs between rows and
    slices.

    sizes: Equal at all steps of a variable.
    room: Of the axes; None for a page.
    """
    lines = rows(graph)
    rank: dict[Node, int] = {variable: k for k, line in enumerate(lines) for variable in line}
    own: dict[Node, Size] = {node.template: sizes[node] for node in graph}
    within = nx.DiGraph()
    within.add_nodes_from(rank)
    alike: dict[Alike, list[tuple[Variable, Variable]]] = defaultdict(list)
    for parent, child in graph.edges:
        pair = parent.template, child.template
        if parent.step == child.step and rank[pair[0]] < rank[pair[1]]:
            within.add_edge(*pair)
        else:
            alike[*pair, child.step - parent.step].append((parent, child))
    one = in_layers(within, rank, own, gap=_GAP)
    frame = one.box(own)
    lanes = _LANE * len(alike)
    pitch = frame.right - frame.left + max(_BETWEEN, lanes + 2.0 * _LANE)

    whole = Layout()
    for node in graph:
        x, y = one.points[node.template]
        whole.points[node] = (x + pitch * node.step, y)
    for parent, child in graph.edges:
        pair = parent.template, child.template
        if parent.step == child.step and pair in one.lines:
            whole.lines[parent, child] = one.lines[pair] + (pitch * parent.step, 0.0)
    outer = whole.box(sizes)
    at = np.array([whole.points[node] for node in graph])
    half = 0.5 * np.array([sizes[node] for node in graph])
    place = {node: k for k, node in enumerate(graph)}
    reach = [0.5 * max(own[variable].height for variable in line) for line in lines]
    for lane, ((parent, child, _), arrows) in enumerate(alike.items()):
        pairs = [(place[a], place[b]) for a, b in arrows]
        curves = _bowed(pairs, at, half, outer)
        if curves is None:
            beside = frame.right + _LANE * (lane + 1.0)
            down = one.points[parent][1] - reach[rank[parent]] - 0.5 * _GAP
            up = one.points[child][1] + reach[rank[child]] + 0.5 * _GAP
            curves = [
                _around(at[i], at[j], down, beside + pitch * (before.step or 0), up)
                for (i, j), (before, _) in zip(pairs, arrows, strict=True)
            ]
        for pair, arrow, curve in zip(pairs, arrows, curves, strict=True):
            whole.lines[arrow] = clipped(curve, at[list(pair)], half[list(pair)])
    first = min(node.step for node in graph)
    last = max(node.step for node in graph)
    cuts = [frame.right + lanes + _LANE + pitch * step for step in range(first, last)]
    return folded(whole, sizes, cuts, room)


def _bowed(
    pairs: Sequence[tuple[int, int]], at: Array, half: Array, box: Box
) -> list[Array] | None:
    """Arrows of the least bend with which all are clear of nodes, and inside the picture."""
    for bend in _BENDS:
        curves = [_bow(at[i], at[j], bend) for i, j in pairs]
        if all(
            clear(curve, at, half, pair) and _inside(curve, box)
            for curve, pair in zip(curves, pairs, strict=True)
        ):
            return curves
    return None


def _bow(start: Array, end: Array, bend: float) -> Array:
    along = end - start
    middle = 0.5 * (start + end) + bend * np.array([along[1], -along[0]])
    t = np.linspace(0.0, 1.0, 60)[:, None]
    curve: Array = (1.0 - t) ** 2 * start + 2.0 * t * (1.0 - t) * middle + t * t * end
    return curve


def _inside(curve: Array, box: Box) -> bool:
    low, high = curve.min(axis=0), curve.max(axis=0)
    return bool((low >= (box.left, box.bottom)).all() and (high <= (box.right, box.top)).all())


def _around(start: Array, end: Array, down: float, beside: float, up: float) -> Array:
    """A line from below a node, between two rows past its slice, and in from above."""
    corners = [(start[0], down), (beside, down), (beside, up), (end[0], up)]
    return rounded(np.array([start, *corners, end]))
