"""A network whose CPDs are factors, and around them the boundaries of clusters, dashed."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

import pgm
from experiments.seven_nodes.formulas import factor, size, write
from pgm.plot.diagrams.canvas import Box, Canvas, Point, open_canvas
from pgm.plot.drawing.colours import PALETTE

_RADIUS = 14.0
_ROW = 62.0
_BESIDE = 26.0  # from a node to its factor, above or below
_PAD = 10.0
_APART = 18.0  # between boundaries


def draw_boundaries(graph: pgm.ClusterGraph, ax: Axes) -> dict[int, Rectangle]:
    """Draw a column for each cluster: the variables whose factors it holds, in a dashed rectangle.

    Parameters
    ----------
    graph : ClusterGraph
        A chain, no cluster of which holds more than two factors.
    ax : matplotlib.axes.Axes

    Returns
    -------
    dict of int to Rectangle
        By the cluster's number, which counts from 1 and stands above its boundary.
    """
    order = {variable: k for k, variable in enumerate(graph.network.variables)}
    columns = [sorted(cluster.cpds, key=lambda cpd: order[cpd.child]) for cluster in graph]
    widths = [max(size([factor(cpd)]).width for cpd in column) + 2.0 * _PAD for column in columns]
    left = 0.0
    points: dict[pgm.Variable, Point] = {}
    boundaries: dict[int, Rectangle] = {}
    bottom, top = -_BESIDE - 2.0 * _PAD, _ROW + _BESIDE + 2.0 * _PAD
    for number, (column, width) in enumerate(zip(columns, widths, strict=True), start=1):
        for row, cpd in enumerate(reversed(column)):
            points[cpd.child] = left + 0.5 * width, _ROW * row
        high = top if len(column) > 1 else _RADIUS + _PAD
        boundaries[number] = Rectangle((left, bottom), width, high - bottom)
        left += width + _APART
    canvas = open_canvas(ax, Box(0.0, bottom, left - _APART, top + 2.0 * _PAD))
    circles = {variable: Circle(at, _RADIUS) for variable, at in points.items()}
    for number, boundary in boundaries.items():
        _draw_boundary(canvas, number, boundary)
    for variable, circle in circles.items():
        canvas.shape(circle, "white", 1.0)
        canvas.text(points[variable], repr(variable))
    for cpd in graph.network.cpds:
        x, y = points[cpd.child]
        write(canvas, (x, y + (_BESIDE if y else -_BESIDE)), [factor(cpd)])
        for parent in cpd.parents:
            canvas.arrow(
                posA=points[parent],
                posB=points[cpd.child],
                patchA=circles[parent],
                patchB=circles[cpd.child],
                shrinkA=0.0,
                shrinkB=0.0,
            )
    return boundaries


def _draw_boundary(canvas: Canvas, number: int, boundary: Rectangle) -> None:
    colour = PALETTE[(number - 1) % len(PALETTE)]
    boundary.set(facecolor="none", edgecolor=colour, linewidth=1.4, linestyle="--", zorder=0.5)
    canvas.ax.add_patch(boundary)
    x = boundary.get_x() + 0.5 * boundary.get_width()
    y = boundary.get_y() + boundary.get_height() + _PAD
    write(canvas, (x, y), [f"$C_{number}$"], colour=colour)
