"""The figure of a study: each of its figures in a panel, over the setting with most values."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.studies.settings import Value
from experiments.studies.table import Row, Table
from pgm.plot.drawing.colours import DASHES, PALETTE

COLUMNS = 3
# Series that colours and dashes tell apart.
SERIES = len(PALETTE) * len(DASHES)
MARKS = ("o", "s", "^", "D")
# Of an axis: values that are named, and the letters that stand beside each other.
TICKS, LETTERS = 12, 26
CAPTION = (
    "Means over runs (marks), twice their standard errors (bars with caps), and the 5th to 95th "
    "percentile of a run (thin lines), by setting."
)


def figure(table: Table) -> Figure:
    """Means, their errors, and the spread of runs, a panel a figure."""
    over = {name: values for name, values in table.study.over.items() if len(values) > 1}
    along = max(over, key=lambda name: (len(over[name]), _numeric(over[name])), default="")
    rest = [name for name in over if name != along]
    names = table.figures
    columns = 2 if len(names) == 4 else min(COLUMNS, len(names))
    rows = -(-len(names) // columns)
    drawn, axes = plt.subplots(
        rows,
        columns,
        figsize=(3.9 * columns, 3.3 * rows + 0.5),
        squeeze=False,
        layout="constrained",
    )
    for ax in axes.flat[len(names) :]:
        ax.set_visible(False)
    for ax, name in zip(axes.flat, names, strict=False):
        _panel(ax, table[name], along, over.get(along, ("",)), rest)
        ax.set_ylabel(name)
        ax.set_xlabel(along)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if rest:
        drawn.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)))
    plt.close(drawn)
    return drawn


def _numeric(values: Sequence[Value]) -> bool:
    return not isinstance(values[0], str | bool)


def _panel(
    ax: Axes, rows: tuple[Row, ...], along: str, values: Sequence[Value], rest: list[str]
) -> None:
    numeric = _numeric(values)
    series: dict[str, list[Row]] = {}
    for row in rows:
        label = ", ".join(f"{name}={row.settings[name]}" for name in rest)
        series.setdefault(label, []).append(row)
    shown = list(series.items())[:SERIES]
    # Series stand side by side, so that none hides another.
    offsets = np.linspace(-0.2, 0.2, len(shown)) if len(shown) > 1 else np.zeros(1)
    for k, (label, own) in enumerate(shown):
        x = offsets[k] + np.array(
            [values.index(row.settings[along]) if along else 0 for row in own]
        )
        mean, error = (np.array([getattr(row, each) for row in own]) for each in ("mean", "error"))
        low, high = (np.array([row.quantiles[q] for row in own]) for q in (0.05, 0.95))
        colour = PALETTE[k % len(PALETTE)]
        ax.vlines(x, low, high, color=colour, lw=0.8, alpha=0.6)
        ax.errorbar(
            x,
            mean,
            2.0 * error,
            color=colour,
            linestyle=DASHES[k // len(PALETTE)] if numeric and along else "none",
            marker=MARKS[k // len(PALETTE)],
            markersize=4,
            capsize=3,
            lw=1.2,
            label=label,
        )
    names = [f"{value:g}" if numeric else str(value) for value in values]
    every = -(-len(names) // TICKS)
    ax.set_xticks(range(0, len(names), every), names[::every])
    ax.set_xlim(-0.6, len(names) - 0.4)
    if sum(map(len, names[::every])) > LETTERS:
        ax.tick_params(axis="x", rotation=30)
        for each in ax.get_xticklabels():
            each.set_horizontalalignment("right")
