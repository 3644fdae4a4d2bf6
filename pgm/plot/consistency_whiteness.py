"""The autocorrelation of innovations, in the band of white ones."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from pgm import consistency
from pgm.inference import Innovations
from pgm.plot.axes import given_or_new, name_axes, useful_legend
from pgm.plot.colours import INK, MUTED, next_colour
from pgm.plot.consistency_bands import band

# How far the stems of the next innovations stand to the right, in lags.
_BESIDE = 0.22


def whiteness(
    innovations: Innovations,
    *,
    lags: int = 20,
    confidence: float = 0.95,
    label: str | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the autocorrelation of whitened innovations at each lag, in the band of white ones.

    Of white innovations about so many lags are inside the band as its confidence says. The
    legend has the probability that white ones are farther out, taken over all lags. Call it
    again with the same `ax` to compare: the stems stand beside the others.

    Parameters
    ----------
    innovations : Innovations
        As ``posterior.innovations[z]``.
    lags : int
        The number of lags, in steps at which the sensor was read.
    confidence : float
        Probability of the band, at each lag.
    label : str, optional
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
        If there are no more steps with readings than lags.
    """
    found = consistency.whiteness(innovations, lags, confidence=confidence)
    ax = given_or_new(ax)
    tint = colour or next_colour(ax)
    if not ax.lines:
        ax.axhline(0.0, color=INK, lw=0.8, zorder=1.5)
        within = f"{100.0 * confidence:.4g} % band"
        band(ax, found.lags, -found.band, found.band, MUTED, label=within)
    beside = _BESIDE * len(ax.containers)
    ax.stem(
        found.lags + beside,
        found.autocorrelation,
        linefmt=tint,
        markerfmt=".",
        basefmt=" ",
        label=f"{label or 'innovations'}, p = {found.probability:.2g}",
    )
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    name_axes(ax, "lag", "autocorrelation")
    # "best" does not see the stems.
    useful_legend(ax, above=True)
    return ax
