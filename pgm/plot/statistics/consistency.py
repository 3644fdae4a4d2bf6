"""Statistics of consistency: averages and coverage in their bands, and whiteness."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.container import StemContainer
from matplotlib.ticker import MaxNLocator

from pgm import consistency
from pgm.arguments import public
from pgm.consistency import Average
from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.inference import Innovations, Kind
from pgm.plot.drawing.axes import (
    along,
    band,
    given_or_new,
    line,
    name_axes,
    name_time,
    right_band,
    useful_legend,
)
from pgm.plot.drawing.colours import INK, look_of

_LEVELS = np.concatenate([[0.01], np.linspace(0.05, 0.95, 19), [0.99]])
_DIAGONAL = np.array([[0.0, 0.0], [1.0, 1.0]])
# How far to the right of its lag the stems of further innovations may stand, in lags.
_WITHIN = 0.6
# Bands that come of the measurements themselves, as many of them, differ by chance.
_ALIKE = 0.2


@public
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
    label, colour, ax
        See `trajectory`.

    Raises
    ------
    ModelError
        If the belief is over no steps, or an argument does not fit it.
    NumericalError
        If a covariance is singular.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> belief = pgm.Gaussian(x, mean=[[2.0], [4.0]], cov=4.0, steps=[0, 1])
    >>> ax = pgm.plot.nees(belief, truth=[[0.0], [0.0]])
    >>> ax.get_ylabel()
    'NEES / degrees of freedom'
    """
    average = consistency.anees(belief, truth, components, confidence=confidence).per_dof()
    if belief.steps is None:
        raise ModelError(
            f"{titled(belief)} is over no steps; draw one over time, like posterior[x]"
        )
    across, name = along(belief.steps, times)
    ax = given_or_new(ax)
    _draw(ax, across, average, str(label or "NEES"), colour, confidence)
    name_time(ax, name, "NEES / degrees of freedom")
    useful_legend(ax, above=True)
    return ax


@public
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
    without measurements are left out, and nothing is drawn across a gap longer than is usual (the
    median) between measurements. Call it again with the same `ax` to compare.

    Parameters
    ----------
    innovations : Innovations
        For instance ``posterior.innovations[z]``.
    confidence : float
        Probability of the band, at each step.
    times : array_like, optional
        (steps,), of steps 0 to T, for the horizontal axis; the steps themselves without.
    label, colour, ax
        See `trajectory`.

    Raises
    ------
    ModelError
        If an argument is not what it should be.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> filtered = pgm.filter(walk, {z: [[2.0], [3.0]]})
    >>> ax = pgm.plot.nis(filtered.innovations[z], label="Kalman filter")
    """
    average = consistency.anis(innovations, confidence=confidence).per_dof()
    across, name = along(np.arange(average.value.size), times)
    ax = given_or_new(ax)
    _draw(ax, across, average, str(label or "NIS"), colour, confidence)
    name_time(ax, name, "NIS / degrees of freedom")
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
    look = look_of(ax, colour)
    if right_band(ax, across, low, high, look.colour, confidence=confidence, label=label):
        ax.axhline(1.0, color=INK, lw=0.8, zorder=1.5)
    # Dots tell which steps a line over gaps joins, and show a step alone between two of them.
    line(ax, across, value, look, label, dots=bool((spacing > 1).any()))


@public
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
    label, colour, ax
        See `trajectory`.

    Raises
    ------
    ModelError
        If an argument does not fit the belief.
    NumericalError
        If a covariance is singular.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> runs = pgm.Gaussian(x, mean=[[0.0], [1.0], [-1.0], [3.0]], cov=1.0)
    >>> ax = pgm.plot.coverage(runs, truth=[0.0])
    """
    found = consistency.coverage(belief, truth, _LEVELS, components, band=confidence)
    ax = given_or_new(ax)
    look = look_of(ax, colour)
    if not any(np.array_equal(each.get_xydata(), _DIAGONAL) for each in ax.lines):
        ax.plot(*_DIAGONAL.T, color=INK, lw=0.8, zorder=1.5)
    band(ax, found.nominal, found.low, found.high, look.colour, dash=look.dash)
    line(ax, found.nominal, found.actual, look, str(label or "coverage"), dots=True)
    ax.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0), aspect="equal")
    name_axes(ax, "confidence of the region", "share of truths inside")
    useful_legend(ax)
    return ax


@public
def whiteness(
    innovations: Innovations,
    *,
    lags: int = 20,
    confidence: float = 0.95,
    label: str | Kind | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the autocorrelation of whitened innovations at each lag, in the band of white ones.

    Of white innovations about so many lags are inside the band as its confidence says. The
    legend has the probability that white ones are farther out, taken over all lags. Call it
    again with the same `ax` to compare: the stems stand beside the others, and a band that is
    another one is drawn in their colour. After iterating, the innovations are those of the last
    linearisation: see `pgm.consistency.whiteness`.

    Parameters
    ----------
    innovations : Innovations
        For instance ``posterior.innovations[z]``.
    lags : int
        The number of lags, in steps at which the sensor was read.
    confidence : float
        Probability of the band, at each lag.
    label, colour, ax
        See `trajectory`.

    Raises
    ------
    ModelError
        If there are no more steps with measurements than lags, or an argument is not what it should
        be.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> filtered = pgm.filter(walk, {z: [[2.0], [3.0], [1.0], [0.0], [2.0]]})
    >>> ax = pgm.plot.whiteness(filtered.innovations[z], lags=3)
    """
    found = consistency.whiteness(innovations, lags, confidence=confidence)
    ax = given_or_new(ax)
    look = look_of(ax, colour)
    label = str(label or "innovations")
    first = right_band(
        ax,
        found.lags,
        -found.band,
        found.band,
        look.colour,
        confidence=confidence,
        label=label,
        tolerance=_ALIKE,
    )
    if first:
        ax.axhline(0.0, color=INK, lw=0.8, zorder=1.5)
    before = sum(isinstance(each, StemContainer) for each in ax.containers)
    beside = _WITHIN * _between(before)
    stems = ax.stem(
        found.lags + beside,
        found.autocorrelation,
        linefmt=look.colour,
        markerfmt=look.mark,
        basefmt=" ",
        label=f"{label}, p = {found.probability:.2g}",
    )
    stems.stemlines.set(linestyle=look.dash)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    name_axes(ax, "lag", "autocorrelation")
    # "best" does not see the stems.
    useful_legend(ax, above=True)
    return ax


def _between(index: int) -> float:
    """The sequence 0, ½, ¼, ¾, ⅛, … in [0, 1): however many there are, no two at one place."""
    place, half = 0.0, 0.5
    while index:
        index, bit = divmod(index, 2)
        place, half = place + bit * half, 0.5 * half
    return place
