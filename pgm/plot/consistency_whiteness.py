"""The autocorrelation of innovations, in the band of white ones."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.container import StemContainer
from matplotlib.ticker import MaxNLocator

from pgm import consistency
from pgm.inference import Innovations, Kind
from pgm.plot.axes import given_or_new, name_axes, useful_legend
from pgm.plot.colours import INK, next_colour
from pgm.plot.consistency_bands import right_band

# How far to the right of its lag the stems of further innovations may stand, in lags.
_WITHIN = 0.6
# Bands that come of the readings themselves, as many of them, differ by chance.
_ALIKE = 0.2


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
        As ``posterior.innovations[z]``.
    lags : int
        The number of lags, in steps at which the sensor was read.
    confidence : float
        Probability of the band, at each lag.
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
        If there are no more steps with readings than lags, or an argument is not what it should
        be.
    """
    found = consistency.whiteness(innovations, lags, confidence=confidence)
    ax = given_or_new(ax)
    tint = colour or next_colour(ax)
    label = str(label or "innovations")
    first = right_band(
        ax,
        found.lags,
        -found.band,
        found.band,
        tint,
        confidence=confidence,
        label=label,
        tolerance=_ALIKE,
    )
    if first:
        ax.axhline(0.0, color=INK, lw=0.8, zorder=1.5)
    before = sum(isinstance(each, StemContainer) for each in ax.containers)
    beside = _WITHIN * _between(before)
    ax.stem(
        found.lags + beside,
        found.autocorrelation,
        linefmt=tint,
        markerfmt=".",
        basefmt=" ",
        label=f"{label}, p = {found.probability:.2g}",
    )
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
