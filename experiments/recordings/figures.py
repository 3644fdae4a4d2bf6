"""A recorded drive: its paths, its errors, and its sensors ranked."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.recordings.drives import Drive
from models.networks import pose
from pgm.consistency import Ranking
from pgm.plot.colours import INK, MUTED, PALETTE

Array = npt.NDArray[np.float64]
# The methods that are drawn.
DRAWN = {"filter": PALETTE[0], "smoother": PALETTE[1], "robust smoother": PALETTE[2]}
# How far beyond landmarks and estimates a path may go, as a share of their extent.
MARGIN = 0.15


def paths(drive: Drive, shown: dict[str, pgm.ChainPosterior]) -> Figure:
    """The plane: landmarks, dead reckoning, estimates, truth."""
    figure, ax = plt.subplots(figsize=(7.5, 7), layout="constrained")
    reckoned = pgm.filter(drive.network(), drive.motion)[pose].mean
    ax.plot(*reckoned[:, :2].T, color=MUTED, lw=0.8, ls=":", label="dead reckoning")
    for label in ("filter", "smoother"):
        mean = shown[label][pose].mean
        ax.plot(*mean[:, :2].T, color=DRAWN[label], lw=0.9, label=label)
    if drive.truth is not None:
        ax.plot(*drive.truth[:, :2].T, color=INK, lw=0.7, label="truth")
    places = np.array([place[:2] for place in drive.recording.landmarks.values()])
    ax.plot(*places.T, "^", color=INK, markersize=6, label="landmarks")
    known = np.concatenate([places, shown["smoother"][pose].mean[:, :2]])
    low, high = known.min(axis=0), known.max(axis=0)
    spare = MARGIN * (high - low)
    ax.set(
        xlim=(low[0] - spare[0], high[0] + spare[0]),
        ylim=(low[1] - spare[1], high[1] + spare[1]),
        xlabel="east [m]",
        ylabel="north [m]",
    )
    ax.set_aspect("equal", adjustable="box")
    figure.legend(loc="outside upper center", ncols=5)
    return figure


def errors(drive: Drive, shown: dict[str, pgm.ChainPosterior]) -> Figure:
    """Distances from the truth over time, and the filter's own bound."""
    assert drive.truth is not None
    figure, ax = plt.subplots(figsize=(10, 3.6), layout="constrained")
    times = drive.timeline.times - drive.timeline.times[0]
    for label, colour in DRAWN.items():
        away = np.linalg.norm(shown[label][pose].mean[:, :2] - drive.truth[:, :2], axis=-1)
        ax.plot(times, away, color=colour, lw=0.8, label=label)
    spread = np.linalg.eigvalsh(shown["filter"][pose].cov[:, :2, :2])[:, -1]
    bound = np.sqrt(-2.0 * np.log(0.05) * spread)
    ax.plot(times, bound, color=MUTED, lw=0.8, ls="--", label="95 % of the filter's longest axis")
    ax.set(xlabel="time [s]", ylabel="error [m]", ylim=(0.0, None))
    ax.margins(x=0.01)
    figure.legend(loc="outside upper center", ncols=4)
    return figure


def ranked(drive: Drive, ranking: Ranking) -> Figure:
    """Landmarks by their innovations, over time."""
    height = 1.5 + 0.55 * len(ranking)
    figure, ax = plt.subplots(figsize=(10, height), layout="constrained")
    times = drive.timeline.times - drive.timeline.times[0]
    # Windows of some eight readings a landmark, or more.
    readings = int(np.mean([row.average.count for row in ranking.rows]))
    windows = int(np.clip(readings // 8, 8, 60))
    pgm.plot.ranking(ranking, windows=windows, times=times, ax=ax)
    ax.set_xlabel("time [s]")
    return figure
