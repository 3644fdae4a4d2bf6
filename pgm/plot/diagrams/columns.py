"""The places of the nodes of an unrolled network, in rows and columns of its slices."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations

import networkx as nx
import numpy as np

from pgm.kernels.arrays import Array, Integers
from pgm.plot.diagrams.canvas import Point
from pgm.plot.diagrams.segments import crossings, distances
from pgm.variables import Variable

# More nodes than this in a row make a slice too wide.
_WIDEST = 4
_SWEEPS = 6
# A node nearer to another's arrow than this many radii is in its way.
_CLEAR = 1.4


def rows(graph: nx.DiGraph) -> list[list[Variable]]:
    """The templates of an unrolled network, top to bottom.

    Parents in the same slice stand above their children. A variable that the next slice depends
    on has its row to itself, so that its arrow in time meets no other node.

    Parameters
    ----------
    graph : networkx.DiGraph
        Nodes are variables at steps.
    """
    carried = {parent.template for parent, child in graph.edges if parent.step != child.step}
    result = []
    for members in _layers(graph, carried):
        result += [[variable] for variable in members if variable in carried]
        rest = [variable for variable in members if variable not in carried]
        count = math.ceil(len(rest) / _WIDEST)
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
    """The edges inside a slice, between templates."""
    within = nx.DiGraph()
    within.add_nodes_from(node.template for node in graph)
    within.add_edges_from((a.template, b.template) for a, b in edges if a.step == b.step)
    return within


def place(graph: nx.DiGraph, radius: float) -> dict[Variable, Point]:
    """Points for the nodes: slices left to right, the rows of each top to bottom, none overlapping.

    Within a row the nodes move sideways, one at a time, to where the arrows of the slice are
    short, cross seldom, and pass over no node.

    Parameters
    ----------
    graph : networkx.DiGraph
        Nodes are variables at steps.
    radius : float
        Of a node.
    """
    lines = rows(graph)
    order = {variable: k for k, variable in enumerate(v for line in lines for v in line)}
    row = np.array([k for k, line in enumerate(lines) for _ in line])
    links = dict.fromkeys(
        (order[a.template], order[b.template], b.step - a.step) for a, b in graph.edges
    )
    across, down = 2.0 * radius + 16.0, 2.0 * radius + 22.0
    columns = max(*(len(line) for line in lines), math.ceil(math.sqrt(len(order))))
    slice_ = _Slice(
        row, down, np.array(list(links), dtype=np.intp).reshape(-1, 3), radius, across, columns
    )
    x = across * np.concatenate([np.arange(len(line)) - 0.5 * (len(line) - 1) for line in lines])
    x = slice_.settle(x)
    # Once more with slices only as far apart as they need to be.
    slice_ = replace(slice_, columns=float(np.ptp(x)) / across + 1.0)
    x = slice_.settle(x - 0.5 * (x.max() + x.min()))
    return {
        node: (
            float(x[order[node.template]] + slice_.width * node.step),
            float(-down * row[order[node.template]]),
        )
        for node in graph
    }


@dataclass(frozen=True)
class _Slice:
    """A slice whose nodes have rows and look for columns.

    Attributes
    ----------
    row : ndarray of int
        (n,).
    down : float
        The distance of rows.
    edges : ndarray of int
        (E, 3): parent, child, and by how many slices the parent is earlier.
    radius, across : float
        Of a node; the least distance of two in a row.
    columns : float
        How many nodes the slice is wide.
    """

    row: Integers
    down: float
    edges: Integers
    radius: float
    across: float
    columns: float

    @property
    def width(self) -> float:
        """The distance of slices."""
        return self.across * self.columns + self.radius + 10.0

    def cost(self, x: Array) -> float:
        """The cost of the columns; 1 is an arrow that goes two columns sideways."""
        y = -self.down * self.row
        parent, child, lag = self.edges.T
        nodes = np.stack([np.concatenate([x, x - self.width]), np.tile(y, 2)], axis=-1)
        begin = parent + lag * len(x)
        start, end = nodes[begin], nodes[child]
        gap = distances(nodes, start, end)
        count = np.arange(len(parent))
        gap[count, child] = gap[count, begin] = np.inf
        in_the_way = np.maximum(0.0, _CLEAR - gap / self.radius).sum()
        near = np.abs(x[:, None] - x) + np.where(self.row[:, None] == self.row, 0.0, np.inf)
        np.fill_diagonal(near, np.inf)
        overlap = np.maximum(0.0, 1.0 - near / self.across).sum()
        sideways = np.abs(end - start)[lag == 0, 0].sum() + 0.1 * np.abs(x).sum()
        return float(
            100.0 * overlap
            + 8.0 * in_the_way
            + crossings(start, end)
            + 0.5 * sideways / self.across
        )

    def settle(self, x: Array) -> Array:
        """Columns that no move of one node, or swap of two in a row, makes better."""
        reach = 0.5 * self.across * (self.columns - 1.0)
        candidates = np.arange(-reach, reach + 1e-6, 0.5 * self.across)
        pairs = [(i, j) for i, j in combinations(range(len(x)), 2) if self.row[i] == self.row[j]]
        best = self.cost(x)
        for _ in range(_SWEEPS):
            before = best
            for k in range(len(x)):
                for candidate in candidates:
                    moved = x.copy()
                    moved[k] = candidate
                    if (found := self.cost(moved)) < best - 1e-9:
                        x, best = moved, found
            for i, j in pairs:
                moved = x.copy()
                moved[[i, j]] = x[[j, i]]
                if (found := self.cost(moved)) < best - 1e-9:
                    x, best = moved, found
            if best == before:
                break
        return x
