"""Averages of normalised errors and innovations over time, in the bands of right ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from pgm import consistency
from pgm.consistency import Average
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.inference import Innovations, Kind
from pgm.plot.axes import given_or_new, name_axes, useful_legend
from pgm.plot.colours import INK, next_colour
from pgm.plot.components import check_gaussian
from pgm.plot.consistency_bands import along, line, right_band


def nees(
    belief: Gaussian,
    truth: npt.ArrayLike,
    *,
    components: Sequence[str] = (),
    confidence: float = 0.95,
    times: npt.ArrayLike | None = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the NEES over time, averaged over runs and divided by its degrees of freedom.

    A right belief has 1, within the χ² band. Above it claims too much, below too little. Call it
    again with the same `ax` to compare beliefs: each takes the next colour, and a band that
    differs from the first is drawn in it.

    Parameters
    ----------
    belief : Gaussian
        Over steps, as ``posterior[x]``, of one run or more.
    truth : array_like
        (*runs, steps, n).
    components : sequence of str
        Whose marginal is judged; all without.
    confidence : float
        Probability of the band, at each step.
    times : array_like, optional
        (steps,), for the horizontal axis; the steps themselves without.
    label : str or Kind, optional
        In the legend.
    colour : str, optional
        The next of a colour-blind-safe palette without.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError
        If the belief is over no steps, or an argument does not fit it.
    NumericalError
        If a covariance is singular.
    """
    average = consistency.anees(
        check_gaussian(belief), truth, components, confidence=confidence
    ).per_dof()
    if belief.steps is None:
        raise ModelError(f"{belief!r} is over no steps; draw one over time, like posterior[x]")
    across, name = along(belief.steps, times)
    ax = given_or_new(ax)
    _draw(ax, across, average, str(label or "NEES"), colour, confidence)
    name_axes(ax, name, "NEES / degrees of freedom")
    useful_legend(ax, above=True)
    return ax


def nis(
    innovations: Innovations,
    *,
    confidence: float = 0.95,
    times: npt.ArrayLike | None = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the NIS over time, averaged over runs and divided by its degrees of freedom.

    A right model has 1, within the χ² band, which is wider at steps where less was read. Steps
    without readings are left out, and nothing is drawn across a gap longer than is usual (the
    median) between readings. Call it again with the same `ax` to compare.

    Parameters
    ----------
    innovations : Innovations
        As ``posterior.innovations[z]``.
    confidence : float
        Probability of the band, at each step.
    times : array_like, optional
        (steps,), of steps 0 to T, for the horizontal axis; the steps themselves without.
    label : str or Kind, optional
        In the legend.
    colour : str, optional
        The next of a colour-blind-safe palette without.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError
        If an argument is not what it should be.
    """
    average = consistency.anis(innovations, confidence=confidence).per_dof()
    across, name = along(np.arange(average.value.size), times)
    ax = given_or_new(ax)
    _draw(ax, across, average, str(label or "NIS"), colour, confidence)
    name_axes(ax, name, "NIS / degrees of freedom")
    useful_legend(ax, above=True)
    return ax


def _draw(
    ax: Axes,
    across: npt.NDArray[Any],
    average: Average,
    label: str,
    colour: str | None,
    confidence: float,
) -> None:
    there = np.flatnonzero(average.count > 0)
    spacing = np.diff(there)
    usual = np.median(spacing) if spacing.size else 1
    breaks = np.flatnonzero(spacing > usual) + 1
    across = np.insert(across[there], breaks, across[there][breaks])
    value, low, high = (
        np.insert(each[there], breaks, np.nan)
        for each in (average.value, average.low, average.high)
    )
    tint = colour or next_colour(ax)
    if right_band(ax, across, low, high, tint, confidence=confidence, label=label):
        ax.axhline(1.0, color=INK, lw=0.8, zorder=1.5)
    # Dots tell which steps a line over gaps joins, and show a step alone between two of them.
    line(ax, across, value, tint, label, dots=bool((spacing > 1).any()))
