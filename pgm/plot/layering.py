"""The layers of a directed acyclic graph, parents in earlier ones, with arrows short.

References
----------
Gansner, Koutsofios, North & Vo, A technique for drawing directed graphs, 1993.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import networkx as nx
import numpy as np

from pgm.plot.layout import Node
from pgm.plot.programme import least

Arrow = tuple[Node, Node]


def ranks(graph: nx.DiGraph, widest: int | None = None) -> dict[Node, int]:
    """The layer of each node: those that make all arrows together as short as can be.

    Parameters
    ----------
    graph : networkx.DiGraph
        Connected and acyclic.
    widest : int, optional
        Layers of more nodes overflow into the next.
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

    Attributes
    ----------
    layers : list of list of int
        Nodes and places, by number, in the order in which they stand.
    nodes : dict of node to int
        The numbers of the graph's nodes.
    routes : dict of (node, node) to list of int
        The numbers that each arrow passes, its ends included.
    links : list of (int, int)
        Every piece of an arrow, from one layer to the next.
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
