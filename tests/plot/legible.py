"""What a program can tell of a picture's legibility: nothing cut, covered, alike or too small.

``assert_legible(figure)`` is for any picture that is drawn with matplotlib; ``faults`` lists what
it finds. A diagram is an axes without a frame: texts and shapes, and lines between these. A plot
is an axes with one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection, EllipseCollection
from matplotlib.colors import to_hex
from matplotlib.container import StemContainer
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, FancyArrowPatch, Patch
from matplotlib.text import Text
from matplotlib.transforms import Bbox

# The least size of letters on the written picture, in points.
LETTERS = 5.0
# What may lie over the edge or over each other, in dots.
_TOUCH = 1.5


def assert_legible(drawn: Figure | Axes, *, letters: float = LETTERS, whole: bool = True) -> None:
    """Refuse a picture with faults.

    Parameters
    ----------
    drawn : Figure or Axes
        An axes stands for its figure.
    letters : float
        The least size of letters, in points.
    whole : bool
        Whether each plot is to show all of its curves; one that is zoomed in does not.
    """
    found = faults(drawn, letters=letters, whole=whole)
    assert not found, "\n".join(found)


def faults(drawn: Figure | Axes, *, letters: float = LETTERS, whole: bool = True) -> list[str]:
    """The faults of a picture, each in words."""
    figure = drawn if isinstance(drawn, Figure) else drawn.figure
    figure.canvas.draw()
    texts = _texts(figure)
    found = [*_cut(figure, texts), *_small(texts, letters), *_on_each_other(texts)]
    for ax in _axes(figure):
        found += _diagram(ax) if not ax.axison else _plot(ax, whole)
    return found


def smallest(drawn: Figure | Axes) -> float:
    """The size of the smallest letters of a picture, in points."""
    figure = drawn if isinstance(drawn, Figure) else drawn.figure
    figure.canvas.draw()
    return min((text.get_fontsize() for text in _texts(figure)), default=np.inf)


def _axes(figure: Figure) -> list[Axes]:
    """All axes, insets included."""
    return [ax for ax in figure.findobj(Axes) if ax.get_visible()]


def _texts(figure: Figure) -> list[Text]:
    """The texts that are seen."""
    unseen = set()
    for ax in _axes(figure):
        for axis in (ax.xaxis, ax.yaxis):
            ticks = {*axis.get_major_ticks(), *axis.get_minor_ticks()}
            drawn = set(axis._update_ticks()) if ax.axison and axis.get_visible() else set()
            for tick in ticks - drawn:
                unseen |= {tick.label1, tick.label2}
            if not ax.axison:
                unseen |= {axis.label, axis.offsetText}
    return [
        text
        for text in figure.findobj(Text)
        if text not in unseen and text.get_visible() and text.get_text().strip()
    ]


def _cut(figure: Figure, texts: Sequence[Text]) -> Iterator[str]:
    """Texts and legends that leave the figure."""
    things: list[Artist] = [*texts, *figure.findobj(Legend)]
    for thing in things:
        if not _within(thing.get_window_extent(), figure.bbox):
            yield f"{_called(thing)} leaves the figure"


def _small(texts: Sequence[Text], letters: float) -> Iterator[str]:
    for text in texts:
        if text.get_fontsize() < letters - 1e-6:
            yield f"{_called(text)} has letters of {text.get_fontsize():.2g} pt"


def _on_each_other(every: Sequence[Text]) -> Iterator[str]:
    """Texts that overlap."""
    texts = [text for text in every if text.get_rotation() % 90.0 == 0.0]
    boxes = _boxes(texts)
    for k, text in enumerate(texts):
        for j in _overlapping(boxes[k], boxes[k + 1 :]):
            yield f"{_called(text)} lies on {_called(texts[k + 1 + j])}"


# --- diagrams: shapes, texts in or beside them, lines between them


def _diagram(ax: Axes) -> Iterator[str]:
    shapes = [p for p in ax.patches if not isinstance(p, FancyArrowPatch) and p.get_visible()]
    lines: list[FancyArrowPatch | Line2D] = [
        *(p for p in ax.patches if isinstance(p, FancyArrowPatch)),
        *(line for line in ax.lines if line.get_visible()),
    ]
    for thing in [*shapes, *lines]:
        if not _within(_extent(thing), ax.figure.bbox):
            yield f"{_called(thing)} leaves the figure"
    outlines = _boxes(shapes)
    for k, shape in enumerate(shapes):
        for j in _overlapping(outlines[k], outlines[k + 1 :]):
            yield f"{_called(shape)} lies on {_called(shapes[k + 1 + j])}"
    texts = [text for text in ax.texts if text.get_visible() and text.get_text().strip()]
    words = _boxes(texts)
    for text, box in zip(texts, words, strict=True):
        for k in _overlapping(box, outlines):
            if not _within(Bbox([box[:2], box[2:]]), Bbox([outlines[k, :2], outlines[k, 2:]])):
                yield f"{_called(text)} lies on the edge of {_called(shapes[k])}"
    for line in lines:
        course = _course(line)
        hidden = np.zeros(len(course), dtype=bool)
        whole = np.concatenate([course.min(axis=0) - _TOUCH, course.max(axis=0) + _TOUCH])
        for k in _overlapping(whole, outlines):
            inside = _inside(course, shapes[k], outlines[k])
            if not inside.any():
                continue
            # Lines are joined to the middle of shapes that hide them.
            centre = 0.5 * (outlines[k, :2] + outlines[k, 2:])
            joined = inside[0] or inside[-1] or _near(course, centre)
            if line.get_zorder() < shapes[k].get_zorder() and joined:
                hidden |= inside
            else:
                yield f"{_called(line)} runs through {_called(shapes[k])}"
        for k in _overlapping(whole, words):
            over = ((course > words[k, :2] + _TOUCH) & (course < words[k, 2:] - _TOUCH)).all(
                axis=-1
            )
            if (over & ~hidden).any():
                yield f"{_called(line)} runs over {_called(texts[k])}"


def _boxes(things: Sequence[Artist]) -> np.ndarray:
    """Left, bottom, right and top of each, (n, 4), in dots."""
    return np.array([thing.get_window_extent().extents for thing in things]).reshape(-1, 4)


def _overlapping(box: np.ndarray, others: np.ndarray) -> np.ndarray:
    """The numbers of boxes (n, 4) on which one lies by more than a touch."""
    low = np.maximum(box[:2], others[:, :2])
    high = np.minimum(box[2:], others[:, 2:])
    return np.flatnonzero((high - low > 2.0 * _TOUCH).all(axis=-1))


def _near(course: np.ndarray, point: np.ndarray) -> bool:
    return bool(np.linalg.norm(course - point, axis=-1).min() < 2.0)


def _course(line: FancyArrowPatch | Line2D) -> np.ndarray:
    """Points along a line, a dot or so apart, in dots."""
    if isinstance(line, Line2D):
        points = line.get_transform().transform(line.get_xydata())
    else:
        path = line.get_path().interpolated(1)
        points = line.get_transform().transform(np.concatenate(path.to_polygons(closed_only=False)))
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    way = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.linspace(0.0, way[-1], 2 + int(way[-1]))
    return np.stack([np.interp(at, way, column) for column in points.T], axis=-1)


def _inside(points: np.ndarray, shape: Patch, box: np.ndarray) -> np.ndarray:
    """Which points lie in a shape of some bounds, by more than a border's width."""
    half = np.maximum(0.5 * (box[2:] - box[:2]) - 2.0 * _TOUCH, 1e-9)
    offset = np.abs(points - 0.5 * (box[:2] + box[2:])) / half
    reach = np.linalg.norm(offset, ord=2 if isinstance(shape, Ellipse) else np.inf, axis=-1)
    return reach < 1.0


