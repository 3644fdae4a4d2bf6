"""The house with what is known of it, before and after the loop is closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import pgm
import pgm.plot
from experiments.slam.drive import Drive
from experiments.slam.network import Map
from pgm.plot.drawing.colours import INK, MUTED, PALETTE

Array = npt.NDArray[np.float64]

POSES, LANDMARKS = PALETTE[0], PALETTE[1]
# About so many poses have their ellipse.
ELLIPSES = 40


def closed(drive: Drive, before: Map, after: Map) -> Figure:
    """Poses and landmarks of the first run, with ellipses, before and after the closing."""
    figure, axes = plt.subplots(
        1, 2, figsize=(12.5, 7.2), sharex=True, sharey=True, layout="constrained"
    )
    step = drive.closing
    parts = (("before the closing sighting", before, step - 1), ("after it", after, step))
    for ax, (title, found, last) in zip(axes, parts, strict=True):
        _house(ax, drive)
        every = max(1, len(drive.truth) // ELLIPSES)
        some = np.append(np.arange(every, last, every), last)
        pgm.plot.ellipses(found.poses[0, some], colour=POSES, linewidth=0.8, ax=ax)
        marks = found.landmarks[0]  # too many to fill
        pgm.plot.ellipses(marks, colour=LANDMARKS, linewidth=0.7, facecolors="none", ax=ax)
        if legend := ax.get_legend():
            legend.remove()
        ax.plot(*drive.truth[: last + 1, :2].T, color=INK, lw=0.7, zorder=2.5)
        ax.plot(*found.poses.mean[0, :, :2].T, color=POSES, lw=1.0, zorder=2.6)
        ax.plot(*drive.truth[last, :2], "o", color=INK, ms=5, zorder=3)
        ax.set(title=title, xlabel="east [m]", ylabel="north [m]" if ax is axes[0] else "")
    handles = [
        Line2D([], [], color=INK, lw=0.7, label="true way"),
        Line2D([], [], color=INK, lw=0, marker="o", ms=5, label="the robot"),
        Line2D([], [], color=INK, lw=0, marker=".", ms=3, label="landmarks"),
        Line2D([], [], color=POSES, lw=1.0, label="way, estimated, 95 % ellipses"),
        Line2D([], [], color=LANDMARKS, lw=1.0, label="landmarks' 95 % ellipses"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False)
    plt.close(figure)
    return figure


def shrunk(
    drive: Drive, found: Mapping[str, Any], filtered: Sequence[Mapping[str, float]]
) -> Figure:
    """Deviations of poses and landmarks along the way, before and after the closing."""
    figure, axes = plt.subplots(
        1, 2, figsize=(11.0, 4.2), sharex=True, sharey=True, layout="constrained"
    )
    before, after = found["poses"]
    axes[0].plot(found["way"], before, color=PALETTE[1], label="before")
    axes[0].plot(found["way"], after, color=PALETTE[0], label="after")
    axes[0].plot(
        [row["way"] for row in filtered],
        [row["filter_std"] for row in filtered],
        "o",
        color=INK,
        ms=5,
        fillstyle="none",
        label="filter, the pose of its time",
    )
    old, new = found["landmarks"]
    axes[1].plot(found["landmarks_way"], old, ".", color=PALETTE[1])
    axes[1].plot(found["landmarks_way"], new, "x", color=PALETTE[0], ms=4)
    for ax, title in zip(axes, ("poses", "landmarks, where first seen"), strict=True):
        ax.axvline(drive.way[drive.closing], color=MUTED, ls=":", lw=1.0)
        ax.set(title=title, xlabel="way [m]", ylim=(0.0, None))
    axes[0].set_ylabel("deviation [m]")
    handles, labels = axes[0].get_legend_handles_labels()
    handles.append(Line2D([], [], color=MUTED, ls=":", lw=1.0))
    figure.legend(handles, [*labels, "the closing"], loc="outside lower center", ncols=4)
    plt.close(figure)
    return figure


def nees(drive: Drive, found: Map) -> Figure:
    """NEES of the poses along the way, averaged over runs."""
    figure, ax = plt.subplots(figsize=(8.5, 3.8), layout="constrained")
    pgm.plot.nees(found.poses[:, 1:], drive.truth[1:], times=drive.way[1:], ax=ax)
    ax.set_xlabel("way [m]")
    ax.set_ylim(0.0, None)
    plt.close(figure)
    return figure


def clusters(graph: pgm.ClusterGraph, evidence: Mapping[pgm.Variable, Any]) -> Figure:
    """The junction tree of a small drive."""
    figure, ax = plt.subplots(figsize=(16.0, 11.5), layout="constrained")
    pgm.plot.cluster_graph(graph, evidence=evidence, sizes=True, ax=ax)
    plt.close(figure)
    return figure


def _house(ax: Axes, drive: Drive) -> None:
    ax.add_collection(LineCollection(list(drive.house.walls), colors=MUTED, lw=0.8))
    ax.plot(*drive.landmarks.T, ".", color=INK, ms=3, zorder=2.4)
    ax.set_aspect("equal")
