"""A window of a chain of clusters, in which the cluster at work is lit and messages flow."""

from itertools import product

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Ellipse, FancyArrowPatch, Rectangle
from matplotlib.text import Text

from pgm.compile import DynamicGraph
from pgm.plot.colours import INK, MUTED, SEPSET
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
from pgm.plot.moving.paths import Frame

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
    """As many clusters of a chain as there is room for, the one at work in the middle."""

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
