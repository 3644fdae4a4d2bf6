"""Common parts of plots over time: the horizontal axis, a band, a line."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import Collection, FillBetweenPolyCollection
from matplotlib.colors import to_rgba
from matplotlib.ticker import MaxNLocator

from pgm.errors import ModelError
from pgm.kernels.arrays import Array
from pgm.plot.axes import name_axes
from pgm.plot.colours import MUTED, Look

STEP = "step"
_BAND = "band"


def along(steps: npt.NDArray[np.int_], times: npt.ArrayLike | None) -> tuple[npt.NDArray[Any], str]:
    """The places of steps on the horizontal axis, and its label."""
    if times is None:
        return steps, STEP
    array = np.asarray(times)
    if array.shape != steps.shape:
        raise ModelError(f"times has shape {array.shape}; {steps.shape} was due, one for each step")
    return array, "time"


def name_time(ax: Axes, x: str, y: str) -> None:
    """Label the axes; steps are whole numbers."""
    name_axes(ax, x, y)
    if x == STEP:
        ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def band(
    ax: Axes,
    across: npt.NDArray[Any],
    low: Array,
    high: Array,
    tint: str,
    label: str | None = None,
    *,
    dash: str = "-",
    inside: float = 0.12,
    outline: float = 0.5,
) -> FillBetweenPolyCollection:
    """Shade between two curves, within an outline, that a band of no width is visible by.

    Bands after the first of an axes are outlines alone: shades upon each other are all grey.
    """
    first = all(drawn.get_gid() != _BAND for drawn in ax.collections)
    face = to_rgba(tint, inside if first else 0.0)
    edge = to_rgba(tint, outline if first else 0.9)
    return ax.fill_between(
        across,
        low,
        high,
        facecolor=face,
        edgecolor=edge,
        lw=0.8,
        ls=dash,
        zorder=1.0,
        label=label,
        gid=_BAND,
    )


def right_band(
    ax: Axes,
    across: npt.NDArray[Any],
    low: Array,
    high: Array,
    tint: str,
    *,
    confidence: float,
    label: str,
    tolerance: float = 1e-6,
) -> bool:
    """Shade the band of what is right, in grey; in the tint of a curve that has another one.

    across: (k,), along the horizontal axis.
    label: The curve's, for the legend, if the band is its own.
    tolerance: How far the ends of two bands may differ, as a part of them, to be drawn as one.

    Returns: Whether it is the first one of the axes.
    """
    within = f"{100.0 * confidence:.4g} % band"
    before = [drawn for drawn in ax.collections if str(drawn.get_label()).endswith(" % band")]
    if not before:
        band(ax, across, low, high, MUTED, label=within)
        return True
    own = band(ax, across, low, high, tint, label=f"{label}, {within}")
    if any(_look_alike(own, other, tolerance) for other in before):
        own.remove()
    return False


def _look_alike(a: Collection, b: Collection, tolerance: float) -> bool:
    """Whether two bands have the same places along the axis and about the same ends."""
    ends = [[np.asarray(path.vertices) for path in one.get_paths()] for one in (a, b)]
    return [v.shape for v in ends[0]] == [v.shape for v in ends[1]] and all(
        np.allclose(v, w, rtol=tolerance) for v, w in zip(*ends, strict=True)
    )


def line(
    ax: Axes,
    across: npt.NDArray[Any],
    values: Array,
    look: Look,
    label: str | None = None,
    *,
    dots: bool = False,
) -> None:
    """Draw a curve, with a dot at each value if asked for, or if there is but one."""
    marker = "." if dots or len(across) == 1 else None
    ax.plot(
        across,
        values,
        color=look.colour,
        ls=look.dash,
        lw=1.5,
        marker=marker,
        zorder=2.2,
        label=label,
    )
