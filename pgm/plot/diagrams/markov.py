"""Markov networks: undirected, two variables joined where a factor is of both."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import Any

import networkx as nx
from matplotlib.axes import Axes

from pgm.boundary import as_tuple, is_unordered
from pgm.errors import ModelError
from pgm.kernels.arrays import Array
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.plot.diagrams.canvas import Canvas
from pgm.plot.diagrams.networks import Edge, directed, draw_graph, in_slices, named
from pgm.variables import Variable

_DASHES = (0.0, (4.0, 3.0))


def markov_network(
    model: BayesianNetwork | DynamicBayesianNetwork | Iterable[Any],
    *,
    steps: int | None = None,
    evidence: Iterable[Variable] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw a Markov network: undirected, two variables joined where some factor is of both.

    That of a Bayesian network is its moral graph, for each CPD is a factor of a child and its
    parents: arrows lose their heads, and the parents of a child are joined. Joins that no arrow
    lies behind are dashed. Variables that the edges separate are independent given those between.

    Parameters
    ----------
    model : BayesianNetwork, DynamicBayesianNetwork or iterable
        A network, or factors: anything with a ``scope``, like `pgm.CanonicalForm`, `pgm.Table`, a
        CPD or a cluster of a graph, or collections of variables that stand for scopes.
    steps : int, optional
        The last slice of a dynamic network drawn; 1 without, which is the whole pattern.
    evidence : iterable or mapping of Variable, optional
        What is observed, and shaded, as by `pgm.plot.network`.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, as large as it needs, without.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError
        If `model` is neither a network nor of factors, or `steps` is no step.
    EvidenceError
        If the evidence names what is no variable of it.

    Examples
    --------
    >>> a, b, c, d = pgm.variables("a b c d")
    >>> ax = pgm.plot.markov_network([(a, b), (b, c), (c, d), (d, a)])
    >>> sorted(text.get_text() for text in ax.texts)
    ['a', 'b', 'c', 'd']

    References
    ----------
    Koller & Friedman, Probabilistic Graphical Models, 2009, sections 4.2 and 4.5.
    """
    if isinstance(model, BayesianNetwork | DynamicBayesianNetwork):
        graph = directed(model, steps, evidence)
        slices = isinstance(model, DynamicBayesianNetwork) or in_slices(graph)
        _marry(graph)
    else:
        graph, slices = _joined(model, steps, evidence), False

    def line(canvas: Canvas, edge: Edge, curve: Array) -> None:
        canvas.line(curve, _DASHES if graph.edges[edge].get("married") else "-")

    return draw_graph(graph, {}, ax, slices, line, fold=False)


def _marry(graph: nx.DiGraph) -> None:
    order = {node: place for place, node in enumerate(nx.topological_sort(graph))}
    for child in list(graph):
        parents = sorted(graph.predecessors(child), key=order.__getitem__)
        for one, other in combinations(parents, 2):
            if not graph.has_edge(one, other):
                graph.add_edge(one, other, married=True)


def _joined(model: Any, steps: int | None, evidence: Iterable[Variable] | None) -> nx.DiGraph:
    scopes = list(_scopes(model))
    if steps is not None:
        raise ModelError("steps cut a DynamicBayesianNetwork; leave them out")
    plain = nx.Graph()
    for scope in scopes:
        plain.add_nodes_from(scope)
        plain.add_edges_from(combinations(scope, 2))
    observed = named(evidence or (), plain)
    graph = nx.DiGraph()
    graph.add_nodes_from((node, {"observed": node in observed}) for node in plain)
    place = {node: k for k, node in enumerate(plain)}
    for part in list(nx.connected_components(plain)):
        centre = min(nx.center(plain.subgraph(part)), key=place.__getitem__)
        away = nx.single_source_shortest_path_length(plain, centre)
        rank = {node: (distance, place[node]) for node, distance in away.items()}
        for one, other in plain.subgraph(part).edges:
            graph.add_edge(*sorted((one, other), key=rank.__getitem__))
    return graph


def _scopes(model: Any) -> Iterator[tuple[Variable, ...]]:
    found = as_tuple(model)
    if not found:
        raise ModelError(
            "markov_network draws a network, or a list of factors or of collections of variables; "
            f"found {'an empty one' if found == () else type(model).__name__}"
        )
    for number, factor in enumerate(found):
        members = getattr(factor, "scope", factor)
        scope = as_tuple(members)
        if isinstance(factor, Variable) or scope is None:
            raise ModelError(
                f"item {number} of the factors, {factor!r}, has no scope; give factors, or "
                "collections of variables such as (a, b)"
            )
        for variable in scope:
            if not isinstance(variable, Variable):
                raise ModelError(f"item {number} of the factors holds {variable!r}, no variable")
        yield tuple(sorted(scope, key=repr)) if is_unordered(members) else scope
