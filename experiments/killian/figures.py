"""The map and the paths on it, errors by distance, and beliefs of a robot that may be anywhere."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.killian.drive import Drive
from experiments.killian.graph import differing
from experiments.killian.localise import LOST, SHOWN, Followed, Gridded, Stray
from models.networks import pose
from pgm.plot.colours import INK, MUTED, PALETTE

Array = npt.NDArray[np.float64]

_FOUND, _RECKONED, _SCAN = PALETTE[0], PALETTE[1], PALETTE[2]
MARGIN = 5.0  # m
ZOOM = 40  # steps


def overview(drive: Drive, followed: Followed) -> Figure:
    """The map, the path that particles find, and that of the motions alone."""
    figure, ax = plt.subplots(figsize=(9, 8.2), layout="constrained")
    pgm.plot.occupancy_map(drive.map, ax=ax)
    ax.plot(*drive.dead_reckoning[:, :2].T, color=_RECKONED, lw=0.9, label="odometry alone")
    ax.plot(*drive.poses[:, :2].T, color=INK, lw=2.2, label="poses of the recording")
    ax.plot(*followed.belief.mean[:, :2].T, color=_FOUND, lw=1.0, label="particles")
    _around(ax, np.concatenate([drive.dead_reckoning, drive.poses]))
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    plt.close(figure)
    return figure


def by_distance(drive: Drive, followed: Followed) -> Figure:
    """Errors of place and of heading over the distance driven."""
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(10, 6), sharex=True, layout="constrained")
    reckoned = differing(drive.dead_reckoning, drive.poses)
    own = np.linalg.norm(followed.belief.std[:, :2], axis=-1)
    for ax, label, blind, found, deviation in (
        (upper, "distance [m]", np.linalg.norm(reckoned[:, :2], axis=-1), followed.distance, own),
        (
            lower,
            "heading [deg]",
            np.degrees(np.abs(reckoned[:, 2])),
            np.degrees(np.abs(followed.error[:, 2])),
            np.degrees(followed.belief.std[:, 2]),
        ),
    ):
        ax.plot(drive.distance, blind, color=_RECKONED, lw=1.0, label="odometry alone")
        ax.plot(drive.distance, found, color=_FOUND, lw=0.6, label="particles")
        ax.plot(drive.distance, deviation, color=INK, lw=0.8, label="the particles' own deviation")
        ax.set(yscale="log", ylabel=label, ylim=(1e-3, None))
        ax.grid(color=MUTED, alpha=0.25, lw=0.6)
    lower.set_xlabel("driven [m]")
    upper.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
    plt.close(figure)
    return figure


def zoom(drive: Drive, followed: Followed) -> Figure:
    """The steps around the largest error: ellipses of the belief, and the scan there."""
    worst = int(followed.distance.argmax())
    first = max(min(worst - ZOOM // 2, len(drive.motions) - ZOOM), 0)
    steps = slice(first, first + ZOOM + 1)
    figure, ax = plt.subplots(figsize=(9, 7), layout="constrained")
    pgm.plot.occupancy_map(drive.map, ax=ax)
    pgm.plot.trajectory(
        followed.belief[steps],
        truth=drive.poses[steps],
        every=2,
        label="particles, 95 %",
        colour=_FOUND,
        ax=ax,
    )
    east, north, heading = followed.belief.mean[worst]
    ranges, angles = drive.scans[worst], drive.log.angles
    met = ranges < drive.log.most
    course = heading + angles[met]
    ends = np.array([east, north]) + ranges[met, None] * np.stack(
        [np.cos(course), np.sin(course)], axis=-1
    )
    ax.plot(*ends.T, ".", color=_SCAN, ms=4.0, label=f"scan of step {worst}, where it is found")
    ax.plot(east, north, "o", color=_SCAN, ms=6.0)
    ax.legend(loc="best", fontsize="small")
    _around(ax, drive.poses[steps])
    plt.close(figure)
    return figure


def stray(drive: Drive, found: Stray) -> Figure:
    """Particles over the whole map at the first steps."""
    figure, axes = plt.subplots(
        2, 2, figsize=(10, 9), sharex=True, sharey=True, layout="constrained"
    )
    for ax, step in zip(axes.flat, SHOWN, strict=True):
        cloud = found.clouds[step]
        pgm.plot.occupancy_map(drive.map, ax=ax)
        pgm.plot.particles(
            cloud, ticks=False, truth=drive.poses[found.first + step], colour=_FOUND, ax=ax
        )
        ax.set_title(f"step {step}: {len(cloud.weights):,} particles")
        ax.label_outer()
        if (legend := ax.get_legend()) is not None:
            legend.remove()
    _around(axes[0, 0], drive.poses)
    plt.close(figure)
    return figure


def strays(found: Sequence[Stray]) -> Figure:
    """Errors of all starts from anywhere."""
    figure, ax = plt.subplots(figsize=(9, 4.2), layout="constrained")
    labels = {True: "found", False: "not found"}
    for each in found:
        known = each.found_at is not None
        ax.plot(
            each.followed.distance,
            color=_FOUND if known else _RECKONED,
            lw=0.9,
            label=labels.pop(known, None),
        )
    ax.axhline(LOST, color=INK, lw=0.6, ls="--")
    ax.set(yscale="log", xlabel="step", ylabel="distance [m]")
    ax.grid(color=MUTED, alpha=0.25, lw=0.6)
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    plt.close(figure)
    return figure


def grid(drive: Drive, found: Gridded) -> Figure:
    """The grid's beliefs of the place at the first steps, and errors beside the particles'."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 5.4), layout="constrained")
    for ax, step in zip(axes[:2], (0, 1), strict=True):
        pgm.plot.occupancy_map(drive.map, ax=ax)
        belief = found.grid[pose.at(step)].marginal("east", "north")
        shown = np.ma.masked_less(belief.values / belief.values.max(), 1e-3)
        drawn = ax.pcolormesh(*belief.centres, shown.T, cmap="viridis", vmin=0.0, vmax=1.0)
        ax.plot(*drive.poses[found.first + step, :2], "x", color=_RECKONED, ms=9, mew=2)
        ax.set_title(f"step {step}")
        centres = [(each.min(), each.max()) for each in belief.centres]
        ax.set(xlim=centres[0], ylim=centres[1])
        drawn.set_rasterized(True)
    axes[1].label_outer()
    figure.colorbar(drawn, ax=axes[:2], label="probability, the largest being 1", shrink=0.8)
    for colour, (name, each) in zip(PALETTE, found.followed.items(), strict=False):
        axes[2].plot(each.distance, color=colour, label=name)
    axes[2].set(yscale="log", xlabel="step", ylabel="distance [m]")
    axes[2].grid(color=MUTED, alpha=0.25, lw=0.6)
    axes[2].legend(frameon=False)
    plt.close(figure)
    return figure


def _around(ax: Axes, poses: Array) -> None:
    """Cut a picture to poses and some metres around."""
    low, high = poses[:, :2].min(axis=0) - MARGIN, poses[:, :2].max(axis=0) + MARGIN
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
