"""Colours that stand for numbers: of clusters by size, of sepsets by residual."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.ticker import MaxNLocator, NullFormatter

from pgm.clustergraph import ClusterGraph
from pgm.clustergraph.cluster import Edge, is_discrete, size
from pgm.errors import GraphError
from pgm.factors.scope import Scope
from pgm.plot.diagrams.canvas import FONT, Box, Canvas
from pgm.plot.diagrams.layout import Node
from pgm.plot.drawing.colours import INK, SCALE

# Sizes that differ by more than this factor have a logarithmic scale.
_WIDE = 30.0
# Larger tables have the same colour: the axis of a bar cannot reach much further.
_HUGE = 10**200
# Residuals are changes in standard deviations; smaller ones are rounding errors.
ROUNDING = 1e-13
_BAR = 9.0
_BELOW = 46.0
_LONGEST_BAR = 220.0
_SHORTEST_BAR = 90.0

Colour = tuple[float, float, float, float]


@dataclass(frozen=True)
class Shading:
    """Colours of shapes, and the bar that explains them.

    values: Of the clusters, by index, or the sepsets, by edge.
    nothing: The largest value that stands for nothing.
    """

    values: dict[Node, float]
    norm: Normalize
    label: str
    nothing: float = -np.inf

    def __getitem__(self, node: Node) -> Colour | None:
        """The colour of a shape, white where its value is nothing; None where it has none."""
        if node not in self.values:
            return None
        if self.values[node] <= self.nothing:
            return 1.0, 1.0, 1.0, 1.0
        r, g, b, a = SCALE(float(self.norm(self.values[node])))
        return r, g, b, a

    def bar_box(self, box: Box) -> Box:
        """A box with room for the bar, below."""
        middle, half = 0.5 * (box.left + box.right), 0.5 * _SHORTEST_BAR
        left, right = min(box.left, middle - half), max(box.right, middle + half)
        return Box(left, box.bottom - _BELOW, right, box.top)

    def draw_bar(self, canvas: Canvas, box: Box) -> None:
        """Draw the bar at the bottom of the box of `bar_box`; its label alone if all is nothing."""
        length = min(max(_SHORTEST_BAR, 0.5 * (box.right - box.left)), _LONGEST_BAR)
        left = 0.5 * (box.left + box.right - length)
        letters = 0.85 * FONT * canvas.letters
        if all(value <= self.nothing for value in self.values.values()):
            middle = 0.5 * (box.left + box.right), box.bottom + 0.4 * _BELOW
            canvas.text(middle, self.label, size=0.85 * FONT)
            return
        place = canvas.ax.inset_axes(
            (left, box.bottom + 26.0, length, _BAR), transform=canvas.ax.transData
        )
        shown = ScalarMappable(self.norm, SCALE)
        bar = canvas.ax.figure.colorbar(shown, cax=place, orientation="horizontal")
        bar.outline.set_linewidth(canvas.width(0.8))
        if not isinstance(self.norm, LogNorm):
            bar.locator = MaxNLocator(5, integer=True)
            bar.update_ticks()
        else:
            # Over a decade or two matplotlib would name the ticks between, one over the other.
            place.xaxis.set_minor_formatter(NullFormatter())
            if ticks := _within_decades(float(self.norm.vmin or 0.0), float(self.norm.vmax or 0.0)):
                bar.set_ticks(ticks, labels=[f"{tick:.3g}" for tick in ticks])
        for which in ("major", "minor"):
            place.tick_params(
                which=which,
                labelsize=letters,
                length=canvas.width(3.0 if which == "major" else 1.5),
                width=canvas.width(0.8),
                pad=canvas.width(1.5),
                labelcolor=INK,
            )
        bar.set_label(self.label, size=letters, color=INK, labelpad=canvas.width(1.0))


def by_size(scopes: Mapping[int, Scope]) -> Shading:
    """Clusters by their number of components, or of table entries."""
    values: dict[Node, float] = {k: float(min(size(s), _HUGE)) for k, s in scopes.items()}
    least, most = max(min(values.values()), 1.0), max(*values.values(), 1.0)
    discrete = any(map(is_discrete, scopes.values()))
    norm = _log(least, most) if most > _WIDE * least else Normalize(min(least, most - 1.0), most)
    return Shading(values, norm, "table entries" if discrete else "components")


def by_residual(
    graph: ClusterGraph, shown: Mapping[Edge, Scope], residuals: Mapping[Edge, npt.ArrayLike]
) -> Shading:
    """Sepsets by how much their messages still change: the most of either way and of all runs."""
    if not isinstance(residuals, Mapping):
        raise GraphError(
            f"residuals map pairs of clusters to numbers; found {type(residuals).__name__}"
        )
    if graph.sepsets and not residuals:
        raise GraphError(
            "residuals are of no pair of clusters; those of a run with a schedule for any graph, "
            "like pgm.Flooding(), are its status.by_edge, while the calibration of a tree leaves "
            "none"
        )
    values: dict[Node, float] = {}
    for pair, value in residuals.items():
        edge = tuple(sorted(pair)) if isinstance(pair, tuple) else pair
        if edge not in graph.sepsets:
            raise GraphError(f"residuals name {pair!r}, which is no pair of joined clusters")
        array = np.asarray(value, dtype=float)
        if not array.size or not (array >= 0.0).all():
            raise GraphError(f"the residual of {pair!r} is {value!r}; 0 or more was due")
        values[edge] = max(values.get(edge, 0.0), float(array.max()))
    values = {edge: value for edge, value in values.items() if edge in shown}
    finite = [value for value in values.values() if ROUNDING < value < np.inf]
    label = "residual"
    if any(value <= ROUNDING for value in values.values()):
        label += f" (white: below {ROUNDING:g}, which is rounding)"
    norm = _log(min(finite, default=1e-12), max(finite, default=1e-12))
    return Shading(values, norm, label, ROUNDING)


def _within_decades(least: float, most: float) -> list[float]:
    """Ticks at 1, 2 and 5 of each decade, where there are not two powers of ten to name."""
    powers = np.arange(np.floor(np.log10(least)), np.ceil(np.log10(most)) + 1.0)
    inside = [t for t in 10.0**powers if least <= t <= most]
    if len(inside) >= 2:
        return []
    found = [float(m * t) for t in 10.0**powers for m in (1, 2, 5) if least <= m * t <= most]
    return found if len(found) >= 2 else [least, most]


def _log(least: float, most: float) -> LogNorm:
    if most < 10.0 * least:
        # A decade at the least, so that small differences do not look large.
        middle = float(np.sqrt(least * most))
        least, most = middle / np.sqrt(10.0), middle * np.sqrt(10.0)
    return LogNorm(least, most, clip=True)
