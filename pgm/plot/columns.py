"""Where the nodes of an unrolled network stand."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations

import networkx as nx
import numpy as np

from pgm.kernels.arrays import Array, Integers
from pgm.plot.canvas import Point
from pgm.plot.layers import rows
from pgm.plot.segments import crossings, distances
from pgm.variables import Variable

_SWEEPS = 6
# A node nearer to another's arrow than this many radii is in its way.
_CLEAR = 1.4


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
