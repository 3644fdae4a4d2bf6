"""Networks: in layers, and where there is time, unrolled."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from itertools import pairwise

import networkx as nx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Ellipse
from matplotlib.path import Path

from pgm.errors import ModelError
from pgm.kernels.arrays import Array
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.networks.static import density
from pgm.plot.colours import OBSERVED
from pgm.plot.diagrams.canvas import FONT, Canvas, Point, Size, open_canvas, room, slack, text_size
from pgm.plot.diagrams.columns import place
from pgm.plot.diagrams.graphs import Network, directed, in_slices
from pgm.plot.diagrams.labels import node_label
from pgm.plot.diagrams.layered import layered
from pgm.plot.diagrams.layout import Layout, Node
from pgm.plot.diagrams.segments import distances
from pgm.variables import Variable

_SMALLEST = 15.0
_FILL = {True: OBSERVED, False: "white"}
# A density begins so far to the right of its node's centre, in radii, to be clear of arrows down.
_AWAY = 0.5
_GAP = 10.0
Arrow = tuple[Variable, Variable]
# How far an arrow may bend, as a part of its length; the first that is clear of nodes is taken.
_BENDS = (0.0, 0.12, -0.12, 0.24, -0.24, 0.36, -0.36)
_CLEAR = 1.2


def network(
    model: Network,
    *,
    steps: int | None = None,
    evidence: Iterable[Variable] | None = None,
    cpds: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw a network: parents above their children, observed variables shaded.

    A dynamic network is unrolled, with slices left to right; so is a static one whose variables
    all stand at steps, like what unrolling gives. Any other static network stands in topological
    layers, from top to bottom or, where that makes better use of the axes, from left to right.

    Parameters
    ----------
    model : BayesianNetwork or DynamicBayesianNetwork
    steps : int, optional
        The last slice of a dynamic network drawn; 1 without, which is the whole pattern.
    evidence : iterable or mapping of Variable, optional
        What is observed beside the inputs, a template standing for all its steps. Without, the
        sensors of a dynamic network, and nothing of a static one.
    cpds : bool
        Whether to write its density, like ``p(x[1] | x[0], u[1])``, to each node that has a CPD:
        beside it in slices, else below its name.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, as large as it needs, without.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError
        If `model` is no network, or `steps` is no step.
    EvidenceError
        If the evidence names what is no variable of the network.
    """
    if not isinstance(model, BayesianNetwork | DynamicBayesianNetwork):
        raise ModelError(
            f"network draws a DynamicBayesianNetwork or BayesianNetwork, not {type(model).__name__}"
        )
    graph = directed(model, steps, evidence)
    slices = isinstance(model, DynamicBayesianNetwork) or in_slices(graph)
    texts = densities(model, graph) if cpds else {}
    return (_slices if slices else in_layers)(graph, texts, ax)


def _slices(graph: nx.DiGraph, beside: dict[Variable, str], ax: Axes | None) -> Axes:
    """Circles of one size, and texts at the lower right of some."""
    labels = {node: node_label(node) for node in graph}
    texts = [text_size(label) for label in labels.values()]
    radius = max(_SMALLEST, *(0.5 * float(np.hypot(*size)) + 3.0 for size in texts))
    points = spread(place(graph, radius), beside, radius)
    layout = Layout(dict(points.items()))
    sizes: dict[Node, Size] = dict.fromkeys(graph, Size(2.0 * radius + 2.0, 2.0 * radius + 2.0))
    for node, text in beside.items():
        sizes[text] = text_size(text)
        layout.points[text] = lower_right(points[node], radius, sizes[text])
    box = layout.box(sizes)
    letters = slack(texts, [Size(2.0 * radius, 2.0 * radius)] * len(texts))
    canvas = open_canvas(ax, box, letters)
    circles = {node: Circle(points[node], radius) for node in graph}
    for node, circle in circles.items():
        canvas.shape(circle, _FILL[graph.nodes[node]["observed"]], 1.0)
        canvas.text(points[node], labels[node])
    for text in beside.values():
        canvas.text(layout.points[text], text, size=FONT * canvas.scale / canvas.letters)
    for (parent, child), bend in bends(graph, points, radius).items():
        draw_arrow(canvas, circles[parent], circles[child], bend)
    return canvas.ax


def _pointed(canvas: Canvas, edge: Arrow, curve: Array) -> None:
    canvas.arrow(path=Path(curve))


