"""The figure of cost against size."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import LogFormatter, StrMethodFormatter

Curves = Mapping[str, Mapping[str, Mapping[int, float]]]
Line = tuple[str, str, str, str]  # label, colour, marker, dashes

# By curve and library; Okabe and Ito's colours.
STEPS: dict[tuple[str, str], Line] = {
    ("filter", "pgm"): ("filter", "#0072B2", "o", "-"),
    ("smoother", "pgm"): ("smoother", "#D55E00", "s", "-"),
    ("smoother", "dynamax"): ("smoother, dynamax", "#D55E00", "s", ":"),
    ("iterated", "pgm"): ("three linearisations, balanced tree", "#CC79A7", "^", "-"),
    ("balanced", "pgm"): ("linear smoother, balanced tree", "#009E73", "D", "-"),
}
SIMULATIONS: dict[tuple[str, str], Line] = {
    ("ukf_simulations", "pgm"): ("unscented", "#D55E00", "s", "-"),
    ("ukf_simulations", "dynamax"): ("unscented, dynamax", "#D55E00", "s", ":"),
    ("ekf_simulations", "pgm"): ("Taylor", "#0072B2", "o", "-"),
    ("ekf_simulations", "dynamax"): ("Taylor, dynamax", "#0072B2", "o", ":"),
}


def draw(curves: Curves, path: Path) -> None:
    """Write the figure, one panel by steps and one by simulations."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5.2), layout="constrained")
    left.set(title="One run", xlabel="steps T", ylabel="cost of a step [µs]")
    right.set(title="One step of many runs", xlabel="runs", ylabel="cost of a run [µs]")
    _lines(left, curves, STEPS)
    _lines(right, curves, SIMULATIONS)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _lines(ax: Axes, curves: Curves, lines: Mapping[tuple[str, str], Line]) -> None:
    for (curve, library), (label, colour, marker, dashes) in lines.items():
        costs = curves.get(curve, {}).get(library, {})
        if costs:
            micro = [1e6 * cost for cost in costs.values()]
            style = {"color": colour, "marker": marker, "linestyle": dashes, "markersize": 5}
            ax.loglog(list(costs), micro, label=label, **style)
    ax.grid(which="major", alpha=0.3)
    # Plain numbers, 60 and not 6 × 10¹, at as few of a decade as leave room.
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(StrMethodFormatter("{x:,g}"))
        axis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.4)))
    if ax.lines:
        ax.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
    else:
        ax.set_visible(False)
