"""The panels of a run: the plane of its paths and ellipses, and the chain of its clusters."""

import math
from collections.abc import Collection, Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, FancyArrowPatch, Rectangle
from matplotlib.text import Text

from pgm.compile import DynamicGraph
from pgm.factors import Gaussian
from pgm.inference import Kind
from pgm.kernels.arrays import Array
from pgm.plot.diagrams.canvas import (
    Box,
    Canvas,
    Size,
    open_canvas,
    readable,
    room,
    scope_label,
    text_size,
)
from pgm.plot.diagrams.clusters import cluster_name, message_name
from pgm.plot.diagrams.contents import contents
from pgm.plot.drawing.colours import INK, MUTED, PALETTE, SEPSET

# A pass of more steps than this skips some.
_PICTURES = 100


class Frame(NamedTuple):
    """One picture of a run.

    back: Whether messages flow back, to the left.
    filtered: The last step that is filtered by now; all before are too.
    revised: The first and the last step whose belief later measurements have revised by now; the
        first is beyond the last where there is none.
    """

    step: int
    back: bool
    filtered: int
    revised: tuple[int, int]


def frames(kind: Kind, last: int, every: int | None) -> list[Frame]:
    """The pictures of a run in their order.

    A filter goes forward; a smoother then comes back; with a fixed lag each step forward revises
    the belief of the step so far behind.

    every: Steps from a picture to the next; as many as leave at most 100 a pass without.
    """
    every = every or max(1, math.ceil(last / _PICTURES))
    forward = [*range(0, last, every), last]
    return [*_forward(kind, forward), *_backward(kind, forward)]


def _forward(kind: Kind, steps: list[int]) -> Iterator[Frame]:
    for step in steps:
        behind = -1 if math.isinf(kind.lag) or not kind.lag else step - int(kind.lag)
        if step == steps[-1] and behind >= 0:
            behind = step  # no measurement is to come
        yield Frame(step, False, step, (0, behind))


def _backward(kind: Kind, steps: list[int]) -> Iterator[Frame]:
    if math.isinf(kind.lag):
        for step in reversed(steps):
            yield Frame(step, True, steps[-1], (step, steps[-1]))


FILTERED, REVISED = PALETTE[0], PALETTE[1]
_ELLIPSES = 25
_TURN = np.linspace(0.0, 2.0 * np.pi, 49)
_MARGIN = 0.06


class Trace:
    """A belief's path so far with some ellipses, the newest of them marked."""

    def __init__(
        self, ax: Axes, belief: Gaussian, pair: tuple[str, str], confidence: float, colour: str
    ) -> None:
        found = belief.ellipse(confidence, pair)
        self.centres: Array = found.centre
        self.rings = _rings(found.centre, found.half_axes, found.orientation)
        self._every = max(1, math.ceil(len(self.centres) / _ELLIPSES))
        (self._line,) = ax.plot([], [], color=colour, lw=1.8, zorder=2.3)
        self._past = PolyCollection(
            [], facecolor=to_rgba(colour, 0.08), edgecolor=to_rgba(colour, 0.45), lw=0.8, zorder=1.8
        )
        self._newest = PolyCollection(
            [], facecolor=to_rgba(colour, 0.25), edgecolor=colour, lw=1.8, zorder=2.5
        )
        (self._dot,) = ax.plot([], [], "o", color=colour, markersize=5, zorder=2.6)
        for collection in (self._past, self._newest):
            ax.add_collection(collection, autolim=False)

    @property
    def artists(self) -> list[Artist]:
        """Everything that changes."""
        return [self._line, self._past, self._newest, self._dot]

    def show(self, path: range, ellipses: Collection[int], newest: int | None) -> None:
        """Show the path over some steps, ellipses at some of them, and the newest ellipse."""
        self._line.set_data(*self.centres[path].T)
        drawn = [step for step in ellipses if step % self._every == 0 and step != newest]
        self._past.set_verts(list(self.rings[drawn]))
        here = [] if newest is None or newest not in ellipses else [newest]
        self._newest.set_verts(list(self.rings[here]))
        self._dot.set_data(*self.centres[here].T)