def in_layers(
    graph: nx.DiGraph,
    below: dict[Variable, str],
    ax: Axes | None,
    join: Callable[[Canvas, Arrow, Array], None] = _pointed,
) -> Axes:
    """Ellipses as wide as their names, and as the texts below some of these.

    Parameters
    ----------
    graph : networkx.DiGraph
        Nodes have the attribute ``observed``.
    below : dict of Variable to str
    ax : matplotlib.axes.Axes or None
    join : callable
        Draws an edge along a curve (P, 2); an arrow without.
    """
    labels = {node: "\n".join(filter(None, (node_label(node), below.get(node)))) for node in graph}
    texts = {node: text_size(label) for node, label in labels.items()}
    least = 2.0 * _SMALLEST
    high = max(least, *(1.3 * size.height + 6.0 for size in texts.values()))
    sizes = {node: Size(max(high, _width(size, high)), high) for node, size in texts.items()}
    layout = layered(graph, sizes, room(ax))
    letters = slack(list(texts.values()), list(sizes.values()))
    canvas = open_canvas(ax, layout.box(sizes), letters)
    for node, at in layout.points.items():
        canvas.shape(Ellipse(at, *sizes[node]), _FILL[graph.nodes[node]["observed"]], 1.0)
        canvas.text(at, labels[node])
    for edge, curve in layout.lines.items():
        join(canvas, edge, curve)
    return canvas.ax


def _width(text: Size, height: float) -> float:
    """The width of an ellipse of some height about a text."""
    return text.width / float(np.sqrt(1.0 - (text.height / height) ** 2)) + 6.0


def densities(
    model: BayesianNetwork | DynamicBayesianNetwork, nodes: Iterable[Variable]
) -> dict[Variable, str]:
    """The density of each node that has a CPD."""
    if isinstance(model, DynamicBayesianNetwork):
        model = model.unroll(max(node.step or 0 for node in nodes))
    return {cpd.child: density(cpd) for cpd in model.cpds}


def spread(
    points: dict[Variable, Point], texts: dict[Variable, str], radius: float
) -> dict[Variable, Point]:
    """Columns farther apart, where a text would else reach those of the next node in its row."""
    factor = 1.0
    in_rows = sorted(points, key=lambda node: points[node][::-1])
    for node, after in pairwise(in_rows):
        (x, y), (beyond, row) = points[node], points[after]
        if node in texts and y == row:
            due = text_size(texts[node]).width + _AWAY * radius + _GAP
            factor = max(factor, due / (beyond - x))
    return {node: (factor * x, y) for node, (x, y) in points.items()}


def lower_right(at: Point, radius: float, text: Size) -> Point:
    """The centre of a text at the lower right of a node."""
    return at[0] + _AWAY * radius + 0.5 * text.width, at[1] - radius - 0.5 * text.height


def bends(graph: nx.DiGraph, points: dict[Variable, Point], radius: float) -> dict[Arrow, float]:
    """The least bend of each arrow that keeps it clear of other nodes, alike in all slices.

    Parameters
    ----------
    graph : networkx.DiGraph
        Nodes are variables at steps.
    points : dict of Variable to Point
    radius : float
        Of a node.
    """
    alike: dict[tuple[Variable, Variable, int], list[Arrow]] = defaultdict(list)
    for parent, child in graph.edges:
        alike[parent.template, child.template, child.step - parent.step].append((parent, child))
    found: dict[Arrow, float] = {}
    for arrows in alike.values():
        room = [min(_clearance(points, arrow, bend) for arrow in arrows) for bend in _BENDS]
        good = [b for b, clear in zip(_BENDS, room, strict=True) if clear > _CLEAR * radius]
        found |= dict.fromkeys(arrows, good[0] if good else _BENDS[int(np.argmax(room))])
    return found


def _clearance(points: dict[Variable, Point], arrow: Arrow, bend: float) -> float:
    """The distance of an arrow from other nodes; its curve is that of matplotlib's ``arc3``."""
    others = np.array([at for node, at in points.items() if node not in arrow])
    if not len(others):
        return np.inf
    a, b = np.array(points[arrow[0]]), np.array(points[arrow[1]])
    middle = 0.5 * (a + b) + bend * np.array([b[1] - a[1], a[0] - b[0]])
    t = np.linspace(0.0, 1.0, 9 if bend else 2)[:, None]
    curve = (1.0 - t) ** 2 * a + 2.0 * t * (1.0 - t) * middle + t * t * b
    return float(distances(others, curve[:-1], curve[1:]).min())


def draw_arrow(canvas: Canvas, parent: Circle, child: Circle, bend: float) -> None:
    """An arrow from the border of one circle to that of another."""
    canvas.arrow(
        posA=parent.center,
        posB=child.center,
        patchA=parent,
        patchB=child,
        shrinkA=0.0,
        shrinkB=0.0,
        connectionstyle=f"arc3,rad={bend}",
    )
