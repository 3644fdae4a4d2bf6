"""The places of the nodes of an unrolled network, in slices alike, and the course of its arrows."""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

import networkx as nx
import numpy as np

from pgm.kernels.arrays import Array
from pgm.plot.diagrams.canvas import Box, Size
from pgm.plot.diagrams.layered import clear, clipped, in_layers, rounded
from pgm.plot.diagrams.layout import Layout, Node, folded
from pgm.variables import Variable

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
    for members in _layers(graph, carried):
        result += [[variable] for variable in members if variable in carried]
        rest = [variable for variable in members if variable not in carried]
        count = math.ceil(len(rest) / max(_WIDEST, math.ceil(math.sqrt(2 * len(rest)))))
        result += [rest[k::count] for k in range(count)]
    return result


def _layers(graph: nx.DiGraph, carried: set[Variable]) -> list[list[Variable]]:
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
    """From below a node, between two rows, past all of its slice, and in again from above."""
    corners = [(start[0], down), (beside, down), (beside, up), (end[0], up)]
    return rounded(np.array([start, *corners, end]))
