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
from pgm.plot.drawing.colours import INK, MUTED, PALETTE

Array = npt.NDArray[np.float64]
# The methods that are drawn.
DRAWN = {"filter": PALETTE[0], "smoother": PALETTE[1], "robust smoother": PALETTE[2]}
# How far beyond landmarks and estimates a path may go, as a share of their extent.
MARGIN = 0.15


def paths(drive: Drive, shown: dict[str, pgm.results.Posterior]) -> Figure:
    """The plane: landmarks, dead reckoning, estimates, truth."""
    figure, ax = plt.subplots(figsize=(7.5, 7), layout="constrained")
    reckoned = pgm.filter(drive.network(), drive.motion)[pose].mean
    ax.plot(*reckoned[:, :2].T, color=MUTED, lw=0.8, ls=":", label="dead reckoning")
    known = [reckoned[:, :2]]
    for variable, sensor in drive.sensors.items():
        if "east" in variable.components:
            read = np.asarray(drive.evidence[variable].values)[:, :2]
            known.append(read[np.isfinite(read).all(axis=1)])
            colour = PALETTE[3 + (len(known) - 2) % 3]
            ax.plot(*read.T, ".", color=colour, ms=3.5, label=sensor.stream)
    for label in ("filter", "smoother") if shown else ():
        mean = shown[label][pose].mean
        ax.plot(*mean[:, :2].T, color=DRAWN[label], lw=0.9, label=label)
    if shown:  # dead reckoning may lead anywhere
        known = [shown["smoother"][pose].mean[:, :2], *known[1:]]
    if drive.truth is not None:
        ax.plot(*drive.truth[:, :2].T, color=INK, lw=0.7, label="truth")
        known.append(drive.truth[np.isfinite(drive.truth[:, 0]), :2])
    if any(sensor.kind.of_landmarks for sensor in drive.setting.sensors):
        places = np.array([place[:2] for place in drive.recording.landmarks.values()])
        known.append(places)
        ax.plot(*places.T, "^", color=INK, markersize=6, label="landmarks")
    every = np.concatenate(known)
    low, high = every.min(axis=0), every.max(axis=0)
    # A straight drive has no extent across; the other one's stands for it.
    spare = MARGIN * np.maximum(high - low, 0.2 * (high - low).max() + 1e-9)
    ax.set(
        xlim=(low[0] - spare[0], high[0] + spare[0]),
        ylim=(low[1] - spare[1], high[1] + spare[1]),
        xlabel="east [m]",
        ylabel="north [m]",
    )
    ax.set_aspect("equal", adjustable="box")
    figure.legend(loc="outside upper center", ncols=5)
    return figure


def errors(drive: Drive, shown: dict[str, pgm.results.Posterior]) -> Figure:
    """Distances from the truth over time, and the filter's own bound."""
    assert drive.truth is not None
    figure, ax = plt.subplots(figsize=(10, 3.6), layout="constrained")
    times = drive.timeline.times - drive.timeline.times[0]
    beliefs = {label: shown[label][pose] for label in DRAWN if shown}
    if not shown:
        beliefs["dead reckoning"] = pgm.filter(drive.network(), drive.motion)[pose]
    for label, belief in beliefs.items():
        away = np.linalg.norm(belief.mean[:, :2] - drive.truth[:, :2], axis=-1)
        ax.plot(times, away, color=DRAWN.get(label, PALETTE[0]), lw=0.8, label=label)
    label, belief = next(iter(beliefs.items()))
    spread = np.linalg.eigvalsh(belief.cov[:, :2, :2])[:, -1]
    bound = np.sqrt(-2.0 * np.log(0.05) * spread)
    whose = f"95 % of the longest axis of the {label}" if shown else "95 % of its longest axis"
    ax.plot(times, bound, color=MUTED, lw=0.8, ls="--", label=whose)
    ax.set(xlabel="time [s]", ylabel="error [m]", ylim=(0.0, None))
    ax.margins(x=0.01)
    figure.legend(loc="outside upper center", ncols=4)
    return figure


def ranked(drive: Drive, ranking: Ranking) -> Figure:
    """Landmarks by their innovations, over time."""
    height = max(3.9, 1.5 + 0.55 * len(ranking))  # the axis has its label
    figure, ax = plt.subplots(figsize=(10, height), layout="constrained")
    times = drive.timeline.times - drive.timeline.times[0]
    # Windows of some eight readings a landmark, or more.
    readings = int(np.mean([row.average.count for row in ranking.rows]))
    windows = int(np.clip(readings // 8, 8, 60))
    pgm.plot.ranking(ranking, windows=windows, times=times, ax=ax)
    ax.set_xlabel("time [s]")
    return figure
