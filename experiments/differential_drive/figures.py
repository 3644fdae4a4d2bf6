"""A drive with ellipses at its motions and readings, its errors, and consistency over many."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

import pgm
import pgm.plot
from experiments.differential_drive.errors import at_steps
from experiments.differential_drive.problems import DT, LANDMARK, MOTIONS
from experiments.differential_drive.results import Drive
from pgm import consistency
from pgm.plot.drawing.colours import INK, MUTED, PALETTE

Array = npt.NDArray[np.float64]

# By what made a belief: a motion, a reading, the smoother.
MOTION, READING, SMOOTHED = PALETTE[0], PALETTE[1], PALETTE[2]
_WINDOW = 2 * MOTIONS  # two seconds
RINGS = 20  # ellipses on the whole drive, at most
_SIGMAS = 1.96  # of 95 % in one dimension
_BY_LINEARISER = {"exact": INK, "Taylor": MOTION, "Unscented": READING}


def drive_figure(drive: Drive) -> Figure:
    """A drive, two seconds of it with an ellipse at each motion and reading, and its errors."""
    figure = plt.figure(figsize=(12, 9.4), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(3.0, 1.0, 1.0))
    whole, part = (figure.add_subplot(grid[0, k]) for k in (0, 1))
    upper = figure.add_subplot(grid[1, :])
    lower = figure.add_subplot(grid[2, :], sharex=upper)
    steps = drive.problem.steps
    first = max(MOTIONS * (steps // MOTIONS // 2) - _WINDOW // 2, 0)
    last = min(first + _WINDOW, steps)
    window = slice(first, last + 1)
    _draw(drive, whole, slice(0, steps + 1), motions=False)
    _draw(drive, part, window, motions=True)
    _zoom(drive, whole, part, window)
    whole.set_title(f"{drive.problem.title}, {steps * DT:g} s")
    part.set_title(f"seconds {first * DT:g} to {last * DT:g}")
    for k, (ax, name) in enumerate(zip((upper, lower), ("east", "north"), strict=True)):
        _errors(drive, ax, k)
        ax.axvspan(first * DT, last * DT, color=MUTED, alpha=0.3, lw=0)
        ax.set_ylabel(f"error {name} [m]")
    upper.tick_params(labelbottom=False)
    lower.set_xlabel("time [s]")
    figure.legend(handles=_handles(drive), loc="outside upper center", ncols=4, frameon=False)
    plt.close(figure)
    return figure


def _draw(drive: Drive, ax: Axes, window: slice, *, motions: bool) -> None:
    """Draw a window of steps, with an ellipse at each of its motions or at few readings alone."""
    moved = np.arange(max(window.start, 1), window.stop)
    measured = np.intersect1d(moved, drive.problem.measured)
    every = 1 if motions else -(-len(measured) // RINGS)
    if motions:
        pgm.plot.ellipses(
            at_steps(drive.predicted, moved),
            ax=ax,
            facecolor="none",
            edgecolor=to_rgba(MOTION, 0.55),
            linewidth=0.7,
        )
    pgm.plot.ellipses(
        at_steps(drive.filtered, measured[::every]),
        ax=ax,
        facecolor=to_rgba(READING, 0.12),
        edgecolor=READING,
        linewidth=1.3,
    )
    if drive.problem.given:
        ax.plot(*LANDMARK, "^", color=INK, markersize=7)
    ax.plot(*drive.truth[window, :2].T, color=INK, lw=0.9)
    ax.plot(*drive.filtered.mean[window, :2].T, color=MOTION, lw=1.1)
    ax.plot(*drive.smoothed.mean[window, :2].T, color=SMOOTHED, lw=1.4)
    ax.plot(*drive.filtered.mean[measured[::every], :2].T, ".", color=READING, markersize=5)
    ax.set(xlabel="east [m]", ylabel="north [m]")
    ax.set_aspect("equal", adjustable="datalim")


def _errors(drive: Drive, ax: Axes, k: int) -> None:
    """Errors of one component over time, and the filter's band at every motion and reading."""
    times = DT * np.arange(drive.problem.steps + 1)
    reach = _SIGMAS * drive.filtered.std[:, k]
    ax.fill_between(times, -reach, reach, color=MOTION, alpha=0.22, lw=0)
    for belief, colour in ((drive.filtered, MOTION), (drive.smoothed, SMOOTHED)):
        ax.plot(times, belief.mean[:, k] - drive.truth[:, k], color=colour, lw=0.9)
    ax.axhline(0.0, color=INK, lw=0.6)
    ax.margins(x=0.01)


