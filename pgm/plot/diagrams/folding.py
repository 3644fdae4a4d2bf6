"""Long pictures folded: cut into bands, one below the other, whose lines go on in the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pgm.kernels.arrays import Array
from pgm.plot.diagrams.canvas import Size
from pgm.plot.diagrams.layout import GAP, Layout, Node, best

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

    Parameters
    ----------
    whole : Layout
    sizes : mapping of node to Size
    cuts : sequence of float
        Where the picture may be cut, from left to right: no node is there.
    room : Size or None
        Of the axes; None for a page.
    """
    if whole.worth(sizes, room) > _READABLE:
        return whole
    box = whole.box(sizes)
    width = box.right - box.left
    layouts, tried = [whole], []
    for bands in range(2, 1 + min(1 + len(cuts), _MOST)):
        due = box.left + width * np.arange(1, bands) / bands
        chosen = sorted({min(cuts, key=lambda cut, at=at: abs(cut - at)) for at in due})
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
    for band in bands:
        box = band.box(sizes)
        result.add(band, 0.0, y - box.top)
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
