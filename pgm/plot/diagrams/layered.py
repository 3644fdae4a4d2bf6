"""The places of the nodes of a directed acyclic graph, in layers, and the lines of its arrows."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import networkx as nx
import numpy as np

from pgm.kernels.arrays import Array
from pgm.plot.diagrams.canvas import Size
from pgm.plot.diagrams.layering import Layers, along, layers, ordered, ranks
from pgm.plot.diagrams.layout import GAP, Layout, Node, best, folded, gaps, packed

# Between layers that shallow lines join there is more room, up to this.
_STEEPNESS = 0.14
_WIDEST_GAP = 72.0
# The width in a layer of a line that passes it.
_LANE = 9.0
# A layout other than the plain one must be better by this factor to be taken.
_BETTER = 1.15


def layered(
    graph: nx.DiGraph,
    sizes: Mapping[Node, Size],
    room: Size | None,
    *,
    gap: float = 24.0,
    fold: bool = False,
) -> Layout:
    """Layers from top to bottom, or from left to right where that makes better use of the room.

    Few arrows cross, and none runs over a node. Layers too wide for the room are broken.

    graph: Acyclic.
    room: Of the axes; None for a page.
    gap: Between layers, in points, where no line is shallow.
    fold: Whether layers that would run far to the right may be folded.
    """
    pieces = []
    for nodes in nx.weakly_connected_components(graph):
        # A subgraph of NetworkX has the order of a set, which changes from run to run.
        piece = nx.DiGraph()
        piece.add_nodes_from(node for node in graph if node in nodes)
        piece.add_edges_from(graph.edges(piece))
        pieces.append(piece)
    root = math.ceil(math.sqrt(len(graph)))
    layouts = []
    tried = []
    for widest in (None, 2 * root, root + 1):
        found = [ranks(piece, widest) for piece in pieces]
        if found in tried:
            continue
        tried.append(found)
        choices = [_order(piece, rank) for piece, rank in zip(pieces, found, strict=True)]
        for across in (False, True):
            parts = [_place(*one, sizes, gap, across) for one in choices]
            if fold and across and len(parts) == 1:
                parts = [folded(parts[0], sizes, gaps(parts[0], sizes), room)]
            layouts.append(packed(parts, sizes, room))
    return best(layouts, sizes, room, _BETTER)


def rooted(
    graph: nx.DiGraph, sizes: Mapping[Node, Size], room: Size | None, *, gap: float = 24.0
) -> Layout:
    """A tree in levels below its root, or to the right of it, children in the order given.

    graph: A tree from parents to children, its nodes in depth-first order.
    sizes, room, gap: As of `layered`.
    """
    depth: dict[Node, int] = {}
    for node in graph:
        depth[node] = max((depth[parent] + 1 for parent in graph.predecessors(node)), default=0)
    parts = layers(graph, depth)
    layouts = (_place(parts, 0, sizes, gap, across) for across in (False, True))
    return best(layouts, sizes, room, _BETTER)


def in_layers(
    graph: nx.DiGraph, rank: Mapping[Node, int], sizes: Mapping[Node, Size], *, gap: float
) -> Layout:
    """A layout by given layers from top to bottom, with few crossings of arrows."""
    return _place(*_order(graph, rank), sizes, gap, False)


def _order(graph: nx.DiGraph, rank: Mapping[Node, int]) -> tuple[Layers, int]:
    parts = layers(graph, rank)
    order, crossings = ordered(parts.layers, parts.links)
    return replace(parts, layers=order), crossings


def _place(
    parts: Layers, crossings: int, sizes: Mapping[Node, Size], gap: float, across: bool
) -> Layout:
    """The layout of nodes and arrows whose layers, and order within them, are decided.

    Layers follow each other downwards or, if `across`, to the right. Within a layer nodes stand as
    near to the nodes they are joined to as their widths allow; between two layers there are `gap`
    points or, where arrows would be shallow, up to 72. `crossings` is the number of crossings of
    arrows, `sizes` has the width and height of each node, in points.
    """
    order = parts.layers
    count, total = len(parts.nodes), sum(map(len, order))
    half = np.zeros((total, 2))
    half[:count] = 0.5 * np.array([sizes[node] for node in parts.nodes])
    if across:
        half = half[:, ::-1]
    at = np.zeros((total, 2))
    apart = np.where(np.arange(total) < count, GAP, _LANE)
    at[:, 0] = along(order, parts.links, 2.0 * half[:, 0] + apart, count)

    band = np.zeros(total)
    level = -gap
    sideways: dict[int, float] = {}
    for i, j in parts.links:
        sideways[j] = max(sideways.get(j, 0.0), abs(at[i, 0] - at[j, 0]))
    for layer in order:
        band[layer] = half[layer, 1].max()
        shallow = max(sideways.get(number, 0.0) for number in layer)
        level += min(max(gap, _STEEPNESS * shallow), _WIDEST_GAP) + band[layer[0]]
        at[layer, 1] = level
        level += band[layer[0]]

    def turned(points: Array) -> Array:
        return points[..., ::-1] * (1.0, -1.0) if across else points * (1.0, -1.0)

    curves = lines(list(parts.routes.values()), count, at, half, band)
    points = ((float(x), float(y)) for x, y in turned(at[:count]))
    return Layout(
        dict(zip(parts.nodes, points, strict=True)),
        {arrow: turned(curve) for arrow, curve in zip(parts.routes, curves, strict=True)},
        crossings,
    )


# How near a line may come to a node, in points, and how far from its places in other layers.
_CLEAR = 4.5
_STRAY = 12.0
_STEP = 3.0
# How far from the middle of a node's border a bent line may leave it, as a part of its half-axis.
_PORT = 0.7
_MANY = 8
# How far from a corner a rounded line leaves its straight pieces.
_CORNER = 7.0


def lines(
    routes: Sequence[Sequence[int]], nodes: int, at: Array, half: Array, band: Array
) -> list[Array]:
    """The lines (P, 2) of arrows, from border to border, none of which runs over a node.

    An arrow is straight if that is clear and passes the layers near its places there; else it
    leaves a layer and enters the next square to them, so that it keeps to the gaps between. At
    a node with many arrows all are bent if one is: they then do not cross.

    routes: The numbers of parent, places, and child of each.
    nodes: Numbers below are nodes.
    at, half: (n, 2): centres and half-axes, along the layers and down.
    band: (n,): half the depth of the layer of each.
    """
    straight = [_straight(route, at[:nodes], half[:nodes], at) for route in routes]
    count = Counter(end for route in routes for end in (route[0], route[-1]))
    bent = {
        end
        for route, curve in zip(routes, straight, strict=True)
        for end in (route[0], route[-1])
        if curve is None and count[end] > _MANY
    }
    result = []
    for route, curve in zip(routes, straight, strict=True):
        ends = [route[0], route[-1]]
        if curve is None or not bent.isdisjoint(ends):
            curve = _bent(route, at, half, band)
        result.append(clipped(curve, at[ends], half[ends]))
    return result


def _straight(route: Sequence[int], nodes: Array, half: Array, at: Array) -> Array | None:
    start, end = route[0], route[-1]
    whole = at[end] - at[start]
    part = (at[list(route), 1] - at[start, 1]) / whole[1]
    if np.abs(at[list(route), 0] - at[start, 0] - part * whole[0]).max() > _STRAY:
        return None
    t = np.linspace(0.0, 1.0, 3 + int(np.linalg.norm(whole) / _STEP))[:, None]
    curve: Array = at[start] + t * whole
    return curve if clear(curve, nodes, half, (start, end)) else None


def clear(curve: Array, at: Array, half: Array, ends: tuple[int, int]) -> bool:
    """Whether a line (P, 2) keeps its distance from all nodes (n, 2) but its ends."""
    reach = half + _CLEAR
    near = ((at + reach > curve.min(axis=0)) & (at - reach < curve.max(axis=0))).all(axis=-1)
    near[list(ends)] = False
    # The third power bulges towards the corners, since some nodes are rectangles.
    offset = (curve[:, None] - at[near]) / reach[near]
    return bool(((np.abs(offset) ** 3).sum(axis=-1) > 1.0).all())


def rounded(corners: Array) -> Array:
    """A line (P, 2) along straight pieces, its corners rounded."""
    pieces = [corners[:1]]
    t = np.linspace(0.0, 1.0, 6)[:, None]
    for before, here, after in zip(corners, corners[1:], corners[2:], strict=False):
        legs = np.array([before, after]) - here
        lengths = np.linalg.norm(legs, axis=-1, keepdims=True)
        start, end = here + legs * np.minimum(_CORNER / np.maximum(lengths, 1e-9), 0.5)
        pieces.append((1.0 - t) ** 2 * start + 2.0 * t * (1.0 - t) * here + t * t * end)
    return np.concatenate([*pieces, corners[-1:]])


def _bent(route: Sequence[int], at: Array, half: Array, band: Array) -> Array:
    """Square to the layers inside them, and Bézier's cubic from one to the next."""
    pieces: list[Array] = []
    for i, j in pairwise(route):
        begin = at[i] + _exit(at[j, 0] - at[i, 0], half[i])
        end = at[j] + _exit(at[i, 0] - at[j, 0], half[j]) * (1.0, -1.0)
        leave, enter = np.array([begin[0], at[i, 1] + band[i]]), [end[0], at[j, 1] - band[j]]
        t = np.linspace(0.0, 1.0, 3 + int(np.abs(enter - leave).sum() / _STEP))
        ease = np.stack([t * t * (3.0 - 2.0 * t), 1.5 * t * (1.0 - t) + t**3], axis=-1)
        pieces += [begin[None], leave + ease * (enter - leave), end[None]]
    return np.concatenate(pieces)


