"""The plane of a run: the path and the ellipses of the filter, and of the beliefs revised later."""

import math
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D

from pgm.factors import Gaussian
from pgm.inference import Kind
from pgm.kernels.arrays import Array
from pgm.plot.colours import INK, MUTED, PALETTE

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
    """A belief's path so far, some of its ellipses, and the newest of them."""

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
        """Show the path over some steps, ellipses of some, and one of them as the newest."""
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
        """Show what is known by a picture."""
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
