"""The clusters and sepsets that a picture shows, and their texts."""

from collections.abc import Iterable, Sequence

import networkx as nx
import numpy as np

from pgm.boundary import is_whole
from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.cluster import Edge, amount, is_discrete, size
from pgm.compile import BalancedGraph, DynamicGraph
from pgm.errors import EvidenceError, GraphError
from pgm.evidence import Evidence, bind
from pgm.factors.scope import Scope
from pgm.plot.diagrams.canvas import cluster_label, scope_label
from pgm.plot.diagrams.layout import Node
from pgm.plot.diagrams.networks import last
from pgm.variables import Variable

# How many variables a cluster names, in graphs of up to so many clusters.
_NAMED = ((12, 16), (30, 9), (np.inf, 6))


def shown(
    graph: ClusterGraph,
    steps: int | None,
    around: int | None = None,
    within: int = 2,
    most: int | None = None,
) -> list[Cluster]:
    """The clusters 0..steps, or those near one, or all; an error where they are too many."""
    if not isinstance(graph, ClusterGraph):
        raise GraphError(f"cluster_graph draws a compiled graph, not {type(graph).__name__}")
    found: Sequence[int] = range(len(graph.clusters))
    if not found:
        raise GraphError("the graph has no clusters to draw")
    if steps is not None:
        end = last(steps, "cluster", GraphError)
        found = graph.within(end) if isinstance(graph, DynamicGraph) else found[: end + 1]
    if around is not None:
        found = _near(graph, around, within, found)
    if most is not None and len(found) > most:
        raise GraphError(
            f"{len(found)} clusters are too many to read; draw {most} at most, as with steps=4 or "
            "around=10"
        )
    return [graph.clusters[index] for index in found]


def _near(graph: ClusterGraph, around: int, within: int, among: Sequence[int]) -> list[int]:
    """The clusters, among some, that so many edges or fewer lead to from one."""
    allowed = set(among)
    if not is_whole(around) or around not in allowed:
        raise GraphError(f"around={around!r} is no cluster; they are 0 to {max(among)}")
    if not is_whole(within) or within < 0:
        raise GraphError(f"within is a number of edges, 0 or more, not {within!r}")
    found = border = {int(around)}
    for _ in range(within):
        border = {j for i in border for j in graph.neighbours(i) if j in allowed} - found
        found = found | border
    return sorted(found)


def joined(graph: ClusterGraph, clusters: Sequence[Cluster]) -> tuple[dict[Edge, Scope], list[int]]:
    """The sepsets between some clusters, and which of them have neighbours among the others."""
    drawn = {cluster.index for cluster in clusters}
    sepsets: dict[Edge, Scope] = {}
    cut: list[int] = []
    for i in sorted(drawn):
        for j in graph.neighbours(i):
            if j not in drawn:
                cut.append(i)
            elif i < j:
                sepsets[i, j] = graph.sepsets[i, j]
    return sepsets, cut


def links(graph: ClusterGraph, clusters: Sequence[Cluster], edges: Iterable[Edge]) -> nx.Graph:
    """The edges; in a balanced tree from each cluster to its children, in their order."""
    drawn = [cluster.index for cluster in clusters]
    found = nx.Graph()
    if isinstance(graph, BalancedGraph):
        found = nx.DiGraph()
        below = [(i, j) for i in drawn for j in graph.children(i)]
        edges = [(i, j) for i, j in below if j in drawn]
    found.add_nodes_from(drawn)
    found.add_edges_from(edges)
    return found


def contents(
    graph: ClusterGraph,
    clusters: list[Cluster],
    sepsets: dict[Edge, Scope],
    evidence: Evidence | None,
    sizes: bool,
    names: bool = True,
) -> dict[Node, str]:
    """The texts of clusters, by index, and of sepsets, by edge; with their sizes if asked for.

    Without names, a cluster's is its number, and a sepset's is empty.
    """
    observed: frozenset[Variable] = frozenset(evidence or ())
    most: int | None = next(named for up_to, named in _NAMED if len(clusters) <= up_to)
    if isinstance(graph, DynamicGraph):
        observed |= {*graph.model.sensors, *graph.model.inputs}
        most = None
    counts = {} if evidence is None else reading_counts(graph, evidence)
    texts: dict[Node, str] = {c.index: cluster_label(c, observed, counts, most) for c in clusters}
    texts |= {edge: scope_label(scope, most) for edge, scope in sepsets.items()}
    if not names:
        texts = {c.index: str(c.index) for c in clusters} | dict.fromkeys(sepsets, "")
    if sizes:
        scopes: dict[Node, Scope] = {c.index: c.scope for c in clusters}
        texts = {
            node: f"{text}\n{_size((scopes | sepsets)[node])}" if text else ""
            for node, text in texts.items()
        }
    return texts


def _size(scope: Scope) -> str:
    number = size(scope)
    return f"{amount(number)} entries" if is_discrete(scope) else f"dim {number:,}"


def reading_counts(graph: ClusterGraph, evidence: Evidence) -> dict[Variable, int]:
    """The number of measurements of each sensor of a dynamic network at each step.

    A measurement counts if one run or more took it. A static network's graph has no counts.
    """
    if not isinstance(graph, DynamicGraph):
        return {}
    if not hasattr(evidence, "items"):
        raise EvidenceError(f"evidence maps variables to values; found {type(evidence).__name__}")
    model, span = graph.model, range(graph.steps + 1)
    bound = bind(model.transition, model.observation, evidence, graph.steps, model.lead)
    counts = {sensor.at(step): 0 for sensor in model.sensors for step in span}
    for reading in bound.readings:
        steps = reading.step[reading.taken.any(axis=(1, 2))]
        for step, count in zip(*np.unique(steps, return_counts=True), strict=True):
            counts[reading.cpd.child.at(int(step))] = int(count)
    return counts