def _exit(sideways: float, half: Array) -> Array:
    """From the centre of a node, or of a place in a layer, to its border below, a bit sideways."""
    if not half[1]:
        return half
    x = float(np.clip(0.15 * sideways, -_PORT * half[0], _PORT * half[0]))
    return np.array([x, half[1] * np.sqrt(1.0 - (x / half[0]) ** 2)])


def clipped(curve: Array, at: Array, half: Array) -> Array:
    """The part of a line (P, 2) between two ellipses, (2, 2) each, from border to border."""
    for centre, axes in zip(at, half, strict=True):
        scaled = (curve - centre) / axes
        outside = np.flatnonzero((scaled * scaled).sum(axis=-1) > 1.0 + 1e-9)
        if outside.size and outside[0] > 0:
            k = int(outside[0])
            a, b = scaled[k - 1], scaled[k] - scaled[k - 1]
            # |a + t b| = 1 on the piece that leaves.
            aa, ab, bb = a @ a - 1.0, a @ b, b @ b
            t = (-ab + np.sqrt(max(ab * ab - aa * bb, 0.0))) / bb
            border = curve[k - 1] + np.clip(t, 0.0, 1.0) * (curve[k] - curve[k - 1])
            curve = np.concatenate([border[None], curve[k:]])
        curve = curve[::-1]
    return curve
