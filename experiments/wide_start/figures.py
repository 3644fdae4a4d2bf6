"""Beliefs that began wide, over time."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.recordings.drives import Drive
from pgm.plot.drawing.colours import INK, PALETTE

Array = npt.NDArray[np.float64]


def empty() -> tuple[Figure, Axes]:
    """A figure with one axes."""
    return plt.subplots(figsize=(9, 4), layout="constrained")


def over_time(drive: Drive, found: dict[str, Array]) -> Figure:
    """The 90th percentile over starts of the NEES (starts, T+1) at each step."""
    figure, ax = empty()
    times = drive.timeline.times - drive.timeline.times[0]
    for (label, nees), colour in zip(found.items(), PALETTE, strict=False):
        ax.semilogy(times, np.percentile(nees, 90, axis=0), color=colour, lw=1.2, label=label)
    ax.axhline(1.0, color=INK, lw=0.8, ls=":")
    ax.set(xlabel="time [s]", ylabel="NEES a component, 90 % of starts")
    ax.margins(x=0.01)
    figure.legend(loc="outside upper center", ncols=3)
    return figure
