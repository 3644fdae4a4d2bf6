"""The rows of a network's slice: topological layers, and states in rows of their own."""

from __future__ import annotations

import math
from collections.abc import Iterable

import networkx as nx

from pgm.variables import Variable

# More nodes than this in a row make a slice too wide.
_WIDEST = 4


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
