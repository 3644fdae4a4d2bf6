"""Paths, divergences, and beliefs in the plane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.freiburg.log import Log
from experiments.freiburg.particles import Particles
from models.networks import pose
from pgm.plot.drawing.colours import PALETTE

Array = npt.NDArray[np.float64]

PLANE = {"xlabel": "east [m]", "ylabel": "north [m]"}


def path(log: Log, posterior: pgm.results.Posterior, reckoned: Array) -> Figure:
    """Filter and smoother beside each other, over the path by odometry alone."""
    figure, axes = plt.subplots(
        1, 2, figsize=(12, 6.5), sharex=True, sharey=True, layout="constrained"
    )
    places = log.landmarks
    kinds = {found.kind: found[pose] for found in (posterior.filtered, posterior)}
    for ax, colour, (kind, belief) in zip(axes, PALETTE, kinds.items(), strict=False):
        ax.plot(*reckoned[:, :2].T, color="black", lw=0.8, ls="--", label="odometry alone")
        pgm.plot.trajectory(belief, landmarks=places, label=kind, colour=colour, ax=ax)
        ax.set(title=f"Taylor, {kind}", **PLANE)
    plt.close(figure)
    return figure


def filters(
    log: Log, posteriors: Mapping[str, pgm.results.Posterior], reference: pgm.Gaussian
) -> Figure:
    """The filtered path of each lineariser, over the reference's."""
    figure, axes = plt.subplots(
        2, 3, figsize=(13, 9.0), sharex=True, sharey=True, layout="constrained"
    )
    places = log.landmarks
    for ax, colour, (label, posterior) in zip(axes.flat, PALETTE, posteriors.items(), strict=False):
        belief = posterior.filtered[pose]
        pgm.plot.trajectory(belief, landmarks=places, label=label, colour=colour, ax=ax)
        ax.plot(*reference.mean[:, :2].T, color="black", lw=0.8, label="particles", zorder=2.6)
        ax.set(title=label, **PLANE)
        ax.label_outer()
    last = axes.flat[-1]
    pgm.plot.trajectory(reference, landmarks=places, label="particles", colour="black", ax=last)
    last.set(title="particles", **PLANE)
    last.label_outer()
    for ax in axes.flat:
        if legend := ax.get_legend():
            legend.remove()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    labels = [
        "filter of the title" if label == next(iter(posteriors)) else label for label in labels
    ]
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    plt.close(figure)
    return figure


def divergence(reference: pgm.Gaussian, posteriors: Mapping[str, pgm.results.Posterior]) -> Figure:
    """KL from the reference over the steps, the first belief apart, which all of them know."""
    figure, ax = plt.subplots(figsize=(11, 4.5), layout="constrained")
    for colour, (label, posterior) in zip(PALETTE, posteriors.items(), strict=False):
        belief = posterior.filtered[pose]
        pgm.plot.kl(reference[1:], belief[1:], label=label, colour=colour, ax=ax)
    ax.set_ylabel("KL(particles ‖ filter) [nats]")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(posteriors), frameon=False)
    plt.close(figure)
    return figure


def compared(table: pgm.results.Comparison) -> Figure:
    """KL of filters and smoothers from a grid's beliefs over the steps."""
    figure, axes = plt.subplots(2, 1, figsize=(11, 8), sharex=True, sharey=True)
    for ax, schedule in zip(axes, ("filter", "smoother"), strict=True):
        pgm.plot.comparison(table, schedule=schedule, ax=ax)
        ax.set_ylabel(f"KL(grid ‖ {schedule}) [nats]")
    axes[0].set_xlabel("")
    axes[0].set_ylim(bottom=3e-4)
    figure.set_layout_engine("constrained")
    plt.close(figure)
    return figure


def beliefs(
    posteriors: Mapping[str, pgm.results.Posterior],
    particles: Particles,
    steps: Sequence[int],
) -> Figure:
    """Particles and the filters' ellipses at some steps."""
    figure, axes = plt.subplots(
        1, len(steps), figsize=(3.6 * len(steps), 4.6), layout="constrained", squeeze=False
    )
    for ax, step in zip(axes.flat, steps, strict=True):
        ax.plot(*particles.cloud[step, :, :2].T, ".", color="#999999", ms=2.0, label="particles")
        for colour, (label, posterior) in zip(PALETTE, posteriors.items(), strict=False):
            belief = posterior.filtered[pose.at(step)]
            pgm.plot.ellipses(belief, colour=colour, facecolor="none", linewidth=1.4, ax=ax)
            ax.plot(*belief.mean[:2], "o", color=colour, ms=5.0, label=label)
        ax.set(title=f"step {step}", **PLANE)
        ax.set_aspect("equal", adjustable="datalim")
        ax.label_outer() if ax is axes[0, 0] else ax.set_ylabel("")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    plt.close(figure)
    return figure
