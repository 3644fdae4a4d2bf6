"""The places of shapes and the course of lines, in points, y upwards; long ones are folded."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pgm.kernels.arrays import Array
from pgm.plot.diagrams.canvas import Box, Point, Size


def distances(points: Array, start: Array, end: Array) -> Array:
    """Distances of points (P, 2) from segments (E, 2) to (E, 2), as (E, P)."""
    along = (end - start)[:, None]
    offset = points - start[:, None]
    square = np.maximum((along * along).sum(axis=-1), 1e-12)
    part = np.clip((offset * along).sum(axis=-1) / square, 0.0, 1.0)
    distance: Array = np.linalg.norm(offset - part[..., None] * along, axis=-1)
    return distance


Node = Hashable

GAP = 12.0
# A page, where no axes says how much room there is.
PAGE = Size(12.0 * 72.0, 8.0 * 72.0)
# How much smaller a picture may be for each crossing that it spares.
_CROSSING = 0.02


@dataclass(eq=False)
class Layout:
    """A picture before it is drawn.

    lines: (P, 2): what joins them.
    loose: (P, 2): parts of lines that begin or go on elsewhere, in pictures that are folded.
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
    """The first layout, unless a later one is better by a factor."""
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


_MOST = 16
# A picture is folded where it would else be smaller than this part of its size.
_READABLE = 0.6
# More bands must make the picture larger by this factor.
_BETTER = 1.2


def folded(
    whole: Layout, sizes: Mapping[Node, Size], cuts: Sequence[float], room: Size | None
) -> Layout:
    """A picture in as many bands as use the room best; most pictures are left as they are.

    A line that is cut ends at the right of a band, and goes on at the left of the next, at the
    same height.

    cuts: Where the picture may be cut, from left to right: no node is there.
    room: Of the axes; None for a page.
    """
    if whole.worth(sizes, room) > _READABLE:
        return whole
    box = whole.box(sizes)
    width = box.right - box.left
    layouts, tried = [whole], []
    for bands in range(2, 1 + min(1 + len(cuts), _MOST)):
        due = box.left + width * np.arange(1, bands) / bands
        nearest = np.abs(np.subtract.outer(due, cuts)).argmin(axis=1)
        chosen = sorted({cuts[k] for k in nearest})
        if chosen not in tried:
            tried.append(chosen)
            layouts.append(_fold(whole, sizes, chosen, box.left))
    return best(layouts, sizes, room, _BETTER)


def gaps(whole: Layout, sizes: Mapping[Node, Size]) -> list[float]:
    """The middles of the vertical strips in which no node stands."""
    found = []
    reached = -np.inf
    for left, right in sorted(
        (x - 0.5 * sizes[node].width, x + 0.5 * sizes[node].width)
        for node, (x, _) in whole.points.items()
    ):
        if np.isfinite(reached) and left > reached + 0.5 * GAP:
            found.append(0.5 * (left + reached))
        reached = max(reached, right)
    return found


def _fold(whole: Layout, sizes: Mapping[Node, Size], cuts: list[float], left: float) -> Layout:
    bands = [Layout() for _ in range(len(cuts) + 1)]
    begin = [left, *cuts]
    for node, (x, y) in whole.points.items():
        k = int(np.searchsorted(cuts, x))
        bands[k].points[node] = (x - begin[k] + left, y)
    for edge, curve in whole.lines.items():
        pieces = _cut(curve, cuts)
        k = _main(pieces, whole.points.get(edge))
        for number, (band, piece) in enumerate(pieces):
            shifted = piece - (begin[band] - left, 0.0)
            if number == k:
                bands[band].lines[edge] = shifted
            else:
                bands[band].loose.append(shifted)
    result, y = Layout(crossings=whole.crossings), 0.0
    for part in bands:
        box = part.box(sizes)
        result.add(part, 0.0, y - box.top)
        y -= box.top - box.bottom + 3.0 * GAP
    return result


def _cut(curve: Array, cuts: list[float]) -> list[tuple[int, Array]]:
    """The pieces of a line (P, 2), each with the number of its band."""
    places = [np.arange(len(curve), dtype=float)]
    for cut in cuts:
        a, b = curve[:-1, 0] - cut, curve[1:, 0] - cut
        crossing = np.flatnonzero(a * b < 0.0)
        places.append(crossing + a[crossing] / (a[crossing] - b[crossing]))
    at = np.unique(np.concatenate(places))
    points = np.stack([np.interp(at, places[0], column) for column in curve.T], axis=-1)
    band = np.searchsorted(cuts, 0.5 * (points[:-1, 0] + points[1:, 0]))
    ends = np.flatnonzero(np.diff(band)) + 1
    starts = [0, *ends.tolist()]
    return [
        (int(band[start]), points[start : end + 1])
        for start, end in zip(starts, [*ends.tolist(), len(points) - 1], strict=True)
    ]


def _main(pieces: list[tuple[int, Array]], through: tuple[float, float] | None) -> int:
    """The number of the piece that stands for all: the one through a place, or the last."""
    if through is None:
        return len(pieces) - 1
    away = [np.linalg.norm(piece - through, axis=-1).min() for _, piece in pieces]
    return int(np.argmin(away))
