"""Beliefs on maps, and divergences over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pgm
import pgm.plot
from models.networks import pose
from models.simulation import Drive
from pgm.plot.drawing.colours import MUTED, PALETTE

# What the maps show of the plane [m].
SHOWN = (-6.5, 12.5)
COLOURS = dict(
    zip(("unknown", "right", "wrong"), (PALETTE[3], PALETTE[2], PALETTE[1]), strict=True)
)


def moments(found: int, steps: int) -> list[int]:
    """The steps that maps show: of the ring, of where it is left, and of the end."""
    chosen = (0, 3, found // 2 + 2, found - 1, found, steps)
    return sorted({min(max(step, 0), steps) for step in chosen})


def maps(
    oracle: pgm.results.Posterior,
    gaussians: Mapping[str, pgm.results.Posterior],
    drive: Drive,
    steps: Sequence[int],
) -> Figure:
    """Filtered beliefs above smoothed ones, with the Gaussians' ellipses."""
    figure, axes = plt.subplots(
        2,
        len(steps),
        figsize=(2.9 * len(steps), 6.9),
        sharex=True,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for row, kind in zip(axes, ("filtered", "smoothed"), strict=True):
        for ax, step in zip(row, steps, strict=True):
            each = {
                start: (p.filtered if kind == "filtered" else p)[pose.at(step)]
                for start, p in gaussians.items()
            }
            belief = (oracle.filtered if kind == "filtered" else oracle)[pose.at(step)]
            draw(ax, belief, each, drive, step)
            ax.set_title(f"{kind}, step {step}")
    for ax in axes.flat:
        ax.label_outer()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    plt.close(figure)
    return figure


def draw(
    ax: Axes,
    belief: pgm.results.GridBelief,
    gaussians: Mapping[str, pgm.Gaussian],
    drive: Drive,
    step: int,
) -> None:
    """One map: the grid's belief, the robot, the landmarks, and the Gaussians' ellipses."""
    pgm.plot.grid_map(belief, truth=drive.truth[step], landmarks=drive.landmarks, arrows=24, ax=ax)
    ellipses(ax, gaussians)
    ax.set(xlim=SHOWN, ylim=SHOWN, xlabel="east [m]", ylabel="north [m]")


def ellipses(ax: Axes, gaussians: Mapping[str, pgm.Gaussian]) -> None:
    """The Gaussians' 95 % ellipses, a colour a start."""
    for start, gaussian in gaussians.items():
        colour = COLOURS[start]
        pgm.plot.ellipses(gaussian, colour=colour, facecolor="none", linewidth=1.4, ax=ax)
        ax.plot(*gaussian.mean[:2], ".", color=colour, label=f"Taylor, started {start}")


def animate(
    oracle: pgm.results.Posterior,
    gaussians: Mapping[str, pgm.results.Posterior],
    drive: Drive,
    path: Path,
) -> None:
    """Write the filtered beliefs as a moving picture, with the Gaussians' ellipses."""

    def also(ax: Axes, step: int) -> None:
        ellipses(ax, {start: p.filtered[pose.at(step)] for start, p in gaussians.items()})
        ax.set_aspect("equal", adjustable="box")
        ax.set(xlim=SHOWN, ylim=SHOWN, xlabel="east [m]", ylabel="north [m]")
        ax.legend(loc="upper left", fontsize="x-small")

    belief = oracle.filtered[pose]
    truth, places = drive.truth, drive.landmarks
    pgm.plot.animate_beliefs(belief, path, truth=truth, landmarks=places, also=also, arrows=30)


def divergences(tables: Mapping[str, pgm.results.Comparison], found: int) -> Figure:
    """KL of filters from the grid over the steps, a panel a start."""
    figure, axes = plt.subplots(
        1, len(tables), figsize=(14, 4.6), sharex=True, sharey=True, layout="constrained"
    )
    for ax, (start, table) in zip(axes, tables.items(), strict=True):
        pgm.plot.comparison(table, schedule="filter", ax=ax)
        ax.axvline(found, color=MUTED, lw=0.8, ls=":")
        ax.get_legend().remove()
        ax.set_title(f"started {start}")
        ax.label_outer()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    plt.close(figure)
    return figure


def alike(table: pgm.results.Comparison) -> Figure:
    """KL of filters and of smoothers over the steps, the grid started as they are."""
    figure, axes = plt.subplots(
        1, 2, figsize=(13, 4.6), sharex=True, sharey=True, layout="constrained"
    )
    for ax, schedule in zip(axes, ("filter", "smoother"), strict=True):
        pgm.plot.comparison(table, schedule=schedule, ax=ax)
        ax.label_outer()
        ax.get_legend().remove()
        ax.set_title(schedule)
    handles, labels = axes[0].get_legend_handles_labels()
    labels = [label.replace(", filtered", "") for label in labels]
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    plt.close(figure)
    return figure
