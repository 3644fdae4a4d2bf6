"""A drive as a moving picture."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import pgm.plot
from experiments.differential_drive.errors import at_steps
from experiments.differential_drive.figures import MOTION, READING, SMOOTHED
from experiments.differential_drive.particles import Cloud
from experiments.differential_drive.problems import DT, LANDMARK, MOTIONS
from experiments.differential_drive.results import Drive
from pgm.plot.drawing.colours import INK, MUTED
from pgm.plot.moving.movies import GifWriter

# Motions from a picture to the next. Odd numbers of half seconds: pictures are by turns of a motion
# halfway between readings and of a reading. The longest drive skips more, for the size of its file.
EVERY = {"1": 5 * (MOTIONS // 2), "2a": MOTIONS // 2, "2b": MOTIONS // 2}
_RATE = 10  # pictures a second
_NEAR = 2.0  # m, how far the picture that follows the robot reaches, at most
_PARTICLES = SMOOTHED  # their colour: an animation shows no smoother


def animate(drive: Drive, cloud: Cloud, path: Path) -> int:
    """Write a GIF, the whole map beside what is near the robot; returns how many pictures.

    The Kalman filter's estimate and ellipse stand beside the particles of the same drive.
    """
    steps = range(0, drive.problem.steps + 1, EVERY[drive.problem.name])
    figure, axes = plt.subplots(1, 2, figsize=(7.2, 3.9))
    # Fixed, so that nothing shakes and titles are whole, whatever the limits of a picture.
    figure.subplots_adjust(left=0.09, right=0.98, bottom=0.25, top=0.92, wspace=0.22)
    writer = GifWriter(fps=_RATE)
    with writer.saving(figure, str(path), dpi=75):
        for step in steps:
            _draw(drive, cloud, step, axes)
            if step == 0:
                handles, labels = axes[0].get_legend_handles_labels()
                figure.legend(handles, labels, loc="lower center", ncols=4, fontsize="small")
            writer.grab_frame()
    plt.close(figure)
    return len(steps)


def _draw(drive: Drive, cloud: Cloud, step: int, axes: Iterable[Axes]) -> None:
    """One picture: truth and estimates up to a step, the ellipse and the particles at it."""
    past, here = slice(0, step + 1), drive.truth[step, :2]
    measured = step in drive.problem.measured
    whole, near = axes
    for ax in (whole, near):
        ax.clear()
        ax.grid(color=MUTED, alpha=0.2, lw=0.6)
        ax.plot(*drive.truth[past, :2].T, color=INK, lw=1.0, label="truth")
        ax.plot(*drive.filtered.mean[past, :2].T, color=MOTION, lw=1.2, label="Kalman filter")
        ax.plot(*cloud.mean[past, :2].T, color=_PARTICLES, lw=1.0, ls="--", label="particles' mean")
        ax.plot(
            *cloud.states[step, :, :2].T,
            ".",
            color=_PARTICLES,
            markersize=2.5,
            alpha=0.7,
            label=f"{cloud.states.shape[1]} particles",
        )
        ax.plot(*here, "o", color=INK, markersize=4)
        if drive.problem.given:
            ax.plot(*LANDMARK, "^", color=INK, markersize=6)
            if measured:
                ax.plot(*np.stack([here, LANDMARK], axis=1), color=READING, lw=0.8, ls=":")
        pgm.plot.ellipses(
            at_steps(drive.filtered, [step]),
            colour=READING if measured else MOTION,
            ax=ax,
            linewidth=1.6,
            zorder=4,
        )
        ax.set(xlabel="east [m]", ylabel="north [m]", aspect="equal")
    centre, half = _bounds(drive, cloud)
    _limit(whole, centre, half)
    _limit(near, here, min(_NEAR, 0.4 * half))
    kind = "the start" if step == 0 else "after a reading" if measured else "after a motion"
    near.set_title(kind, fontsize="small")
    whole.set_title(f"problem {drive.problem.name}, {step * DT:.1f} s", fontsize="small")


def _bounds(drive: Drive, cloud: Cloud) -> tuple[np.ndarray, float]:
    """Centre and half width of a square that holds the whole drive, ellipses and particles."""
    means, reach = drive.filtered.mean[:, :2], 2.5 * drive.filtered.std[:, :2]  # of 95 % ellipses
    places = np.concatenate(
        [drive.truth[:, :2], means - reach, means + reach, cloud.states[..., :2].reshape(-1, 2)]
    )
    lows, highs = places.min(axis=0), places.max(axis=0)
    return 0.5 * (lows + highs), 0.56 * float((highs - lows).max())


def _limit(ax: Axes, centre: np.ndarray, half: float) -> None:
    ax.set(xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] - half, centre[1] + half))