# --- plots: curves in a frame, and their legend


def _plot(ax: Axes, whole: bool) -> Iterator[str]:
    legend = ax.get_legend()
    if whole:
        yield from _outside(ax)
    if legend is None or not legend.get_visible():
        return
    labels = Counter(text.get_text() for text in legend.get_texts())
    yield from (f"the legend has {label!r} twice" for label, n in labels.items() if n > 1)
    series = {
        (label, _look(handle))
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
        if label in labels
    }
    looks = Counter(look for _, look in series)
    yield from (f"series look alike in the legend: {look}" for look, n in looks.items() if n > 1)
    if _hides(ax, legend):
        yield f"the legend of {_called(ax)} hides something, though there is a free place"


def _outside(ax: Axes) -> Iterator[str]:
    """Curves of which a part is not shown."""
    frame = ax.get_window_extent()
    for line in ax.lines:
        if line.get_transform() == ax.transData and line.get_visible():
            points = line.get_transform().transform(line.get_xydata())
            points = points[np.isfinite(points).all(axis=-1)]
            if len(points) and not _within(Bbox([points.min(axis=0), points.max(axis=0)]), frame):
                yield f"{_called(line)} leaves {_called(ax)}"
    for collection in ax.collections:
        if isinstance(collection, EllipseCollection):
            extent = collection.get_window_extent()
            if np.isfinite(extent.bounds).all() and not _within(extent, frame):
                yield f"ellipses leave {_called(ax)}"


