"""The layers of a directed acyclic graph, and where nodes stand along them: short, straight arrows.

References
----------
Gansner, Koutsofios, North & Vo, A technique for drawing directed graphs, 1993.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import networkx as nx
import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array

from pgm.kernels.arrays import Array, Integers
from pgm.plot.diagrams.layout import Node

Arrow = tuple[Node, Node]
# What a link's slope costs, by how many of its ends are nodes: long arrows are to be straight.
_WEIGHTS = (8.0, 2.0, 1.0)
_LEAN = 1e-4
_STARTS = 4
_SWEEPS = 8


def least(cost: Array, minus: Integers, limit: Array, end: float | None = None) -> Array:
    """Numbers x in [0, end] that cost least, x_i − x_j − s_k <= limit.

    cost: (n + slacks,): of the numbers, then of the slacks s, which are 0 or more.
    minus: (M, 3): i, j, and the slack that each condition has; −1 for none.
    limit: (M,).
    end: No bound above without.

    Returns (n + slacks,), at a vertex.
    """
    slacks = int(minus[:, 2].max(initial=-1)) + 1
    first = len(cost) - slacks
    row = np.arange(len(minus))
    has = minus[:, 2] >= 0
    rows = np.concatenate([row, row, row[has]])
    columns = np.concatenate([minus[:, 0], minus[:, 1], first + minus[has, 2]])
    signs = np.repeat([1.0, -1.0, -1.0], [len(row), len(row), int(has.sum())])
    less = csr_array((signs, (rows, columns)), shape=(len(minus), len(cost)))
    bounds = [(0.0, end)] * first + [(0.0, None)] * slacks
    found = linprog(cost, A_ub=less, b_ub=limit, bounds=bounds, method="highs-ds")  # type: ignore[call-overload]
    x: Array = found.x
    return x


def ranks(graph: nx.DiGraph, widest: int | None = None) -> dict[Node, int]:
    """The layer of each node: those that make all arrows together as short as can be.

    graph: Connected and acyclic.
    widest: Layers of more nodes overflow into the next.
    """
    if not graph.edges:
        return dict.fromkeys(graph, 0)
    place = {node: k for k, node in enumerate(graph)}
    arrows = np.array([(place[a], place[b], -1) for a, b in graph.edges])
    ends = np.zeros(len(place))
    np.add.at(ends, arrows[:, 1], 1.0)
    np.add.at(ends, arrows[:, 0], -1.0)
    # The programme's matrix is totally unimodular, so the ranks it finds are whole numbers.
    found = np.rint(least(ends, arrows, np.full(len(arrows), -1.0))).astype(int)
    result = dict(zip(place, (found - found.min()).tolist(), strict=True))
    return result if widest is None else _narrowed(graph, result, widest)


def _narrowed(graph: nx.DiGraph, rank: Mapping[Node, int], widest: int) -> dict[Node, int]:
    taken: Counter[int] = Counter()
    result: dict[Node, int] = {}
    for node in sorted(nx.topological_sort(graph), key=rank.__getitem__):
        layer = max([rank[node], *(result[parent] + 1 for parent in graph.predecessors(node))])
        while taken[layer] >= widest:
            layer += 1
        taken[layer] += 1
        result[node] = layer
    return result


@dataclass
class Layers:
    """Nodes in layers, and between them the places where long arrows pass a layer.

    layers: Nodes and places, by number, in the order in which they stand.
    routes: The numbers that each arrow passes, its ends included.
    links: Every piece of an arrow, from one layer to the next.
    """

    layers: list[list[int]]
    nodes: dict[Node, int]
    routes: dict[Arrow, list[int]] = field(default_factory=dict)
    links: list[tuple[int, int]] = field(default_factory=list)


def layers(graph: nx.DiGraph, rank: Mapping[Node, int]) -> Layers:
    """Layers with a place for each arrow in each layer that it passes."""
    result = Layers(
        [[] for _ in range(max(rank.values()) + 1)], {node: k for k, node in enumerate(graph)}
    )
    for node, number in result.nodes.items():
        result.layers[rank[node]].append(number)
    total = len(result.nodes)
    for parent, child in graph.edges:
        between = range(rank[parent] + 1, rank[child])
        passed = list(range(total, total + len(between)))
        total += len(passed)
        for layer, number in zip(between, passed, strict=True):
            result.layers[layer].append(number)
        route = [result.nodes[parent], *passed, result.nodes[child]]
        result.routes[parent, child] = route
        result.links += pairwise(route)
    return result


def along(
    layers: Sequence[Sequence[int]],
    links: Sequence[tuple[int, int]],
    room: Array,
    nodes: int,
) -> Array:
    r"""Places along the layers, which least slope of links asks for.

    .. math:: \min \sum_{ij} w_{ij} |x_i - x_j|
        \quad\text{with}\quad x_j - x_i \ge \tfrac12 (r_i + r_j) \text{ for neighbours in a layer}

    room: (n,): what each takes of its layer.
    nodes: Numbers below are nodes, the others places where an arrow passes.

    Source: Gansner, Koutsofios, North & Vo, A technique for drawing directed graphs, 1993.
    """
    total = len(room)
    beside = [pair for layer in layers for pair in pairwise(layer)]
    minus = [(i, j, k) for k, (i, j) in enumerate(links)]
    minus += [(j, i, k) for i, j, k in minus]
    limit = [0.0] * len(minus) + [-0.5 * (room[i] + room[j]) for i, j in beside]
    minus += [(i, j, -1) for i, j in beside]
    weights = [_WEIGHTS[(i < nodes) + (j < nodes)] for i, j in links]

    def solve(lean: float, end: float | None = None) -> Array:
        cost = np.array([lean] * total + weights)
        return least(cost, np.array(minus, dtype=int).reshape(-1, 3), np.array(limit), end)[:total]

    # Of all the best places, the middle between those furthest left and furthest right.
    left = solve(_LEAN)
    return 0.5 * (left + solve(-_LEAN, float(left.max()) + 1e-6))


def ordered(
    layers: list[list[int]], links: Iterable[tuple[int, int]]
) -> tuple[list[list[int]], int]:
    """Layers with few crossings between each and the next, and how many there are.

    Sweeps down and up put each node at the mean place of its neighbours, then swap neighbours in
    a layer where that helps; from several starts, the best is taken.

    Source: Sugiyama, Tagawa & Toda, Methods for visual understanding of hierarchical systems, 1981.
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
    """Swap neighbours in a layer while that reduces crossings."""
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
