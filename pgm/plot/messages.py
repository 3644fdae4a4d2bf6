"""Messages between clusters: at each sepset an arrow either way, named δ₁,₂ and δ₂,₁."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import networkx as nx
import numpy as np

from pgm.clustergraph.checks import Edge
from pgm.kernels.arrays import Array
from pgm.plot.canvas import Canvas, Point, Size, text_size
from pgm.plot.layout import Node
from pgm.plot.segments import distances

_SUBSCRIPT = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
# Short enough for lines that come slanting to pass by.
_LENGTH = 18.0
# From a sepset's border to its arrows, and from these to their names.
_AWAY, _APART = 6.0, 3.0


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

    Parameters
    ----------
    shapes : mapping to Size
        The clusters, and the sepsets alone.
    sepsets : iterable of (int, int)
    links : networkx.Graph
        The clusters; in chains all lines are horizontal.
    """
    chain = nx.is_forest(links) and max(degree for _, degree in links.degree) <= 2
    found = dict(shapes)
    for edge in sepsets:
        width, height = shapes[edge]
        name = text_size(message_name(*edge))
        beside = 0.0 if chain else name.width + _AWAY + _APART
        found[edge] = Size(
            max(width + 2.0 * beside, name.width, _LENGTH),
            max(height + 2.0 * (_AWAY + _APART + name.height), 0.0 if chain else _LENGTH),
        )
    return found


def draw_messages(canvas: Canvas, edge: Edge, at: Point, plate: Size, line: Array) -> None:
    """Draw both arrows of a sepset, across or up and down, each to the left of its way.

    Parameters
    ----------
    canvas : Canvas
    edge : (int, int)
    at : Point
        The centre of the sepset.
    plate : Size
        Of the sepset.
    line : ndarray
        (P, 2), from the first cluster to the second, through the centre.
    """
    along = _along(line, at)
    for (source, target), way in ((edge, along), (edge[::-1], -along)):
        name = message_name(source, target)
        left = np.array([-way[1], way[0]])
        border = 0.5 * np.abs(left) @ plate
        middle = at + (border + _AWAY) * left
        beyond = border + _AWAY + _APART + 0.5 * np.abs(left) @ text_size(name)
        ends = (middle + half * way for half in (-0.5 * _LENGTH, 0.5 * _LENGTH))
        start, end = ((float(x), float(y)) for x, y in ends)
        canvas.arrow(posA=start, posB=end, shrinkA=0.0, shrinkB=0.0, head=8.0, zorder=4.0)
        x, y = at + beyond * left
        canvas.text((float(x), float(y)), name)


def _along(line: Array, at: Point) -> Array:
    """Which way a line mostly runs where it passes a point: right, left, up or down."""
    pieces = np.diff(line, axis=0)
    lengths = np.linalg.norm(pieces, axis=-1, keepdims=True)
    here = distances(np.array([at]), line[:-1], line[1:])[:, 0] < 1e-6
    way = (pieces / np.maximum(lengths, 1e-9))[here].sum(axis=0)
    steepest = int(np.argmax(np.abs(way)))
    found: Array = np.sign(way[steepest]) * np.eye(2)[steepest]
    return found
