"""The places of shapes and the course of lines, in points; y grows upwards."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pgm.kernels.arrays import Array
from pgm.plot.diagrams.canvas import Box, Point, Size

Node = Hashable

GAP = 12.0
# A page, where no axes says how much room there is.
PAGE = Size(12.0 * 72.0, 8.0 * 72.0)
# How much smaller a picture may be for each crossing that it spares.
_CROSSING = 0.02


@dataclass(eq=False)
class Layout:
    """A picture before it is drawn.

    Attributes
    ----------
    points : dict of node to Point
        Centres of shapes.
    lines : dict of edge to ndarray
        (P, 2): what joins them.
    crossings : int
        How many lines cross.
    loose : list of ndarray
        (P, 2): parts of lines that begin or go on elsewhere, in pictures that are folded.
    """

    points: dict[Node, Point] = field(default_factory=dict)
    lines: dict[Node, Array] = field(default_factory=dict)
    crossings: int = 0
    loose: list[Array] = field(default_factory=list)

    def add(self, other: Layout, x: float, y: float) -> None:
        """Take in another layout, moved."""
        self.points |= {node: (at[0] + x, at[1] + y) for node, at in other.points.items()}
        shift = np.array([x, y])
        self.lines |= {edge: curve + shift for edge, curve in other.lines.items()}
        self.loose += [curve + shift for curve in other.loose]
        self.crossings += other.crossings

    def box(self, sizes: Mapping[Node, Size]) -> Box:
        """The bounds of everything."""
        at = np.array(list(self.points.values()))
        half = 0.5 * np.array([sizes[node] for node in self.points])
        corners = np.concatenate([at - half, at + half, *self.lines.values(), *self.loose])
        return Box(*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())

    def worth(self, sizes: Mapping[Node, Size], room: Size | None) -> float:
        """The size at which it can be drawn, 1 at the most, less a little for each crossing."""
        page, size = room or PAGE, self.box(sizes).size
        scale = min(page.width / size.width, page.height / size.height, 1.0)
        return scale / (1.0 + _CROSSING * self.crossings)


def best(
    layouts: Iterable[Layout], sizes: Mapping[Node, Size], room: Size | None, factor: float
) -> Layout:
    """The first of some layouts, or a later one that is better by a factor."""
    found, *others = layouts
    for other in others:
        if other.worth(sizes, room) > factor * found.worth(sizes, room):
            found = other
    return found


def packed(parts: Sequence[Layout], sizes: Mapping[Node, Size], room: Size | None) -> Layout:
    """Unconnected parts side by side, in rows that fill the room evenly."""
    page = room or PAGE
    boxes = [part.box(sizes) for part in parts]
    outer = [Size(b.right - b.left + 2.0 * GAP, b.top - b.bottom + 2.0 * GAP) for b in boxes]
    area = sum(size.width * size.height for size in outer)
    widest = max(*(s.width for s in outer), math.sqrt(area * page.width / page.height), 0.0)
    whole = Layout()
    x = y = row = 0.0
    for k in sorted(range(len(parts)), key=lambda k: -outer[k].height):
        if x and x + outer[k].width > widest + 1e-6:
            x, y, row = 0.0, y - row, 0.0
        whole.add(parts[k], x - boxes[k].left, y - boxes[k].top)
        x, row = x + outer[k].width, max(row, outer[k].height)
    return whole
