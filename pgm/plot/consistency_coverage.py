"""The share of regions that hold the truth, against the share that they promise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from pgm import consistency
from pgm.factors import Gaussian
from pgm.inference import Kind
from pgm.plot.axes import given_or_new, name_axes, useful_legend
from pgm.plot.colours import INK, next_colour
from pgm.plot.components import check_gaussian
from pgm.plot.consistency_bands import band

_LEVELS = np.concatenate([[0.01], np.linspace(0.05, 0.95, 19), [0.99]])
_DIAGONAL = np.array([[0.0, 0.0], [1.0, 1.0]])


def coverage(
    belief: Gaussian,
    truth: npt.ArrayLike,
    *,
    components: Sequence[str] = (),
    confidence: float = 0.95,
    label: str | Kind | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the share of truths inside regions against their confidence, with binomial intervals.

    A right belief is on the diagonal. Below it claims too much, above too little. Call it again
    with the same `ax` to compare beliefs: each takes the next colour.

    Parameters
    ----------
    belief : Gaussian
        Over runs and steps, as ``posterior[x]``.
    truth : array_like
        (..., n).
    components : sequence of str
        Whose region, two for an ellipse in the plane; all without.
    confidence : float
        Probability of the intervals, which count runs alone.
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
        If an argument does not fit the belief.
    NumericalError
        If a covariance is singular.
    """
    found = consistency.coverage(
        check_gaussian(belief), truth, _LEVELS, components, band=confidence
    )
    ax = given_or_new(ax)
    tint = colour or next_colour(ax)
    if not any(np.array_equal(line.get_xydata(), _DIAGONAL) for line in ax.lines):
        ax.plot(*_DIAGONAL.T, color=INK, lw=0.8, zorder=1.5)
    band(ax, found.nominal, found.low, found.high, tint)
    ax.plot(
        found.nominal,
        found.actual,
        color=tint,
        lw=1.5,
        marker=".",
        zorder=2.2,
        label=str(label or "coverage"),
    )
    ax.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0), aspect="equal")
    name_axes(ax, "confidence of the region", "share of truths inside")
    useful_legend(ax)
    return ax
