"""Arrows that bend where a straight one would run over a node."""

from __future__ import annotations

from collections import defaultdict

import networkx as nx
import numpy as np
from matplotlib.patches import Circle

from pgm.plot.canvas import Canvas, Point
from pgm.plot.segments import distances
from pgm.variables import Variable

Arrow = tuple[Variable, Variable]

# How far an arrow may bend, as a part of its length; the first that is clear of nodes is taken.
_BENDS = (0.0, 0.12, -0.12, 0.24, -0.24, 0.36, -0.36)
_CLEAR = 1.2


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
