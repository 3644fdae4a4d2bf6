"""What plots of statistics over time share: their horizontal axis, a band, a line."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba

from pgm.errors import ModelError
from pgm.kernels.arrays import Array


def along(steps: npt.NDArray[np.int_], times: npt.ArrayLike | None) -> tuple[npt.NDArray[Any], str]:
    """Where values of steps stand on the horizontal axis, and what it is called."""
    if times is None:
        return steps, "step"
    array = np.asarray(times)
    if array.shape != steps.shape:
        raise ModelError(f"times has shape {array.shape}; {steps.shape} was due, one for each step")
    return array, "time"


def band(
    ax: Axes, across: npt.NDArray[Any], low: Array, high: Array, tint: str, label: str | None = None
) -> None:
    """Shade between two curves; an outline keeps a band of no width visible."""
    ax.fill_between(
        across,
        low,
        high,
        facecolor=to_rgba(tint, 0.12),
        edgecolor=to_rgba(tint, 0.5),
        lw=0.8,
        zorder=1.0,
        label=label,
    )


def line(
    ax: Axes,
    across: npt.NDArray[Any],
    values: Array,
    tint: str,
    label: str | None = None,
    *,
    dots: bool = False,
) -> None:
    """Draw a curve, with a dot at each value if asked for, or if there is but one."""
    marker = "." if dots or len(across) == 1 else None
    ax.plot(across, values, color=tint, lw=1.5, marker=marker, zorder=2.2, label=label)
