"""Cluster graphs, and the messages between their clusters."""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import networkx as nx
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, Rectangle

from pgm.arguments import public
from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.cluster import Edge
from pgm.errors import GraphError
from pgm.evidence import Evidence
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array
from pgm.plot.diagrams.arrangement import arrange
from pgm.plot.diagrams.canvas import (
    Box,
    Canvas,
    Point,
    Size,
    open_canvas,
    readable,
    room,
    slack,
    text_size,
)
from pgm.plot.diagrams.contents import contents, joined, links, shown
from pgm.plot.diagrams.layout import GAP, Layout, Node, distances
from pgm.plot.diagrams.shading import Shading, by_residual, by_size
from pgm.plot.drawing.colours import CLUSTER, INK, MUTED, SEPSET, readable_on

_MOST = 1000
# Names of more clusters are never legible in a figure of ordinary size.
_NAMED = 250
_STUB = 30.0
_DASHES = (0.0, (3.0, 2.5))
Stub = tuple[Point, Point]
_SUBSCRIPT = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
# Short enough for lines that come slanting to pass by.
_ARROW = 18.0
# A sepset without a text.
_BLANK = Size(7.0, 7.0)
# From a sepset's border to its arrows, and from these to their names.
_AWAY, _APART = 6.0, 3.0


