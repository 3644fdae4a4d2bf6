"""The places of the nodes of a directed acyclic graph: in layers, parents before children."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import networkx as nx
import numpy as np

from pgm.kernels.arrays import Array
from pgm.plot.diagrams.canvas import Size
from pgm.plot.diagrams.curves import lines
from pgm.plot.diagrams.folding import folded, gaps
from pgm.plot.diagrams.layering import Layers, along, layers, ordered, ranks
from pgm.plot.diagrams.layout import GAP, Layout, Node, best, packed

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

    Parameters
    ----------
    graph : networkx.DiGraph
        Acyclic.
    sizes : mapping of node to Size
    room : Size or None
        Of the axes; None for a page.
    gap : float
        Between layers, in points, where no line is shallow.
    fold : bool
        Whether layers that would run far to the right may be folded.
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

    Parameters
    ----------
    graph : networkx.DiGraph
        A tree from parents to children, its nodes in depth-first order.
    sizes, room, gap
        As of `layered`.
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
    """The layers that are given, from top to bottom; few arrows cross."""
    return _place(*_order(graph, rank), sizes, gap, False)


def _order(graph: nx.DiGraph, rank: Mapping[Node, int]) -> tuple[Layers, int]:
    """Its layers in the order that makes few arrows cross, and how many do."""
    parts = layers(graph, rank)
    order, crossings = ordered(parts.layers, parts.links)
    return replace(parts, layers=order), crossings


def _place(
    parts: Layers, crossings: int, sizes: Mapping[Node, Size], gap: float, across: bool
) -> Layout:
    """Layers downwards or, if `across`, to the right."""
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
