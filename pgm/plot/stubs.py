"""Stubs: short lines that say that a graph goes on where it is not drawn."""

from __future__ import annotations

from collections.abc import Mapping

from pgm.plot.canvas import Box, Canvas, Point, Size
from pgm.plot.colours import MUTED
from pgm.plot.layout import GAP, Layout, Node

_LENGTH = 30.0
_DASHES = (0.0, (3.0, 2.5))

Stub = tuple[Point, Point]


def stub(layout: Layout, sizes: Mapping[Node, Size], index: int) -> Stub:
    """A short line from a cluster's border to where no shape is, to the right if it can be."""
    x, y = layout.points[index]
    width, height = sizes[index]
    shapes = [(at, sizes[node]) for node, at in layout.points.items() if node != index]
    stubs = []
    for across, down in ((1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0)):
        edge = x + 0.5 * across * width, y + 0.5 * down * height
        end = edge[0] + _LENGTH * across, edge[1] + _LENGTH * down
        middle, reach = (0.5 * (edge[0] + end[0]), 0.5 * (edge[1] + end[1])), 0.5 * _LENGTH + GAP
        if all(
            abs(at[0] - middle[0]) > 0.5 * size.width + reach * abs(across)
            or abs(at[1] - middle[1]) > 0.5 * size.height + reach * abs(down)
            for at, size in shapes
        ):
            return edge, end
        stubs.append((edge, end))
    return stubs[0]


def around(box: Box, stubs: list[Stub]) -> Box:
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
    beyond = 7.0 / _LENGTH
    canvas.text((right + beyond * (right - left), high + beyond * (high - low)), "…", colour=MUTED)