@public
def cluster_graph(
    graph: ClusterGraph,
    *,
    steps: int | None = None,
    around: int | None = None,
    within: int = 2,
    evidence: Evidence | None = None,
    names: bool | None = None,
    sizes: bool = False,
    colour: str | None = None,
    residuals: Mapping[Edge, npt.ArrayLike] | None = None,
    messages: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw clusters as ellipses and, on the edges between them, sepsets as rectangles.

    A chain runs left to right, in rows where it is long; a balanced tree stands in levels below its
    root, another tree in layers from its centre, other graphs in layers from one of their clusters.
    A cluster lists its hidden variables, then those that are observed; in large graphs it names the
    first and counts the others, as ``+5``. Sensors whose names differ by numbers alone share a line
    where they are many: ``z1…z20[3] ×38`` is 38 measurements of twenty. Graphs so large that names
    were too small to read have numbers.

    Parameters
    ----------
    graph : ClusterGraph
    steps : int, optional
        Only clusters 0..steps are drawn, of a balanced tree those of the steps 0..steps; dashed
        stubs lead to the others.
    around : int, optional
        Only this cluster and its neighbourhood are drawn, of the clusters that `steps` leaves.
    within : int
        How many edges the neighbourhood of `around` reaches.
    evidence : mapping of Variable, optional
        That given to `pgm.infer`. Several measurements of a sensor at a step are then shown as
        ``z[3] ×4``, and sensors without a measurement left out.
    names : bool, optional
        Whether variables are named, or clusters have their numbers alone and sepsets nothing.
        Without, they are named where the letters can be read: in an axes that is given, or in a
        figure of 18 inches.
    sizes : bool
        Whether to write the number of components, or of table entries, below the variables.
    colour : {"size", "residual"}, optional
        Colour clusters by size, or sepsets by residual, with a bar that says which colour is what.
    residuals : mapping of (int, int) to array_like, optional
        How much the messages between two clusters still change; of several numbers, as of runs or
        of the two directions, the largest is shown. Implies ``colour="residual"``.
    messages : bool
        Whether to name the clusters, as C₁, and to draw the messages between them, as δ₁,₂.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, as large as it needs, without.

    Raises
    ------
    GraphError
        If `graph` is none, `steps` is no index, `names` no bool, there are too many clusters to
        read, or colours are asked for that there are no numbers for.
    EvidenceError
        If the evidence does not fit the graph's model.

    Examples
    --------
    >>> from pgm.examples import pair
    >>> ax = pgm.plot.cluster_graph(pgm.compile(pair, method=pgm.Bethe()))
    >>> sorted(text.get_text() for text in ax.texts)
    ['a, b']
    """
    if not (names is None or isinstance(names, bool)):
        raise GraphError(f"names= is True or False, or None for names where legible; not {names!r}")
    clusters = shown(graph, steps, around, within, _MOST)
    page = room(ax)
    sepsets, cut = joined(graph, clusters)
    shading = _shading(graph, clusters, sepsets, colour, residuals)
    joins = links(graph, clusters, sepsets)

    def drafted(named: bool) -> _Draft:
        texts = contents(graph, clusters, sepsets, evidence, sizes, named)
        if messages:
            texts |= {c.index: f"{cluster_name(c.index)}\n{texts[c.index]}" for c in clusters}
        return _draft(texts, sepsets, joins, cut, messages, shading, page)

    named = names or (names is None and (messages or len(clusters) <= _NAMED))
    draft = drafted(named)
    if named and not names and not messages and not readable(draft.box.size, draft.letters, page):
        draft = drafted(False)
    texts, shapes, layout, stubs, box, letters = draft
    canvas = open_canvas(ax, box, letters)
    for line in layout.lines.values():
        canvas.line(line)
    for one in stubs:
        draw_stub(canvas, one)
    for line in layout.loose:
        canvas.line(line)
    for node in [*(c.index for c in clusters), *sepsets]:
        _draw(canvas, layout.points[node], shapes[node], texts[node], node, shading)
    if messages:
        for edge in sepsets:
            draw_messages(canvas, edge, layout.points[edge], shapes[edge], layout.lines[edge])
    if shading:
        shading.draw_bar(canvas, box)
    return canvas.ax


class _Draft(NamedTuple):
    texts: dict[Node, str]
    shapes: dict[Node, Size]
    layout: Layout
    stubs: list[Stub]
    box: Box
    letters: float


def _draft(
    texts: dict[Node, str],
    sepsets: Mapping[Edge, Scope],
    joins: nx.Graph,
    cut: list[int],
    messages: bool,
    shading: Shading | None,
    page: Size | None,
) -> _Draft:
    room_of = {node: text_size(text) for node, text in texts.items()}
    shapes: dict[Node, Size] = {
        node: _plate(size) if node in sepsets else _oval(size) for node, size in room_of.items()
    }
    rooms = with_messages(shapes, sepsets, joins) if messages else shapes
    layout = arrange(joins, rooms, page)
    stubs = [stub(layout, rooms, k) for k in dict.fromkeys(cut)]
    box = around_stubs(layout.box(rooms), stubs)
    if shading:
        box = shading.bar_box(box)
    letters = min(
        slack([room_of[k] for k in nodes], [shapes[k] for k in nodes], round=round_)
        for nodes, round_ in (
            ([k for k in texts if k not in sepsets], True),
            ([k for k in sepsets if texts[k]], False),
        )
        if nodes
    )
    return _Draft(texts, shapes, layout, stubs, box, letters)


def _shading(
    graph: ClusterGraph,
    clusters: list[Cluster],
    sepsets: dict[Edge, Scope],
    colour: str | None,
    residuals: Mapping[Edge, npt.ArrayLike] | None,
) -> Shading | None:
    if colour not in (None, "size", "residual"):
        raise GraphError(f'colour is "size" or "residual", not {colour!r}')
    if colour == "residual" and residuals is None:
        raise GraphError('colour="residual" needs residuals={(i, j): number}')
    if residuals is None:
        return by_size({c.index: c.scope for c in clusters}) if colour else None
    if colour == "size":
        raise GraphError('colour="size" does not go with residuals; leave one of them out')
    return by_residual(graph, sepsets, residuals)


def _oval(text: Size) -> Size:
    return Size(math.sqrt(2.0) * text.width + 8.0, math.sqrt(2.0) * text.height + 6.0)


def _plate(text: Size) -> Size:
    return Size(text.width + 8.0, text.height + 5.0) if text.width else _BLANK


def _draw(
    canvas: Canvas,
    at: tuple[float, float],
    size: Size,
    text: str,
    node: Node,
    shading: Shading | None,
) -> None:
    tint = shading[node] if shading else None
    ink = INK if tint is None else readable_on(tint)
    if isinstance(node, tuple):
        corner = (at[0] - 0.5 * size.width, at[1] - 0.5 * size.height)
        canvas.shape(Rectangle(corner, *size), tint or SEPSET, 0.8)
    else:
        canvas.shape(Ellipse(at, *size), tint or CLUSTER, 1.0)
    canvas.text(at, text, colour=ink)


def stub(layout: Layout, sizes: Mapping[Node, Size], index: int) -> Stub:
    """A short line from a cluster's border to where no shape is, to the right if it can be."""
    x, y = layout.points[index]
    width, height = sizes[index]
    shapes = [(at, sizes[node]) for node, at in layout.points.items() if node != index]
    stubs = []
    for across, down in ((1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0)):
        edge = x + 0.5 * across * width, y + 0.5 * down * height
        end = edge[0] + _STUB * across, edge[1] + _STUB * down
        middle, reach = (0.5 * (edge[0] + end[0]), 0.5 * (edge[1] + end[1])), 0.5 * _STUB + GAP
        if all(
            abs(at[0] - middle[0]) > 0.5 * size.width + reach * abs(across)
            or abs(at[1] - middle[1]) > 0.5 * size.height + reach * abs(down)
            for at, size in shapes
        ):
            return edge, end
        stubs.append((edge, end))
    return stubs[0]


def around_stubs(box: Box, stubs: list[Stub]) -> Box:
    """A box with room for stubs too."""
    ends = [end for _, end in stubs]
    return Box(
        min([box.left, *(x - GAP for x, _ in ends)]),
        min([box.bottom, *(y - GAP for _, y in ends)]),
        max([box.right, *(x + GAP for x, _ in ends)]),
        max([box.top, *(y + GAP for _, y in ends)]),
    )


def draw_stub(canvas: Canvas, line: Stub) -> None:
    """Draw a dashed line, and dots beyond it."""
    (left, low), (right, high) = line
    canvas.line([(left, low), (right, high)], _DASHES)
    beyond = 7.0 / _STUB
    canvas.text((right + beyond * (right - left), high + beyond * (high - low)), "…", colour=MUTED)


def cluster_name(index: int) -> str:
    """``C₁``."""
    return f"C{index}".translate(_SUBSCRIPT)


def message_name(source: int, target: int) -> str:
    """``δ₁,₂``."""
    return f"δ{source},{target}".translate(_SUBSCRIPT)


def with_messages(
    shapes: Mapping[Node, Size], sepsets: Iterable[Edge], links: nx.Graph
) -> dict[Node, Size]:
    """Shapes, with room for arrows about the sepsets, whichever way the lines run.

    links: The clusters; in chains all lines are horizontal.
    """
    chain = nx.is_forest(links) and max(degree for _, degree in links.degree) <= 2
    found = dict(shapes)
    for edge in sepsets:
        width, height = shapes[edge]
        name = text_size(message_name(*edge))
        beside = 0.0 if chain else name.width + _AWAY + _APART
        found[edge] = Size(
            max(width + 2.0 * beside, name.width, _ARROW),
            max(height + 2.0 * (_AWAY + _APART + name.height), 0.0 if chain else _ARROW),
        )
    return found


def draw_messages(canvas: Canvas, edge: Edge, at: Point, plate: Size, line: Array) -> None:
    """Draw both arrows of a sepset, across or up and down, each to the left of its way.

    line: (P, 2), from the first cluster to the second, through the centre.
    """
    along = _along(line, at)
    for (source, target), way in ((edge, along), (edge[::-1], -along)):
        name = message_name(source, target)
        left = np.array([-way[1], way[0]])
        border = 0.5 * np.abs(left) @ plate
        middle = at + (border + _AWAY) * left
        beyond = border + _AWAY + _APART + 0.5 * np.abs(left) @ text_size(name)
        ends = (middle + half * way for half in (-0.5 * _ARROW, 0.5 * _ARROW))
        start, end = ((float(x), float(y)) for x, y in ends)
        canvas.arrow(posA=start, posB=end, shrinkA=0.0, shrinkB=0.0, head=8.0, zorder=4.0)
        x, y = at + beyond * left
        canvas.text((float(x), float(y)), name)


def _along(line: Array, at: Point) -> Array:
    """The way a line mostly runs where it passes a point: right, left, up or down."""
    pieces = np.diff(line, axis=0)
    lengths = np.linalg.norm(pieces, axis=-1, keepdims=True)
    here = distances(np.array([at]), line[:-1], line[1:])[:, 0] < 1e-6
    way = (pieces / np.maximum(lengths, 1e-9))[here].sum(axis=0)
    steepest = int(np.argmax(np.abs(way)))
    found: Array = np.sign(way[steepest]) * np.eye(2)[steepest]
    return found
