"""Cluster graphs."""

from __future__ import annotations

import math

import networkx as nx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, Rectangle

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.checks import Edge
from pgm.compile import SliceGraph
from pgm.errors import GraphError
from pgm.evidence import Evidence
from pgm.factors.scope import Scope
from pgm.plot.arrangement import GAP, STUB, Arrangement, arrange
from pgm.plot.axes import check_axes
from pgm.plot.canvas import Box, Canvas, Point, Size, open_canvas, room, text_size
from pgm.plot.colours import CLUSTER, INK, MUTED, SEPSET
from pgm.plot.labels import cluster_label, scope_label
from pgm.plot.sightings import reading_counts
from pgm.variables import Variable

_MOST = 200


def cluster_graph(
    graph: ClusterGraph,
    *,
    steps: int | None = None,
    evidence: Evidence | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw clusters as ellipses and, on the edges between them, sepsets as rectangles.

    A chain runs left to right, in rows where it is long; a tree in layers from its centre; other
    graphs as the layout of Kamada and Kawai has them. A cluster lists its hidden variables, then
    those that are observed.

    Parameters
    ----------
    graph : ClusterGraph
    steps : int, optional
        Only clusters 0..steps are drawn; dashed stubs lead to the others.
    evidence : mapping of Variable, optional
        That given to `pgm.infer`. Several readings of a sensor at a step are then shown as
        ``z[3] ×4``, and sensors without a reading left out.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, as large as it needs, without.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    GraphError
        If `graph` is none, `steps` is no index, or there are too many clusters to read.
    EvidenceError
        If the evidence does not fit the graph's model.
    """
    clusters = _shown(graph, steps)
    if ax is not None:
        check_axes(ax)
    drawn = {cluster.index for cluster in clusters}
    sepsets: dict[Edge, Scope] = {}
    stubs: list[int] = []
    for i, j in graph.sepsets:
        if i in drawn and j in drawn:
            sepsets[i, j] = graph.sepsets[i, j]
        elif i in drawn or j in drawn:
            stubs.append(i if i in drawn else j)

    observed: frozenset[Variable] = frozenset(evidence or ())
    if isinstance(graph, SliceGraph):
        observed |= {*graph.model.sensors, *graph.model.inputs}
    counts = {} if evidence is None else reading_counts(graph, evidence)
    texts = {c.index: cluster_label(c, observed, counts) for c in clusters}
    marks = {edge: scope_label(scope) for edge, scope in sepsets.items()}
    ovals = {k: _oval(text_size(text)) for k, text in texts.items()}
    plates = {edge: _plate(text_size(text)) for edge, text in marks.items()}
    links = nx.Graph()
    links.add_nodes_from(sorted(drawn))
    links.add_edges_from(sepsets)
    places = arrange(links, ovals, plates, None if ax is None else room(ax))

    box = places.box(ovals, plates)
    ends = [_stub(places, ovals, plates, k) for k in dict.fromkeys(stubs)]
    canvas = open_canvas(ax, _around(box, [end for _, end in ends]))
    for route in places.routes.values():
        _line(canvas, route, "-")
    for start, end in ends:
        _line(canvas, [start, end], (0.0, (3.0, 2.5)))
        beyond = tuple(e + 7.0 * (e - s) / STUB for s, e in zip(start, end, strict=True))
        canvas.text((beyond[0], beyond[1]), "…", colour=MUTED)
    for k, at in places.clusters.items():
        size = ovals[k]
        shape = Ellipse(at, *size, fc=CLUSTER, ec=INK, lw=canvas.width(1.0), zorder=3.0)
        canvas.ax.add_patch(shape)
        canvas.text(at, texts[k])
    for edge, at in places.sepsets.items():
        _rectangle(canvas, at, plates[edge])
        canvas.text(at, marks[edge])
    return canvas.ax


def _shown(graph: ClusterGraph, steps: int | None) -> list[Cluster]:
    if not isinstance(graph, ClusterGraph):
        raise GraphError(f"cluster_graph draws a compiled graph, not {type(graph).__name__}")
    count = len(graph.clusters)
    if not count:
        raise GraphError("the graph has no clusters to draw")
    if steps is not None:
        if not isinstance(steps, (int, np.integer)) or isinstance(steps, bool) or steps < 0:
            raise GraphError(f"steps must be the last cluster to draw, 0 or more, not {steps!r}")
        count = min(count, int(steps) + 1)
    if count > _MOST:
        raise GraphError(
            f"{count} clusters are too many to read; draw {_MOST} at most, as with steps=4"
        )
    return list(graph.clusters[:count])


def _oval(text: Size) -> Size:
    """The ellipse about a text: through the corners of its box, and a little more."""
    return Size(math.sqrt(2.0) * text.width + 8.0, math.sqrt(2.0) * text.height + 6.0)


def _plate(text: Size) -> Size:
    return Size(text.width + 8.0, text.height + 5.0)


def _stub(
    places: Arrangement, ovals: dict[int, Size], plates: dict[Edge, Size], index: int
) -> tuple[Point, Point]:
    """A short line from a cluster's border to where no shape is, to the right if it can be."""
    x, y = places.clusters[index]
    width, height = ovals[index]
    shapes = [(at, ovals[k]) for k, at in places.clusters.items() if k != index]
    shapes += [(at, plates[edge]) for edge, at in places.sepsets.items()]
    stubs = []
    for across, down in ((1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0)):
        edge = x + 0.5 * across * width, y + 0.5 * down * height
        end = edge[0] + STUB * across, edge[1] + STUB * down
        middle, reach = (0.5 * (edge[0] + end[0]), 0.5 * (edge[1] + end[1])), 0.5 * STUB + GAP
        if all(
            abs(at[0] - middle[0]) > 0.5 * size.width + reach * abs(across)
            or abs(at[1] - middle[1]) > 0.5 * size.height + reach * abs(down)
            for at, size in shapes
        ):
            return edge, end
        stubs.append((edge, end))
    return stubs[0]


def _around(box: Box, ends: list[Point]) -> Box:
    return Box(
        min([box.left, *(x - GAP for x, _ in ends)]),
        min([box.bottom, *(y - GAP for _, y in ends)]),
        max([box.right, *(x + GAP for x, _ in ends)]),
        max([box.top, *(y + GAP for _, y in ends)]),
    )


def _line(
    canvas: Canvas, route: list[Point], style: str | tuple[float, tuple[float, float]]
) -> None:
    x, y = zip(*route, strict=True)
    canvas.ax.plot(x, y, color=MUTED, linewidth=canvas.width(1.0), linestyle=style, zorder=1.0)


def _rectangle(canvas: Canvas, at: Point, size: Size) -> None:
    corner = (at[0] - 0.5 * size.width, at[1] - 0.5 * size.height)
    shape = Rectangle(corner, *size, fc=SEPSET, ec=INK, lw=canvas.width(0.8), zorder=3.0)
    canvas.ax.add_patch(shape)
