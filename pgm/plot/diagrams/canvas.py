"""A canvas for diagrams, laid out in points so that every label fits its shape; the labels."""

import re
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.patches import FancyArrowPatch, Patch
from matplotlib.text import Text
from matplotlib.textpath import text_to_path

from pgm.clustergraph import Cluster
from pgm.kernels.arrays import Array
from pgm.plot.drawing.axes import check_axes
from pgm.plot.drawing.colours import INK, MUTED
from pgm.variables import Variable

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
    """The bounds of a shape, in points."""

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
    """The factor by which texts may grow until a corner leaves its ellipse or box."""
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
        self.ax.add_artist(  # limits are set, and not found by `add_patch`, which takes long
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
        self.ax.add_artist(patch)

    def width(self, points: float) -> float:
        """The width of a line of text at a font size in points."""
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


# A line wider than this, in points, is broken.
_WIDEST = 84.0
_EMPTY = "∅"
# As many families that are like others are listed one by one, and as many hidden variables alike.
_LISTED, _NAMED = 5, 8
_NUMBER = re.compile(r"\d+")

# A name wider than this, in points, is broken where its words end.
_LONG_NAME = 44.0
# A word of a name wider than this is cut.
_LONGEST_WORD = 4.0 * _WIDEST


def node_label(node: Variable) -> str:
    """``x[3]``, on several lines where the name is long."""
    step = "" if node.step is None else f"[{node.step}]"
    if text_size(node.name + step).width <= _LONG_NAME:
        return node.name + step
    parts = re.split(r"(?<=[_\s.\-])", node.name)
    words = [_short(word, _LONGEST_WORD) for word in parts if word]
    lines = _filled([*words, step] if step else words, _LONG_NAME, "")
    return "\n".join(line.strip() for line in lines)


def _filled(words: Iterable[str], width: float = _WIDEST, between: str = ", ") -> list[str]:
    lines: list[str] = []
    for word in words:
        if lines and text_size(longer := f"{lines[-1]}{between}{word}").width <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def scope_label(scope: Iterable[Variable], most: int | None = None) -> str:
    """Variables, on as many lines as a narrow shape needs; those beyond `most` are counted."""
    return _text(_hidden(scope, most), most)


def cluster_label(
    cluster: Cluster,
    observed: frozenset[Variable],
    counts: Mapping[Variable, int],
    most: int | None = None,
) -> str:
    """The variables of a cluster: hidden ones first, then the observed ones, a line a family.

    Where more than a few families have others alike, whose names differ by numbers alone, these
    share a line, as ``z1…z20[3] ×38``, which is 38 measurements of twenty sensors.

    observed: Those known to be observed, as variables or as templates for all steps.
    counts: Measurements of a sensor at a step: more than one are shown as ``z[3] ×4``; a sensor
        with none is left out, and so are the observed parents that it alone has in the cluster.
    most: Variables beyond this many are only counted, as ``+5``.
    """
    known = {v for v in cluster.scope if v in observed or v.template in observed}
    hidden = [v for v in cluster.scope if v not in known]
    left = {v: None for v in cluster.scope if v in known}  # a dict keeps the order
    observations = []
    for family in cluster.families:
        group = [v for v in family if v in left]
        if group and counts.get(family[0]) != 0:
            observations.append(group)
            for v in group:
                del left[v]
    mentioned = {v for family in cluster.families for v in family}
    rest = [v for v in left if v not in mentioned]
    lines = _hidden(hidden, most)
    kinds = _alike(observations)
    if sum(len(kind) for kind in kinds if len(kind) > 2) > _LISTED:
        lines += [
            [_several(list(dict.fromkeys(column)), counts) for column in zip(*kind, strict=True)]
            for kind in kinds
        ]
    else:
        lines += [[_counted(v, counts.get(v, 1)) for v in group] for group in observations]
    return _text([*lines, [_short(repr(v)) for v in rest]], most)


def _hidden(scope: Iterable[Variable], most: int | None) -> list[list[str]]:
    """Words for variables, in groups; many alike are one, as ``m1…m20[3]``, if none is left out."""
    found = []
    for group in _by_step(scope):
        runs = [list(run) for _, run in groupby(group, lambda v: _NUMBER.sub("#", repr(v)))]
        found.append(
            [
                word
                for run in runs
                for word in (
                    [_several(run, {})]
                    if most is None and len(run) > _NAMED
                    else [_short(repr(v)) for v in run]
                )
            ]
        )
    return found


def _alike(families: Iterable[Sequence[Variable]]) -> list[list[Sequence[Variable]]]:
    """Families grouped by kind: alike if their variables' names differ in numbers alone."""
    found: dict[tuple[str, ...], list[Sequence[Variable]]] = defaultdict(list)
    for family in families:
        found[tuple(_NUMBER.sub("#", repr(v)) for v in family)].append(family)
    return list(found.values())


def _several(alike: Sequence[Variable], counts: Mapping[Variable, int]) -> str:
    """The first and the last of variables, how many where that does not say it, and readings."""
    total = sum(counts.get(v, 1) for v in alike)
    first, last = alike[0], alike[-1]
    if len(alike) <= 2:
        return ", ".join(_counted(v, counts.get(v, 1)) for v in alike)
    a, b = (_NUMBER.findall(v.name) for v in (first, last))
    text = f"{first.name}…{last!r}"
    if [int(y) - int(x) for x, y in zip(a, b, strict=True) if x != y] != [len(alike) - 1]:
        text = f"{len(alike)} of {text}"
    return text if total == len(alike) else f"{text} ×{total}"


def _by_step(scope: Iterable[Variable]) -> list[list[Variable]]:
    """Variables of different steps apart, where they do not fit on a line."""
    found = list(scope)
    if len(_filled(map(repr, found))) <= 1:
        return [found]
    steps = sorted({v.step for v in found if v.step is not None})
    return [[v for v in found if v.step == step] for step in [None, *steps]]


def _text(groups: list[list[str]], most: int | None) -> str:
    """Text lines, one group after another; a long list ends with the number of names left out."""
    count = sum(map(len, groups))
    if most is not None and count > most:
        room = most - 1
        shown = [
            group[: max(0, room - sum(map(len, groups[:k])))] for k, group in enumerate(groups)
        ]
        last = max(k for k, group in enumerate(shown) if group)
        shown[last].append(f"+{count - room}")
        groups = shown
    return "\n".join(line for group in groups for line in _filled(group)) or _EMPTY


def _counted(variable: Variable, count: int) -> str:
    return _short(repr(variable)) + ("" if count <= 1 else f" ×{count}")


def _short(name: str, width: float = _WIDEST) -> str:
    def cut(keep: int) -> str:
        return f"{name[: keep - keep // 3]}…{name[len(name) - keep // 3 :]}"

    if text_size(name).width <= width:
        return name
    # Halving, since names may have any length.
    longer = range(3, len(name))
    return cut(2 + bisect_right(longer, width, key=lambda keep: text_size(cut(keep)).width))