def _look(handle: Any) -> str:
    """The look of a series, in words."""
    if isinstance(handle, StemContainer):
        handle = handle.markerline
    if isinstance(handle, Line2D):
        width = handle.get_linewidth()
        return (
            f"{to_hex(handle.get_color())} {handle.get_linestyle()} {handle.get_marker()} {width}"
        )
    if isinstance(handle, Patch | Collection):
        parts = (handle.get_facecolor(), handle.get_edgecolor(), handle.get_linestyle())
        return " ".join(np.array2string(np.array(part, dtype=object)) for part in parts)
    return repr(handle)


def _hides(ax: Axes, legend: Legend) -> bool:
    """Whether a legend lies on something that is drawn, and another place in the axes is free."""
    box = legend.get_window_extent()
    if not len(_overlapping(box.extents, ax.get_window_extent().extents[None])):
        return False
    figure = ax.figure
    legend.set_visible(False)
    figure.canvas.draw()
    picture = np.asarray(figure.canvas.buffer_rgba())[::-1, :, :3].astype(int)
    legend.set_visible(True)
    frame = ax.get_window_extent()
    x0, y0, x1, y1 = (round(v) for v in (*(frame.min + 2.0), *(frame.max - 2.0)))
    inked = (picture[y0:y1, x0:x1] != 255).any(axis=-1)
    total = np.pad(inked.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    high, wide = (min(int(a), b) for a, b in ((box.height, y1 - y0), (box.width, x1 - x0)))
    ink = total[high:, wide:] - total[:-high, wide:] - total[high:, :-wide] + total[:-high, :-wide]
    row = int(np.clip(box.y0 - y0, 0, len(ink) - 1))
    column = int(np.clip(box.x0 - x0, 0, ink.shape[1] - 1))
    return bool(ink[row, column] > 0 and (ink == 0).any())


# --- boxes and names


def _extent(thing: Artist) -> Bbox:
    if isinstance(thing, Line2D):
        points = thing.get_transform().transform(thing.get_xydata())
        return Bbox([points.min(axis=0), points.max(axis=0)])
    return thing.get_window_extent()


def _within(inner: Bbox, outer: Bbox) -> bool:
    low, high = outer.min - _TOUCH, outer.max + _TOUCH
    return bool((inner.min >= low).all() and (inner.max <= high).all())


def _called(thing: Artist) -> str:
    """A name for an artist that a reader of the picture can find."""
    if isinstance(thing, Text):
        return f"the text {thing.get_text()!r}"
    if isinstance(thing, Axes):
        return f"the axes {thing.get_title() or thing.get_ylabel()!r}"
    if isinstance(thing, Patch):
        texts = thing.axes.texts if thing.axes else []
        near = [t for t in texts if _within(t.get_window_extent(), thing.get_window_extent())]
        box = thing.get_window_extent()
        at = np.round(0.5 * (box.min + box.max)).astype(int).tolist()
        return f"{type(thing).__name__} {[t.get_text() for t in near][:1]} at {at}"
    return f"{type(thing).__name__} {getattr(thing, 'get_label', str)()!r}"
