"""Networks, directed or Markov's, in layers, and where there is time, unrolled."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import combinations
from typing import Any

import networkx as nx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from matplotlib.path import Path

from pgm.arguments import public
from pgm.boundary import as_tuple, is_unordered, is_whole
from pgm.errors import EvidenceError, ModelError, PgmError
from pgm.factors.scope import unknown_name
from pgm.kernels.arrays import Array
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork, MarkovNetwork
from pgm.networks.markov import written
from pgm.plot.diagrams.arrangement import sliced
from pgm.plot.diagrams.canvas import Canvas, Size, node_label, open_canvas, room, slack, text_size
from pgm.plot.diagrams.layered import layered
from pgm.plot.drawing.colours import INK, OBSERVED
from pgm.variables import Variable

Edge = tuple[Variable, Variable]

_SMALLEST = 15.0
_FILL = {True: OBSERVED, False: "white"}


@public
def network(
    model: Network,
    *,
    steps: int | None = None,
    evidence: Iterable[Variable] | None = None,
    cpds: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw a network: parents above their children, observed variables shaded.

    A `MarkovNetwork` is drawn undirected, as by `markov_network`.

    A dynamic network is unrolled, with slices left to right; so is a static one whose variables
    all stand at steps, like what unrolling gives. Any other static network stands in topological
    layers, from top to bottom or, where that makes better use of the axes, from left to right.

    Parameters
    ----------
    model : BayesianNetwork, DynamicBayesianNetwork or MarkovNetwork
    steps : int, optional
        The last slice of a dynamic network drawn; 1 without, which is the whole pattern.
    evidence : iterable or mapping of Variable, optional
        What is observed beside the inputs, a template standing for all its steps. Without, the
        sensors of a dynamic network, and nothing of a static one.
    cpds : bool
        Whether to write its density, like ``p(x[1] | x[0], u[1])``, below the name of each node
        that has a CPD.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, as large as it needs, without.

    Raises
    ------
    ModelError
        If `model` is no network, or `steps` is no step.
    EvidenceError
        If the evidence names what is no variable of the network.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> ax = pgm.plot.network(pair, evidence=[b])
    >>> sorted(text.get_text() for text in ax.texts)
    ['a', 'b']
    """
    if not isinstance(model, Network):
        raise ModelError(
            "network draws a DynamicBayesianNetwork, BayesianNetwork or MarkovNetwork, not "
            f"{type(model).__name__}"
        )
    if not isinstance(model, Directed):
        if cpds:
            raise ModelError("cpds are those of a directed network; leave them out")
        return markov_network(model, steps=steps, evidence=evidence, ax=ax)
    graph = directed(model, steps, evidence)
    slices = isinstance(model, DynamicBayesianNetwork) or in_slices(graph)
    texts = densities(model, graph) if cpds else {}
    return draw_graph(graph, texts, ax, slices, _arrow)


def draw_graph(
    graph: nx.DiGraph,
    below: dict[Variable, str],
    ax: Axes | None,
    slices: bool,
    join: Callable[[Canvas, Any, Array], None],
    *,
    fold: bool = True,
) -> Axes:
    """Draw circles, or ellipses as wide as their names and as the texts below some of these.

    graph: Nodes have the attribute ``observed``.
    slices: Whether to place the nodes in slices, else in layers.
    join: Draws an edge along a curve (P, 2).
    fold: Whether layers that would run far to the right may be folded.
    """
    labels = {node: "\n".join(filter(None, (node_label(node), below.get(node)))) for node in graph}
    texts = {node: text_size(label) for node, label in labels.items()}
    if slices and not below:
        # Circles of one size, the smallest about all names.
        across = max(2.0 * _SMALLEST, *(float(np.hypot(*size)) + 6.0 for size in texts.values()))
        sizes = dict.fromkeys(graph, Size(across, across))
    else:
        high = max(2.0 * _SMALLEST, *(1.3 * size.height + 6.0 for size in texts.values()))
        sizes = {node: Size(max(high, _width(size, high)), high) for node, size in texts.items()}
        if slices:
            sizes = _alike(sizes)
    page = room(ax)
    layout = sliced(graph, sizes, page) if slices else layered(graph, sizes, page, fold=fold)
    letters = slack(list(texts.values()), list(sizes.values()))
    canvas = open_canvas(ax, layout.box(sizes), letters)
    for node, at in layout.points.items():
        canvas.shape(Ellipse(at, *sizes[node]), _FILL[graph.nodes[node]["observed"]], 1.0)
        canvas.text(at, labels[node])
    for edge, curve in layout.lines.items():
        join(canvas, edge, curve)
    for curve in layout.loose:
        canvas.line(curve, colour=INK, width=0.9)
    return canvas.ax


def _arrow(canvas: Canvas, edge: Edge, curve: Array) -> None:
    canvas.arrow(path=Path(curve))


