"""Sensors ranked by their innovations, over time."""

from __future__ import annotations

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.ticker import FixedLocator, NullLocator

from pgm.boundary import is_whole
from pgm.consistency import Ranked, Ranking
from pgm.display import number
from pgm.errors import ModelError
from pgm.kernels.arrays import Array
from pgm.plot.axes import given_or_new, name_axes, plain
from pgm.plot.bands import STEP, name_time
from pgm.plot.colours import INK, OBSERVED

# White where the innovations are as large as their covariances say.
_SCALE = matplotlib.colormaps["PuOr_r"].with_extremes(bad=OBSERVED)
_TICKS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)


def ranking(
    found: Ranking,
    *,
    windows: int = 60,
    times: npt.ArrayLike | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the NIS a degree of freedom of ranked sensors in windows of time, a strip each.

    Orange is more than the covariances say, purple less, grey without a reading; a frame is the
    stretch that speaks most against a sensor, dashed where that may be chance (p > 1 %).

    Parameters
    ----------
    found : Ranking
        Of `pgm.consistency.ranking`.
    windows : int
        The most windows, of equal length.
    times : array_like, optional
        (T+1,), of steps 0 to T, for the horizontal axis; the steps themselves without.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError
        If it is no ranking or an empty one, or an argument does not fit it.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> filtered = pgm.filter(walk, {z: [[1.0], [9.0], [1.0], [1.0]]})
    >>> ax = pgm.plot.ranking(pgm.consistency.ranking(filtered.innovations))
    """
    if not isinstance(found, Ranking) or not len(found):
        raise ModelError(
            "ranking draws what pgm.consistency.ranking returns, with a sensor or more, not "
            f"{found!r}"
        )
    if not is_whole(windows) or windows < 1:
        raise ModelError(f"windows is a whole number, 1 or more, not {windows!r}")
    last = max(int(row.steps[-1]) for row in found.rows)
    moments: Array = np.arange(last + 1.0)
    if times is not None:
        moments = np.asarray(times, dtype=float)
        if moments.ndim != 1 or len(moments) <= last:
            raise ModelError(
                f"times has shape {moments.shape}; one for each of the steps 0..{last} was due"
            )
    edges = np.linspace(moments[0], moments[last], min(windows, last + 1) + 1)
    ax = given_or_new(ax)
    values = np.stack([_windowed(row, moments, edges) for row in found.rows])
    norm = TwoSlopeNorm(0.0, -2.0, 3.0)
    places = np.arange(len(found) + 1) - 0.5
    mesh = ax.pcolormesh(edges, places, np.ma.masked_invalid(values), cmap=_SCALE, norm=norm)
    for place, row in enumerate(found.rows):
        left, right = moments[row.first], moments[row.last]
        spare = max(0.002 * (edges[-1] - edges[0]), 1e-12)
        ax.add_patch(
            matplotlib.patches.Rectangle(
                (left - spare, place - 0.42),
                right - left + 2.0 * spare,
                0.84,
                fill=False,
                edgecolor=INK,
                lw=1.0,
                ls="-" if row.probability <= 0.01 else ":",
            )
        )
    names = [
        f"{plain(row.name)}\n{number(float(row.average.value), 3)}"
        + ("" if row.average.inside else " !")
        for row in found.rows
    ]
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    name_time(ax, STEP if times is None else "time", "")
    name_axes(ax, "", "sensor: NIS a component (! outside its band)")
    bar = ax.figure.colorbar(mesh, ax=ax, label="NIS a component, in a window", extend="both")
    bar.ax.yaxis.set_major_locator(FixedLocator([float(np.log2(tick)) for tick in _TICKS]))
    bar.ax.yaxis.set_minor_locator(NullLocator())
    bar.ax.set_yticklabels([f"{tick:g}" for tick in _TICKS])
    return ax


def _windowed(row: Ranked, moments: Array, edges: Array) -> Array:
    """The binary logarithm of the NIS a degree of freedom in windows; NaN without readings."""
    window = np.searchsorted(edges, moments[row.steps], side="right") - 1
    window = np.minimum(window, len(edges) - 2)
    axes = tuple(range(row.nis.ndim - 1))
    squares, dof = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
    np.add.at(squares, window, np.nan_to_num(row.nis).sum(axis=axes))
    np.add.at(dof, window, row.dof.sum(axis=axes))
    ratio = np.divide(squares, dof, out=np.full(len(dof), np.nan), where=dof > 0)
    return np.asarray(np.log2(np.maximum(ratio, 1e-9)))
