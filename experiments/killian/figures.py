"""The map and the paths on it, errors by distance, and beliefs of a robot that may be anywhere."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.killian.drive import Drive
from experiments.killian.graph import differing
from experiments.killian.localise import LOST, SHOWN, Followed, Gridded, Stray
from models.networks import pose
from pgm.plot.drawing.colours import INK, MUTED, PALETTE

Array = npt.NDArray[np.float64]

_FOUND, _RECKONED, _SCAN = PALETTE[0], PALETTE[1], PALETTE[2]
MARGIN = 5.0  # m
ZOOM = 12  # steps
SEEN = 1e-3  # of the likeliest cell's probability


def overview(drive: Drive, followed: Followed) -> Figure:
    """The map, the path that particles find, and that of the motions alone."""
    figure, ax = plt.subplots(figsize=(9, 8.2), layout="compressed")
    _map(drive, ax)
    ax.plot(*drive.dead_reckoning[:, :2].T, color=_RECKONED, lw=0.9, label="odometry alone")
    ax.plot(*drive.poses[:, :2].T, color=INK, lw=2.2, label="poses of the recording")
    ax.plot(*followed.belief.mean[:, :2].T, color=_FOUND, lw=1.0, label="particles")
    _around(drive, ax, np.concatenate([drive.dead_reckoning, drive.poses]))
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
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
        # An error of nothing, at the start, has no place on a logarithmic axis.
        gone = drive.distance[blind > 0.0]
        ax.plot(gone, blind[blind > 0.0], color=_RECKONED, lw=1.0, label="odometry alone")
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
    figure, ax = plt.subplots(figsize=(9, 7), layout="compressed")
    _map(drive, ax)
    ax.plot(*drive.poses[steps, :2].T, "o-", color=INK, lw=1.0, ms=3.0, label="the recording")
    belief = followed.belief[steps]
    pgm.plot.trajectory(belief, every=1, label="particles, 95 %", colour=_FOUND, ax=ax)
    east, north, heading = followed.belief.mean[worst]
    ranges, angles = drive.scans[worst], drive.log.angles
    met = ranges < drive.log.most
    course = heading + angles[met]
    ends = np.array([east, north]) + ranges[met, None] * np.stack(
        [np.cos(course), np.sin(course)], axis=-1
    )
    ax.plot(*ends.T, ".", color=_SCAN, ms=4.0, label=f"scan of step {worst}, where it is found")
    handles, labels = ax.get_legend_handles_labels()
    if (legend := ax.get_legend()) is not None:
        legend.remove()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    _around(drive, ax, drive.poses[steps])
    plt.close(figure)
    return figure


def stray(drive: Drive, found: Stray) -> Figure:
    """Particles over the whole map at the first steps."""
    figure, axes = plt.subplots(
        2, 2, figsize=(10, 9), sharex=True, sharey=True, layout="compressed"
    )
    for ax, step in zip(axes.flat, SHOWN, strict=True):
        cloud = found.clouds[step]
        _map(drive, ax)
        pgm.plot.particles(
            cloud, ticks=False, truth=drive.poses[found.first + step], colour=_FOUND, ax=ax
        )
        ax.set_title(f"step {step}: {len(cloud.weights):,} particles")
        ax.label_outer()
        if (legend := ax.get_legend()) is not None:
            legend.remove()
    _around(drive, axes[0, 0], drive.poses)
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
    figure, axes = plt.subplots(1, 3, figsize=(14, 4.8), layout="constrained")
    beliefs = [found.grid[pose.at(step)].marginal("east", "north") for step in (0, 1)]
    levels = [belief.values / belief.values.max() for belief in beliefs]
    cells = np.argwhere(levels[0] > SEEN)
    likely = np.stack(
        [axis[k] for axis, k in zip(beliefs[0].centres, cells.T, strict=True)], axis=1
    )
    place = drive.poses[found.first : found.first + 2, :2]
    for step, (ax, level) in enumerate(zip(axes, levels, strict=False)):
        _map(drive, ax)
        shown = np.ma.masked_less(level, SEEN)
        drawn = ax.pcolormesh(
            *beliefs[step].centres,
            shown.T,
            cmap="viridis_r",
            norm=LogNorm(SEEN, 1.0),
            rasterized=True,
        )
        ax.plot(*place[step], "o", color=_RECKONED, ms=16, mew=1.5, mfc="none")
        ax.set_title(f"step {step}")
        _around(drive, ax, np.concatenate([likely, place]))
    axes[1].set_ylabel("")
    figure.colorbar(drawn, ax=axes[:2], label="probability, the largest being 1", shrink=0.8)
    for colour, (name, each) in zip(PALETTE, found.followed.items(), strict=False):
        axes[2].plot(each.distance, color=colour, label=name)
    axes[2].set(yscale="log", xlabel="step", ylabel="distance [m]")
    axes[2].grid(color=MUTED, alpha=0.25, lw=0.6)
    axes[2].legend(frameon=False)
    plt.close(figure)
    return figure


def _map(drive: Drive, ax: Axes) -> None:
    pgm.plot.occupancy_map(drive.map, ax=ax)
    ax.set(xlabel="east [m]", ylabel="north [m]")


def _around(drive: Drive, ax: Axes, poses: Array) -> None:
    """Cut a picture to poses and some metres around, as far as the map goes."""
    corner, shape = drive.map.origin[:2], np.array(drive.map.shape[::-1])
    low = np.maximum(poses[:, :2].min(axis=0) - MARGIN, corner)
    high = np.minimum(poses[:, :2].max(axis=0) + MARGIN, corner + drive.map.resolution * shape)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    ax.set_aspect("equal", adjustable="box")