def _width(text: Size, height: float) -> float:
    return text.width / float(np.sqrt(1.0 - (text.height / height) ** 2)) + 6.0


def _alike(sizes: Mapping[Variable, Size]) -> dict[Variable, Size]:
    wide: dict[Variable, float] = defaultdict(float)
    for node, size in sizes.items():
        wide[node.template] = max(wide[node.template], size.width)
    return {node: Size(wide[node.template], size.height) for node, size in sizes.items()}


def densities(model: Directed, nodes: Iterable[Variable]) -> dict[Variable, str]:
    """The density of each node that has a CPD."""
    if isinstance(model, DynamicBayesianNetwork):
        model = model.unroll(max(node.step or 0 for node in nodes))
    return {cpd.child: written(cpd) for cpd in model.cpds}


Directed = BayesianNetwork | DynamicBayesianNetwork
Network = MarkovNetwork | DynamicBayesianNetwork


def directed(model: Directed, steps: int | None, evidence: Iterable[Variable] | None) -> nx.DiGraph:
    """Parents and children as nodes; each has the attribute ``observed``.

    steps: The last slice of a dynamic network; 1 without.
    evidence: What is observed beside the inputs, a template standing for all its steps; without,
        the sensors of a dynamic network.
    """
    if isinstance(model, BayesianNetwork):
        if steps is not None:
            raise ModelError("steps cut a DynamicBayesianNetwork; leave them out")
        graph = model.to_networkx()
        sensors: tuple[Variable, ...] = ()
    else:
        graph = model.to_networkx(1 if steps is None else last(steps, "slice", ModelError))
        sensors = model.sensors
    known = set(graph) | {node.template for node in graph} | set(model.variables)
    observed = {*model.inputs, *(sensors if evidence is None else named(evidence, known))}
    for node in graph:
        graph.nodes[node]["observed"] = node in observed or node.template in observed
    return graph


def named(evidence: Iterable[Variable], known: Iterable[Variable]) -> frozenset[Variable]:
    """The variables that evidence names, each one of those known."""
    found = (evidence,) if isinstance(evidence, Variable) else tuple(evidence)
    known = set(known)
    for variable in found:
        if variable not in known:
            raise EvidenceError(
                f"evidence names {variable!r}, {unknown_name(variable, known)}",
                variable=variable if isinstance(variable, Variable) else None,
            )
    return frozenset(found)


def in_slices(graph: nx.DiGraph) -> bool:
    """Whether the nodes are at two steps or more, with parents at their own or the one before."""
    steps = {node.step for node in graph}
    return (
        len(steps) > 1
        and None not in steps
        and all(child.step - parent.step in (0, 1) for parent, child in graph.edges)
    )


def last(steps: int, what: str, error: type[PgmError]) -> int:
    """Check the last slice or cluster to draw."""
    if not is_whole(steps) or steps < 0:
        raise error(f"steps must be the last {what} to draw, 0 or more, not {steps!r}")
    return int(steps)


_DASHES = (0.0, (4.0, 3.0))


@public
def markov_network(
    model: Network | Iterable[Any],
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
    model : BayesianNetwork, DynamicBayesianNetwork, MarkovNetwork or iterable
        A network, or factors: anything with a ``scope``, like `pgm.CanonicalForm`, `pgm.Table`, a
        CPD or a cluster of a graph, or collections of variables that stand for scopes.
    steps : int, optional
        The last slice of a dynamic network drawn; 1 without, which is the whole pattern.
    evidence : iterable or mapping of Variable, optional
        What is observed, and shaded, as by `pgm.plot.network`.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, as large as it needs, without.

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
    if isinstance(model, Directed):
        graph = directed(model, steps, evidence)
        slices = isinstance(model, DynamicBayesianNetwork) or in_slices(graph)
        _marry(graph)
    else:
        factors = model.factors if isinstance(model, MarkovNetwork) else model
        graph, slices = joined(factors, steps, evidence), False

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


def joined(model: Any, steps: int | None, evidence: Iterable[Variable] | None) -> nx.DiGraph:
    """The variables of factors, those that one has in common joined, with ``observed``."""
    scopes = list(_scopes(model))
    if steps is not None:
        raise ModelError("steps cut a DynamicBayesianNetwork; leave them out")
    plain = nx.Graph()
    for scope in scopes:
        plain.add_nodes_from(scope)
        plain.add_edges_from(combinations(scope, 2))
    observed = named(evidence or (), plain)
    graph = from_the_middle(plain)
    for node in graph:
        graph.nodes[node]["observed"] = node in observed
    return graph


def from_the_middle(plain: nx.Graph) -> nx.DiGraph:
    """An undirected graph with each edge pointing away from the middle of its part."""
    graph = nx.DiGraph()
    graph.add_nodes_from(plain)
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
