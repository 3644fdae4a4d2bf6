"""Shares of drives that end right, errors over time, and beliefs on the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from experiments.global_localisation.places import NEAR, Share, off, right
from experiments.global_localisation.shown import Shown
from experiments.global_localisation.world import Array
from pgm.plot.drawing.colours import MUTED, PALETTE


def success(found: Mapping[str, Share]) -> Figure:
    """Shares with their intervals, a row each."""
    figure, ax = plt.subplots(figsize=(8, 0.9 + 0.45 * len(found)), layout="constrained")
    for row, (colour, share) in enumerate(zip(PALETTE, found.values(), strict=False)):
        ax.barh(row, share.value, color=colour, alpha=0.35, height=0.6)
        bars = [[max(share.value - share.low, 0.0)], [max(share.high - share.value, 0.0)]]
        ax.errorbar(share.value, row, xerr=bars, fmt="o", color=colour, capsize=4)
    ax.set_yticks(range(len(found)), list(found))
    ax.set(xlim=(0.0, 1.02), ylim=(len(found) - 0.5, -0.5), xlabel="share of drives that end right")
    ax.grid(axis="x", color=MUTED, alpha=0.25, lw=0.6)
    plt.close(figure)
    return figure


def errors(
    poses: Mapping[str, Array], truth: Array, event: float | None = None, high: float = 0.9
) -> Figure:
    """Shares of drives that are right, and the place's error: median, and a quantile dotted.

    Parameters
    ----------
    poses : mapping of str to ndarray
        Estimates (runs, T+1, 3) by their way; NaN where there are none.
    truth : ndarray
        (runs, T+1, 3).
    event : float, optional
        A time to be marked, in steps.
    high : float
    """
    figure, (left, right_) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
    steps = np.arange(truth.shape[1])
    for colour, (name, estimates) in zip(PALETTE, poses.items(), strict=False):
        known = np.isfinite(estimates[0, :, 0])
        at, found = steps[known], estimates[:, known]
        place, _ = off(found, truth[:, known])
        left.plot(at, right(found, truth[:, known]).mean(axis=0), color=colour, label=name)
        right_.plot(at, np.median(place, axis=0), color=colour)
        right_.plot(at, np.quantile(place, high, axis=0), color=colour, ls=":")
    right_.axhline(NEAR, color=MUTED, lw=0.8)
    right_.set(yscale="log", ylabel=f"error of the place [m], median and {100 * high:.0f} %")
    right_.yaxis.set_major_formatter("{x:g}")
    left.set(ylim=(0.0, 1.02), ylabel="share of drives that are right")
    for ax in (left, right_):
        ax.set_xlabel("step")
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.grid(color=MUTED, alpha=0.25, lw=0.6)
        if event is not None:
            ax.axvline(event, color=MUTED, lw=0.8, ls="--")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(poses), frameon=False)
    plt.close(figure)
    return figure


def maps(shown: Shown, steps: Sequence[int]) -> Figure:
    """Particles above and the grid below, at some steps."""
    figure, axes = plt.subplots(
        2,
        len(steps),
        figsize=(4.2 * len(steps), 5.4),
        sharex=True,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for (upper, lower), step in zip(axes.T, steps, strict=True):
        shown.draw_particles(step, upper)
        shown.draw_grid(step, lower)
        upper.set_title(f"particles, step {step}")
        lower.set_title(f"grid, step {step}")
    for ax in axes.flat:
        ax.label_outer()
    plt.close(figure)
    return figure
