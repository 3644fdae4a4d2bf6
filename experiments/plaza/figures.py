"""The drive, enlarged where filter and smoother part, and errors over time."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import pgm
import pgm.plot
from experiments.plaza.log import Log
from models.networks import pose
from pgm.plot.drawing.colours import INK, MUTED, PALETTE

Array = npt.NDArray[np.float64]

COLOURS = {"filter": PALETTE[0], "smoother": PALETTE[1]}
LENGTH = 16.0  # m, the part of the drive that is enlarged
RINGS = 7  # ellipses of each belief in it
PLANE = ("east", "north")


def path(log: Log, posterior: pgm.results.Posterior) -> Figure:
    """The whole drive, the part in which filter and smoother differ most, and their errors."""
    figure = plt.figure(figsize=(12, 8.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(2.6, 1.0))
    whole, part = (figure.add_subplot(grid[0, k]) for k in (0, 1))
    below = figure.add_subplot(grid[1, :])
    found = {"filter": posterior.filtered[pose], "smoother": posterior[pose]}
    times = log.timeline.times - log.timeline.times[0]
    window = parting(log.truth, *(distances(belief, log) for belief in found.values()))

    whole.plot(*log.beacons.T, "^", color=INK, markersize=6, label="beacons")
    _paths(whole, log, found, slice(None), 0.7)
    _paths(part, log, found, window, 1.4)
    for kind, belief in found.items():
        at = np.linspace(window.start, window.stop - 1, RINGS).astype(int)
        pgm.plot.ellipses(
            pgm.Gaussian(pose, belief.mean[at], belief.cov[at]),
            colour=COLOURS[kind],
            linewidth=1.2,
            ax=part,
        )
        below.plot(times, distances(belief, log), color=COLOURS[kind], linewidth=0.8)
    begin, end = times[window.start], times[window.stop - 1]
    below.axvspan(begin, end, color=MUTED, alpha=0.3, linewidth=0, label="enlarged")
    below.set(xlabel="time [s]", ylabel="distance from the truth [m]", ylim=(0.0, None))
    below.margins(x=0.01)
    whole.set_title("the whole drive")
    part.set_title(f"seconds {begin:.0f} to {end:.0f}, where the smoother gains most")
    for ax in (whole, part):
        ax.set(xlabel="east [m]", ylabel="north [m]")
        ax.set_aspect("equal", adjustable="datalim")
    figure.draw_without_rendering()  # so that the axes have their limits
    low, high = np.array([part.get_xlim(), part.get_ylim()]).T
    frame = Rectangle(tuple(low), *(high - low), fill=False, edgecolor=INK, linewidth=1.2, zorder=4)
    whole.add_patch(frame)
    handles, labels = whole.get_legend_handles_labels()
    more, names = below.get_legend_handles_labels()
    figure.legend(
        handles + more, labels + names, loc="outside upper center", ncols=5, frameon=False
    )
    plt.close(figure)
    return figure


def errors(log: Log, posterior: pgm.results.Posterior) -> Figure:
    """Errors east and north in bands of three standard deviations."""
    figure, axes = plt.subplots(
        2, 2, figsize=(12, 5.5), sharex=True, sharey=True, layout="constrained"
    )
    times = log.timeline.times - log.timeline.times[0]
    beliefs = {"filter": posterior.filtered[pose], "smoother": posterior[pose]}
    for column, (kind, belief) in enumerate(beliefs.items()):
        pgm.plot.errors(belief, log.truth, components=PLANE, times=times, axes=axes[:, column])
        axes[0, column].set_title(kind, loc="left")
        axes[-1, column].set_xlabel("time [s]")
    for ax, name in zip(axes[:, 0], PLANE, strict=True):
        ax.set_ylabel(f"error {name} [m]")
    for ax in axes[:, 1]:
        ax.set_ylabel("")
    limit = 1.05 * np.abs(axes[0, 0].get_ylim()).max()
    axes[0, 0].set_ylim(-limit, limit)
    plt.close(figure)
    return figure


def distances(belief: pgm.Gaussian, log: Log) -> Array:
    """How far each mean is from the true place, (T+1,) [m]."""
    apart: Array = np.linalg.norm(belief.mean[:, :2] - log.truth[:, :2], axis=-1)
    return apart


def parting(truth: Array, filtered: Array, smoothed: Array) -> slice:
    """The steps of some metres in which the smoother is nearer to the truth by most."""
    driven = float(np.linalg.norm(np.diff(truth[:, :2], axis=0), axis=-1).sum())
    steps = min(max(round(LENGTH * len(truth) / max(driven, LENGTH)), 2), len(truth))
    gain = np.convolve(filtered - smoothed, np.ones(steps), mode="valid")
    first = int(gain.argmax())
    return slice(first, first + steps)


def _paths(ax: Axes, log: Log, found: dict[str, pgm.Gaussian], window: slice, width: float) -> None:
    for kind, belief in found.items():
        ax.plot(*belief.mean[window, :2].T, color=COLOURS[kind], linewidth=width, label=kind)
    ax.plot(*log.truth[window, :2].T, color=INK, linewidth=0.8 * width, label="truth")
