"""Particles put elsewhere, over time and on the map."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from experiments.global_localisation.filters import Way, beliefs, online, unwarned
from experiments.global_localisation.shown import draw_particles
from experiments.global_localisation.world import Array, Drives, World
from models.networks import pose
from pgm.plot.drawing.colours import MUTED, PALETTE


def injected(shares: Mapping[str, Array], event: int) -> Figure:
    """Shares of particles put elsewhere, by policy; colours are those of the errors."""
    figure, ax = plt.subplots(figsize=(8, 3.6), layout="constrained")
    for colour, (name, share) in zip(PALETTE, shares.items(), strict=False):
        ax.plot(share, "o-", color=colour, label=name, markersize=3, lw=1.0)
    ax.axvline(event, color=MUTED, lw=0.8, ls="--")
    ax.set(xlabel="step", ylabel="share of particles, mean over drives")
    ax.set_ylim(bottom=0.0)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(frameon=False)
    ax.grid(color=MUTED, alpha=0.25, lw=0.6)
    plt.close(figure)
    return figure


def maps(world: World, drive: Drives, known: Mapping[str, Way], before: int) -> Figure:
    """The particles of one drive under each policy, before and after it is carried."""
    steps = sorted({before - 1, before, min(before + 2, drive.steps), drive.steps})
    figure, axes = plt.subplots(
        len(known),
        len(steps),
        figsize=(4.2 * len(steps), 2.6 * len(known)),
        sharex=True,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for row, (name, way) in zip(axes, known.items(), strict=True):
        robot = online(way)
        with unwarned():
            each = [held[pose][0] for held in beliefs(robot, robot.initial(), drive)]
        for ax, step in zip(row, steps, strict=True):
            draw_particles(world, each[step], drive.truth[0, step], ax)
            ax.set_title(f"{name}, step {step}")
    for ax in np.ravel(axes):
        ax.label_outer()
    plt.close(figure)
    return figure
