"""Dynamic networks, unrolled."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from pgm.errors import ModelError
from pgm.networks import DynamicBayesianNetwork
from pgm.plot.arrows import bends, draw_arrow
from pgm.plot.axes import check_axes
from pgm.plot.canvas import Box, Canvas, Point, open_canvas, text_size
from pgm.plot.colours import INK, OBSERVED
from pgm.plot.columns import place
from pgm.variables import Variable

_SMALLEST = 15.0
_LONG_NAME = 44.0


def network(model: DynamicBayesianNetwork, *, steps: int = 1, ax: Axes | None = None) -> Axes:
    """Draw a dynamic network unrolled in time.

    Slices stand left to right; within one, parents stand above their children. Variables that are
    observed, inputs and sensors, are shaded.

    Parameters
    ----------
    model : DynamicBayesianNetwork
    steps : int
        The last slice drawn; 1 shows two, which is the whole pattern.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, as large as it needs, without.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError
        If `model` is no dynamic network, or `steps` is no step.
    """
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"network draws a DynamicBayesianNetwork, not {type(model).__name__}")
    if not isinstance(steps, (int, np.integer)) or isinstance(steps, bool) or steps < 0:
        raise ModelError(f"steps must be the last slice to draw, 0 or more, not {steps!r}")
    if ax is not None:
        check_axes(ax)
    graph = model.to_networkx(int(steps))
    labels = {node: _label(node) for node in graph}
    sizes = [text_size(label) for label in labels.values()]
    radius = max(_SMALLEST, *(0.5 * float(np.hypot(*size)) + 3.0 for size in sizes))
    points = place(graph, radius)

    x, y = np.array(list(points.values())).T
    reach = radius + 1.0
    box = Box(x.min() - reach, y.min() - reach, x.max() + reach, y.max() + reach)
    canvas = open_canvas(ax, box)
    circles = {
        node: _circle(canvas, points[node], radius, graph.nodes[node]["kind"]) for node in graph
    }
    for node, label in labels.items():
        canvas.text(points[node], label)
    for (parent, child), bend in bends(graph, points, radius).items():
        draw_arrow(canvas, circles[parent], circles[child], bend)
    return canvas.ax


def _label(node: Variable) -> str:
    """``x[3]``, on two lines where the name is long."""
    label = repr(node)
    return f"{node.name}\n[{node.step}]" if text_size(label).width > _LONG_NAME else label


def _circle(canvas: Canvas, at: Point, radius: float, kind: str) -> Circle:
    circle = Circle(
        at,
        radius,
        facecolor="white" if kind in ("state", "control") else OBSERVED,
        edgecolor=INK,
        linewidth=canvas.width(1.0),
        zorder=3.0,
    )
    canvas.ax.add_patch(circle)
    return circle