def _zoom(drive: Drive, whole: Axes, part: Axes, window: slice) -> None:
    """Show a window on the right, and its frame on the left."""
    at = np.arange(window.start, window.stop)
    shown = [at_steps(belief, at) for belief in (drive.predicted, drive.filtered)]
    means = np.stack([belief.mean[:, :2] for belief in shown])
    reach = 2.6 * np.stack([belief.std[:, :2] for belief in shown])
    truth = drive.truth[window, :2]
    lows = np.minimum(means - reach, truth).min(axis=(0, 1))
    highs = np.maximum(means + reach, truth).max(axis=(0, 1))
    centre, half = 0.5 * (lows + highs), 0.5 * float((highs - lows).max())
    part.set_aspect("equal", adjustable="box")
    part.set(xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] - half, centre[1] + half))
    corner = (float(centre[0] - half), float(centre[1] - half))
    whole.add_patch(
        Rectangle(corner, 2 * half, 2 * half, fill=False, edgecolor=INK, lw=1.2, zorder=3)
    )


def _handles(drive: Drive) -> list[Artist]:
    def ring(colour: str, label: str) -> Line2D:
        empty = Line2D([], [], color=colour, label=label, marker="o", ls="none")
        empty.set(markersize=9, markerfacecolor="none")
        return empty

    handles: list[Artist] = [
        Line2D([], [], color=INK, lw=1.0, label="truth"),
        Line2D([], [], color=MOTION, lw=1.1, label="filter"),
        Line2D([], [], color=SMOOTHED, lw=1.4, label="smoother"),
        ring(MOTION, "filter's 95 %, after a motion"),
        ring(READING, "filter's 95 %, after a reading"),
        Patch(color=MOTION, alpha=0.22, lw=0, label="filter's 95 % of one component"),
        Patch(color=MUTED, alpha=0.3, lw=0, label="the part enlarged"),
    ]
    if drive.problem.given:
        handles.append(Line2D([], [], color=INK, marker="^", ls="none", label="landmark"))
    return handles


Curves = Mapping[tuple[str, str], Array]


def nees_figure(nees: Mapping[str, Mapping[str, Curves]], runs: int) -> Figure:
    """The mean NEES of each step, by noise, problem and estimator.

    Parameters
    ----------
    nees : mapping
        ``nees[noise][problem][lineariser, estimator]``, (T,), from step 1 on.
    runs : int
        That were averaged.
    """
    names = list(next(iter(nees.values())))
    figure, axes = plt.subplots(
        len(nees), len(names), figsize=(12, 5.6), sharex="col", layout="constrained"
    )
    for row, (noise, problems) in zip(axes, nees.items(), strict=True):
        for ax, (name, estimators) in zip(row, problems.items(), strict=True):
            dimension = 2 if name == "1" else 3
            low, high = consistency.mean_band(dimension, runs)
            ax.axhspan(low, high, color=MUTED, alpha=0.25, lw=0, label="99 % band")
            for (lineariser, kind), values in estimators.items():
                ax.plot(
                    DT * np.arange(1, len(values) + 1),
                    values,
                    color=_BY_LINEARISER[lineariser],
                    ls="--" if kind == "smoother" else "-",
                    # Broad, so that it is seen beneath the unscented one, which is often the same.
                    lw=3.0 if lineariser == "Taylor" else 1.1,
                    alpha=0.6 if lineariser == "Taylor" else 1.0,
                    label=f"{lineariser}, {kind}",
                )
            ax.set_title(f"problem {name}, N(0, ·) read as {noise}s")
            ax.set_ylim(0.0, max(2.0 * dimension, 1.05 * ax.get_ylim()[1]))
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    for ax in axes[:, 0]:
        ax.set_ylabel("mean NEES")
    shown: dict[str, Artist] = {}
    for ax in axes[0]:
        handles, labels = ax.get_legend_handles_labels()
        shown |= dict(zip(labels, handles, strict=True))
    figure.legend(
        list(shown.values()),
        list(shown),
        loc="outside lower center",
        ncols=(len(shown) + 1) // 2,
        frameon=False,
    )
    plt.close(figure)
    return figure
