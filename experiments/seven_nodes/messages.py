"""A chain of clusters with their initial beliefs, and all messages between them, in numbers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, Rectangle

import pgm
from experiments.kinds import as_form
from experiments.seven_nodes.formulas import message, potential, size, write
from pgm.plot.diagrams.canvas import Box, Size, open_canvas, text_size
from pgm.plot.drawing.colours import CLUSTER, SEPSET

_GAP = 12.0
_AWAY = 9.0  # from a sepset to its arrows
_ARROW = 44.0
_BEYOND = 6.0  # from an arrow to its message


def draw_messages(
    graph: pgm.ClusterGraph, evidence: Mapping[pgm.Variable, float], ax: Axes
) -> None:
    """Draw clusters, sepsets and messages, those to the right above, those to the left below.

    Parameters
    ----------
    graph : ClusterGraph
        A chain of clusters, with one number in each sepset.
    evidence : mapping of Variable to float
    ax : matplotlib.axes.Axes
    """
    posterior = pgm.infer(graph, evidence)
    contents = {c.index: [f"$C_{c.index + 1}$", *potential(c, evidence)] for c in graph}
    ovals = {index: _oval(size(lines)) for index, lines in contents.items()}
    sent = {
        (i, j): message(i, j, as_form(posterior.message(i, j)))
        for edge in graph.sepsets
        for i, j in (edge, edge[::-1])
    }
    rooms = {
        (i, j): max(size(sent[i, j]).width, size(sent[j, i]).width, _ARROW)
        for i, j in graph.sepsets
    }
    x = 0.0
    centres: dict[int | tuple[int, int], float] = {}
    for cluster in graph:
        k = cluster.index
        centres[k] = x + 0.5 * ovals[k].width
        x += ovals[k].width + _GAP
        if (edge := (k, k + 1)) in rooms:
            centres[edge] = x + 0.5 * rooms[edge]
            x += rooms[edge] + _GAP
    half = 0.5 * max(oval.height for oval in ovals.values())
    canvas = open_canvas(ax, Box(0.0, -half - _GAP, x - _GAP, half + _GAP))
    canvas.line([(centres[0], 0.0), (centres[len(ovals) - 1], 0.0)])
    for k, lines in contents.items():
        canvas.shape(Ellipse((centres[k], 0.0), *ovals[k]), CLUSTER, 1.0)
        write(canvas, (centres[k], 0.0), lines)
    for (i, j), scope in graph.sepsets.items():
        middle, name = centres[i, j], ", ".join(map(repr, scope))
        plate = Size(text_size(name).width + 8.0, text_size(name).height + 5.0)
        corner = middle - 0.5 * plate.width, -0.5 * plate.height
        canvas.shape(Rectangle(corner, *plate), SEPSET, 0.8)
        canvas.text((middle, 0.0), name)
        for edge, way in (((i, j), 1.0), ((j, i), -1.0)):
            level = way * (0.5 * plate.height + _AWAY)
            start, end = (middle - way * 0.5 * _ARROW, level), (middle + way * 0.5 * _ARROW, level)
            canvas.arrow(posA=start, posB=end, shrinkA=0.0, shrinkB=0.0, head=8.0, zorder=4.0)
            beyond = _BEYOND + 0.5 * size(sent[edge]).height
            write(canvas, (middle, level + way * beyond), sent[edge])


def _oval(text: Size) -> Size:
    """The ellipse about a text, through the corners of its box."""
    return Size(float(np.sqrt(2.0)) * text.width, float(np.sqrt(2.0)) * text.height + 4.0)
