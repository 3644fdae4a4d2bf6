"""A canvas for diagrams, which are laid out in points so that every label fits its shape."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.patches import FancyArrowPatch, Patch
from matplotlib.text import Text
from matplotlib.textpath import text_to_path

from pgm.kernels.arrays import Array
from pgm.plot.axes import check_axes
from pgm.plot.colours import INK, MUTED

Point = tuple[float, float]

FONT = 9.0
_LINE = 1.25 * FONT
_MARGIN = 8.0
# Small diagrams are not blown up to more than this part of their own size.
_LARGEST = 1.6
# The longest side of a figure that is made, in points; larger diagrams shrink to it, but not so
# far that texts become smaller than these letters, until the figure is as large as can be.
_LONGEST, _LARGEST_SIDE = 18.0 * 72.0, 120.0 * 72.0
LEGIBLE = 5.5
_TITLE = 24.0
# How much of its ellipse a text may fill.
_FULL = 0.92


class Size(NamedTuple):
    """Width and height, in points."""

    width: float
    height: float


class Box(NamedTuple):
    """Bounds, in points."""

    left: float
    bottom: float
    right: float
    top: float

    @property
    def size(self) -> Size:
        """Width and height with the margins of the canvas."""
        return Size(self.right - self.left + 2.0 * _MARGIN, self.top - self.bottom + 2.0 * _MARGIN)


def _written(text: str) -> str:
    """A text as fonts take it: lone surrogates, which are no letters, become question marks."""
    return text.encode("utf-8", "replace").decode()


def text_size(text: str) -> Size:
    """The width and height of a text of some lines at the size `FONT`."""
    lines = _written(text).split("\n")
    fonts = *plt.rcParams["font.family"], *plt.rcParams["font.sans-serif"]
    return Size(max(_width(line, fonts) for line in lines), _LINE * len(lines))


@lru_cache(maxsize=10_000)  # a diagram asks for the same words many times
def _width(line: str, fonts: tuple[str, ...]) -> float:
    font = FontProperties(size=FONT)
    return float(text_to_path.get_text_width_height_descent(line, font, ismath=False)[0])


def slack(texts: Sequence[Size], shapes: Sequence[Size], *, round: bool = True) -> float:
    """By how much texts may grow so that the corners of each still lie in its ellipse, or box."""
    part = np.array(texts) / np.array(shapes)
    reach = np.linalg.norm(part, ord=2 if round else np.inf, axis=-1)
    return max(1.0, _FULL / float(reach.max(initial=1e-9)))


def room(ax: Axes | None) -> Size | None:
    """The size of an axes on paper, in points; None of a new figure's. Refuses what is none."""
    if ax is None:
        return None
    check_axes(ax)
    unit = 72.0 / ax.figure.dpi
    return Size(ax.bbox.width * unit, ax.bbox.height * unit)


@dataclass(frozen=True)
class Canvas:
    """An axes whose data are points of a diagram.

    scale: Points on paper for a point of the diagram; lines shrink and grow with it.
    letters: The same of texts, which shrink less where their shapes have room to spare.
    """

    ax: Axes
    scale: float
    letters: float

    def text(self, at: Point, text: str, *, colour: str = INK, size: float = FONT) -> Text:
        """Write a text about a point."""
        return self.ax.text(
            *at,
            _written(text),
            color=colour,
            fontsize=size * self.letters,
            linespacing=1.2,
            ha="center",
            va="center",
            parse_math=False,
            zorder=4.0,
        )

    def line(
        self,
        route: Array | Sequence[Point],
        style: Any = "-",
        *,
        colour: str = MUTED,
        width: float = 1.0,
    ) -> None:
        """Draw a line below all shapes."""
        x, y = np.array(route).T
        self.ax.plot(x, y, color=colour, linewidth=self.width(width), linestyle=style, zorder=1.0)

    def arrow(self, *, head: float = 9.0, zorder: float = 2.0, **between: Any) -> None:
        """Draw an arrow, as of the keywords of a `FancyArrowPatch`, with a head of some size."""
        self.ax.add_patch(
            FancyArrowPatch(
                **between,
                arrowstyle="-|>",
                mutation_scale=head * self.scale,
                linewidth=self.width(0.9),
                color=INK,
                zorder=zorder,
            )
        )

    def shape(self, patch: Patch, fill: Any, border: float) -> None:
        """Draw a shape with a border of some width, above all lines."""
        patch.set(facecolor=fill, edgecolor=INK, linewidth=self.width(border), zorder=3.0)
        self.ax.add_patch(patch)

    def width(self, points: float) -> float:
        """The width of a line."""
        return points * min(self.scale, 1.0)


def scale_of(size: Size, letters: float, paper: Size | None) -> float:
    """Points on paper for a point of a diagram; without a paper, of the figure that is made."""
    if paper is not None:
        return min(paper.width / size.width, paper.height / size.height, _LARGEST)
    longest, least = max(size), LEGIBLE / (FONT * letters)
    return min(1.0, max(_LONGEST / longest, min(least, _LARGEST_SIDE / longest)))


def readable(size: Size, letters: float, paper: Size | None) -> bool:
    """Whether the texts of a diagram are legible on a paper, or in a figure of ordinary size."""
    scale = scale_of(size, letters, paper or Size(_LONGEST, _LONGEST))
    return FONT * letters * scale >= LEGIBLE


def open_canvas(ax: Axes | None, box: Box, letters: float = 1.0) -> Canvas:
    """Make an axes, or take one, show the box in it, and hide its frame.

    In a box that must shrink, texts may be larger by the factor `letters`, up to their full size.
    """
    size, paper = box.size, room(ax)
    scale = scale_of(size, letters, paper)
    if ax is None or paper is None:
        width, height = max(size.width * scale, 72.0), max(size.height * scale, 36.0)
        ax = plt.subplots(
            figsize=(width / 72.0, (height + _TITLE) / 72.0),
            gridspec_kw={
                "left": 0.0,
                "right": 1.0,
                "bottom": 0.0,
                "top": height / (height + _TITLE),
            },
        )[1]
        paper = Size(width, height)
    x, y = 0.5 * (box.left + box.right), 0.5 * (box.bottom + box.top)
    half = 0.5 / scale
    ax.set_xlim(x - half * paper.width, x + half * paper.width)
    ax.set_ylim(y - half * paper.height, y + half * paper.height)
    ax.set_aspect("equal", adjustable="box")
    ax.axis("off")
    return Canvas(ax, scale, max(scale, min(1.0, letters * scale)))