class Paths:
    """The beliefs of a run in the plane.

    beliefs: Filtered, and as the posterior has them.
    truth: (T+1, 2).
    landmarks: (L, 2).
    """

    def __init__(
        self,
        ax: Axes,
        beliefs: tuple[Gaussian, Gaussian],
        kind: Kind,
        pair: tuple[str, str],
        truth: Array | None,
        landmarks: Array | None,
        confidence: float,
    ) -> None:
        marks: list[Artist] = []
        if landmarks is not None:
            marks += ax.plot(*landmarks.T, "^", color=INK, markersize=6, label="landmarks")
        if truth is not None:
            marks += ax.plot(*truth.T, color=INK, lw=0.8, zorder=2.0, label="truth")
        self._filtered = Trace(ax, beliefs[0], pair, confidence, FILTERED)
        marks.append(Line2D([], [], color=FILTERED, lw=1.8, label="filtered"))
        self._revised: Trace | None = None
        if kind.lag:
            self._revised = Trace(ax, beliefs[1], pair, confidence, REVISED)
            marks.append(Line2D([], [], color=REVISED, lw=1.8, label=str(kind)))
        marks.append(
            Line2D(
                [],
                [],
                ls="",
                marker="o",
                markersize=9,
                fillstyle="none",
                color=MUTED,
                label=f"{100.0 * confidence:.4g} % ellipses",
            )
        )
        traces = [trace for trace in (self._filtered, self._revised) if trace]
        _limit(ax, traces, [each for each in (truth, landmarks) if each is not None])
        self.marks = marks

    @property
    def artists(self) -> list[Artist]:
        """Everything that changes."""
        return self._filtered.artists + (self._revised.artists if self._revised else [])

    def show(self, frame: Frame) -> None:
        """Show the paths up to a picture's steps."""
        path, revised = range(frame.filtered + 1), range(frame.revised[0], frame.revised[1] + 1)
        # A revised ellipse takes the place of the filtered one.
        standing = [step for step in path if step not in revised]
        self._filtered.show(path, standing, None if frame.back else frame.step)
        if self._revised is not None:
            newest = frame.revised[0 if frame.back else 1]
            self._revised.show(revised, revised, newest)


def _rings(centre: Array, half_axes: Array, orientation: Array) -> Array:
    """The outlines of ellipses (T+1, P, 2); NaN, which is not drawn, where one is endless."""
    cos, sin = np.cos(orientation)[:, None], np.sin(orientation)[:, None]
    with np.errstate(invalid="ignore"):
        along, across = (half_axes[:, k, None] * f(_TURN) for k, f in enumerate((np.cos, np.sin)))
        turned = np.stack([cos * along - sin * across, sin * along + cos * across], axis=-1)
        rings: Array = centre[:, None] + turned
    rings[~np.isfinite(rings).all(axis=(1, 2))] = np.nan
    return rings


def _limit(ax: Axes, traces: list[Trace], marks: list[Array]) -> None:
    """Limits about paths and marks, and ellipses no larger than these or the middle ellipse."""
    points = np.concatenate([*(trace.centres for trace in traces), *marks])
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    rings = np.concatenate([trace.rings for trace in traces])
    extents = np.ptp(rings, axis=1).max(axis=1)
    known = extents[np.isfinite(extents)]
    # Of a robot that stands still the ellipses are larger than its path.
    small = extents <= max(float((high - low).max()), np.median(known) if known.size else 0.0)
    if small.any():
        low = np.minimum(low, rings[small].min(axis=(0, 1)))
        high = np.maximum(high, rings[small].max(axis=(0, 1)))
    # One unit is as long in x as in y.
    paper = np.array([ax.bbox.width, ax.bbox.height])
    unit = float(((high - low) / paper).max()) or 1e-9
    half = 0.5 * (1.0 + 2.0 * _MARGIN) * unit * paper
    low, high = 0.5 * (low + high) - half, 0.5 * (low + high) + half
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


_GAP, _AWAY, _APART = 8.0, 6.0, 3.0
_ARROW, _HEAD = 26.0, 9.0
_DOTS = 14.0  # room for the dots at an end
_LIT, _DONE = 0.6, 0.2  # of a pass's colour in a cluster
# Where letters would be too small there are fewer clusters, down to so many; where that does not
# do, sepsets name fewer variables, and clusters none.
_FEW, _SHORT = 3, 2


class Flow:
    """The arrow and the name of a message over a sepset, or below it."""

    def __init__(self, canvas: Canvas, at: tuple[float, float], plate: float, way: int) -> None:
        x, y = at
        level = y + way * (0.5 * plate + _AWAY)
        self.arrow = FancyArrowPatch(
            (x - 0.5 * way * _ARROW, level),
            (x + 0.5 * way * _ARROW, level),
            arrowstyle="-|>",
            shrinkA=0.0,
            shrinkB=0.0,
            mutation_scale=_HEAD * canvas.scale,
            zorder=4.0,
        )
        canvas.ax.add_patch(self.arrow)
        beyond = level + way * (_APART + 0.5 * text_size("δ").height)
        self.text = canvas.text((x, beyond), "")
        self._way, self._width = way, canvas.width

    def show(self, left: int, sent: bool, newest: bool, colour: str) -> None:
        """Show the message between two clusters, once it is sent."""
        pair = (left, left + 1) if self._way > 0 else (left + 1, left)
        self.text.set(
            text=message_name(*pair) if sent else "",
            color=colour if newest else INK,
            weight="bold" if newest else "normal",
        )
        self.arrow.set(
            visible=sent,
            color=colour if newest else MUTED,
            linewidth=self._width(2.2 if newest else 1.0),
        )


