"""Sizes over time of many runs: errors, and how far beliefs are from others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from pgm import consistency
from pgm.factors import Gaussian
from pgm.inference import Kind
from pgm.plot.axes import given_or_new, name_axes, useful_legend
from pgm.plot.colours import next_colour
from pgm.plot.components import check_gaussian
from pgm.plot.consistency_bands import along, band, line


def rmse(
    belief: Gaussian,
    truth: npt.ArrayLike,
    *,
    components: Sequence[str] = (),
    percentiles: tuple[float, float] = (5.0, 95.0),
    times: npt.ArrayLike | None = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the RMSE over runs at each step, over a band of percentiles of single runs' errors.

    The line is what a few bad runs can rule; the band is what they cannot. Call it again with
    the same `ax` to compare beliefs: each takes the next colour.

    Parameters
    ----------
    belief : Gaussian
        Over steps, as ``posterior[x]``.
    truth : array_like
        (*runs, steps, n).
    components : sequence of str
        Over which the error's length is taken; all without.
    percentiles : pair of float
        Of the band, in percent.
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
    """
    found = consistency.rmse_over_time(
        check_gaussian(belief), truth, components, percentiles=percentiles
    )
    across, name = along(found.steps, times)
    ax = given_or_new(ax)
    tint = colour or next_colour(ax)
    label = str(label or "RMSE")
    if found.runs > 1:
        band(ax, across, found.low, found.high, tint, label=_between(label, percentiles))
    line(ax, across, found.rms, tint, label)
    ax.set_ylim(bottom=0.0)
    name_axes(ax, name, f"error in {', '.join(components)}" if components else "error")
    useful_legend(ax)
    return ax


def kl(
    p: Gaussian,
    q: Gaussian,
    *,
    percentiles: tuple[float, float] = (5.0, 95.0),
    times: npt.ArrayLike | None = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw KL(p ‖ q) at each step on a logarithmic axis: its median, and percentiles, over runs.

    Call it again with the same `ax` to compare several q with one p: each takes the next colour.
    What is zero, which has no logarithm, is left out.

    Parameters
    ----------
    p, q : Gaussian
        Over steps, as ``posterior[x]``; p is the one to be right.
    percentiles : pair of float
        Of the band, in percent.
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
        If the beliefs are over no steps, or not of the same variables.
    NumericalError
        If a covariance is singular.
    """
    divergence = consistency.kl(check_gaussian(p), check_gaussian(q))
    found = consistency.over_time(divergence, p.steps, percentiles)
    across, name = along(found.steps, times)
    ax = given_or_new(ax)
    ax.set_yscale("log")
    tint = colour or next_colour(ax)
    label = str(label or "KL")
    low, median, high = (
        np.where(part > 0.0, part, np.nan) for part in (found.low, found.median, found.high)
    )
    if found.runs > 1:
        band(ax, across, low, high, tint, label=_between(label, percentiles))
    line(ax, across, median, tint, label if found.runs == 1 else f"{label}, median")
    name_axes(ax, name, "KL divergence [nats]")
    useful_legend(ax)
    return ax


def _between(label: str, percentiles: tuple[float, float]) -> str:
    return f"{label}, {percentiles[0]:g} to {percentiles[1]:g} % of runs"
