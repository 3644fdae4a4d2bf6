"""The way of the log-evidence up, and errors before and after."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

import pgm
from experiments.recordings.drives import Drive
from models.networks import pose
from pgm.plot.drawing.colours import INK, PALETTE

Array = npt.NDArray[np.float64]
LEAST = 1e-3  # nats, the least shortfall that is drawn


def trace(found: dict[str, Any], fitted: float) -> Figure:
    """The log-evidence after each iteration, and what each lacks to its end."""
    figure, (whole, lacking) = plt.subplots(
        1, 2, figsize=(11, 4), sharex=True, layout="constrained"
    )
    for (way, each), colour in zip(found.items(), PALETTE, strict=False):
        values = np.asarray(each["log_evidence"])
        steps = np.arange(len(values))
        label = f"calibration as a {way}"
        whole.plot(steps, values, "-o", ms=3, lw=1.2, color=colour, label=label)
        short = values[-1] - values[:-1]
        lacking.semilogy(steps[:-1], np.maximum(short, LEAST), "-o", ms=3, lw=1.2, color=colour)
    whole.axhline(fitted, color=INK, lw=0.8, ls=":", label="fitted with the truth")
    whole.set(xlabel="iteration", ylabel="log-evidence [nats]")
    lacking.set(xlabel="iteration", ylabel="lacking to the end [nats]")
    figure.legend(loc="outside upper center", ncols=3)
    plt.close(figure)
    return figure


def errors(drive: Drive, posteriors: dict[str, pgm.results.Posterior]) -> Figure:
    """How far each smoother is from the truth over time."""
    figure, ax = plt.subplots(figsize=(11, 4), layout="constrained")
    times = drive.timeline.times - drive.timeline.times[0]
    assert drive.truth is not None
    for (label, posterior), colour in zip(posteriors.items(), PALETTE, strict=False):
        apart = np.linalg.norm(posterior[pose].mean[:, :2] - drive.truth[:, :2], axis=-1)
        ax.semilogy(times, apart, lw=0.8, color=colour, label=label)
    ax.set(xlabel="time [s]", ylabel="distance from the truth [m]")
    ax.set_ylim(bottom=1e-2)
    ax.margins(x=0.01)
    figure.legend(loc="outside upper center", ncols=3)
    plt.close(figure)
    return figure