class Chain:
    """Clusters of a chain, as many as there is room for, around the one at work."""

    def __init__(
        self, ax: Axes, graph: DynamicGraph, most: int, colours: tuple[str, str], both: bool
    ) -> None:
        self._graph, self._colours = graph, colours
        most = min(most, graph.steps + 1)
        counts = range(most, min(most, _FEW) - 1, -1)
        for self._named, self._count in product((True, False), counts):
            self._labels: dict[int, str] = {}
            widest, plate, pitch, box = self._measured()
            if readable(box.size, 1.0, room(ax)):
                break
        canvas = open_canvas(ax, box)
        if self._count > 1:
            canvas.line([(0.0, 0.0), (pitch * (self._count - 1), 0.0)])
        self._dots = [
            canvas.text((x, 0.0), "…", colour=MUTED)
            for x in (box.left + 0.3 * _DOTS, box.right - 0.3 * _DOTS)
        ]
        self._ovals: list[Ellipse] = []
        self._texts: list[Text] = []
        self._plates: list[Text] = []
        self._flows: list[tuple[Flow, ...]] = []
        for slot in range(self._count):
            at = pitch * slot, 0.0
            oval = Ellipse(at, *widest)
            canvas.shape(oval, "white", 1.0)
            self._ovals.append(oval)
            self._texts.append(canvas.text(at, ""))
            if slot + 1 < self._count:
                middle = at[0] + 0.5 * pitch, 0.0
                corner = middle[0] - 0.5 * plate.width, -0.5 * plate.height
                canvas.shape(Rectangle(corner, *plate), SEPSET, 0.8)
                self._plates.append(canvas.text(middle, ""))
                ways = (1, -1) if both else (1,)
                self._flows.append(tuple(Flow(canvas, middle, plate.height, w) for w in ways))

    def _measured(self) -> tuple[Size, Size, float, Box]:
        last = self._graph.steps
        widest = _oval([self._label(k) for k in {0, min(1, last), last}])
        plate = _plate([self._shared(k) for k in {0, last - 1} if 0 <= k < last])
        name = text_size(message_name(last, last))
        pitch = widest.width + max(plate.width, name.width, _ARROW) + 2.0 * _GAP
        half = max(
            0.5 * widest.height,
            0.5 * plate.height + _AWAY + _APART + name.height if last else 0.0,
        )
        across = 0.5 * widest.width + _DOTS
        return widest, plate, pitch, Box(-across, -half, pitch * (self._count - 1) + across, half)

    @property
    def artists(self) -> list[Artist]:
        """Everything that changes, from below to above."""
        flows = [part for slot in self._flows for f in slot for part in (f.arrow, f.text)]
        return [*self._dots, *self._ovals, *flows, *self._texts, *self._plates]

    def show(self, frame: Frame) -> None:
        """Show the clusters about the one at work, and the messages sent so far."""
        last = self._graph.steps
        start = min(max(frame.step - self._count // 2, 0), last + 1 - self._count)
        for dots, more in zip(self._dots, (start > 0, start + self._count <= last), strict=True):
            dots.set_visible(more)
        colour = self._colours[frame.back]
        for slot, (oval, text) in enumerate(zip(self._ovals, self._texts, strict=True)):
            k = start + slot
            if k == frame.step:
                fill = tint(colour, _LIT)
            elif frame.revised[0] <= k <= frame.revised[1]:
                fill = tint(self._colours[1], _DONE)
            else:
                fill = tint(self._colours[0], _DONE if k <= frame.filtered else 0.0)
            oval.set(facecolor=fill, edgecolor=colour if k == frame.step else INK)
            oval.set_linewidth(2.2 if k == frame.step else 1.0)
            text.set_text(self._label(k))
        for slot, (plate, flows) in enumerate(zip(self._plates, self._flows, strict=True)):
            k = start + slot
            plate.set_text(self._shared(k))
            self._show_flows(flows, k, frame)

    def _show_flows(self, flows: tuple[Flow, ...], left: int, frame: Frame) -> None:
        sent = left < frame.filtered
        flows[0].show(
            left, sent, sent and not frame.back and left == frame.step - 1, self._colours[0]
        )
        if len(flows) > 1:
            sent = frame.back and left >= frame.step
            flows[1].show(left, sent, sent and left == frame.step, self._colours[1])

    def _label(self, index: int) -> str:
        if index not in self._labels:
            self._labels[index] = cluster_name(index)
            if self._named:
                cluster = self._graph.clusters[index]
                text = contents(self._graph, [cluster], {}, None, False)[index]
                self._labels[index] += f"\n{text}"
        return self._labels[index]

    def _shared(self, left: int) -> str:
        return scope_label(self._graph.sepsets[left, left + 1], None if self._named else _SHORT)


def tint(colour: str, part: float) -> tuple[float, float, float]:
    """A colour mixed with white, which lets no line shine through."""
    red, green, blue = (1.0 - part * (1.0 - channel) for channel in to_rgb(colour))
    return red, green, blue


def _oval(texts: list[str]) -> Size:
    sizes = [text_size(text) for text in texts]
    return Size(1.41 * max(s.width for s in sizes) + 8.0, 1.41 * max(s.height for s in sizes) + 6.0)


def _plate(texts: list[str]) -> Size:
    sizes = [text_size(text) for text in texts] or [Size(0.0, 0.0)]
    return Size(max(s.width for s in sizes) + 8.0, max(s.height for s in sizes) + 5.0)
