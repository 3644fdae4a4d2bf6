"""Comparisons over time: of linearisers and schedules, and of sensors by their innovations."""

from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.ticker import FixedLocator, NullLocator

from pgm.arguments import public
from pgm.boundary import is_whole
from pgm.comparison import Comparison, Judgement, Row
from pgm.comparison.judgement import BAND
from pgm.consistency import Ranked, Ranking
from pgm.display import number
from pgm.errors import ModelError
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array
from pgm.plot.drawing.axes import (
    STEP,
    along,
    given_or_new,
    name_axes,
    name_time,
    plain,
    useful_legend,
)
from pgm.plot.drawing.colours import DASHES, INK, MUTED, OBSERVED, PALETTE
from pgm.variables import Variable

# Of linearisers, where the colours begin again; dashes are one a schedule.
_MARKS = (None, "o", "s", "^", "D", "v")
# The statistics that can be drawn, by name, with the label of the axis.
_STATISTICS = {"kl": "KL(oracle ‖ belief) [nats]", "nees": "NEES"}

_NEEDS = {"kl": "an oracle=", "nees": "a truth="}


@public
def comparison(
    found: Comparison,
    *,
    statistic: str = "kl",
    state: Variable | None = None,
    schedule: str | None = None,
    oracle: str | None = None,
    times: npt.ArrayLike | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw a comparison over time on a logarithmic axis: a colour a label, a style a schedule.

    A band about a KL is 1.96 of its Monte Carlo standard errors to either side, where the oracle is
    made of draws. The oracle's own KL, from the Gaussian of its moments, is grey; zeros, which have
    no logarithm, are left out. The legend names runs that failed, and by a "?" rows for which the
    oracle is too weak.

    Parameters
    ----------
    found : Comparison
        The result of `pgm.compare`.
    statistic : str
        ``"kl"``, from the oracle, or ``"nees"``, whose expected value is a line.
    state : Variable, optional
        The state that is drawn, if there are several.
    schedule : str, optional
        The name of the only one that is drawn; all without.
    oracle : str, optional
        The oracle whose KL is drawn, of several; the first without.
    times : array_like, optional
        (T+1,), for the horizontal axis; the steps themselves without.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.

    Raises
    ------
    ModelError
        If it is no comparison, has no such statistic, state, schedule or oracle, or no state is
        named of several.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> found = pgm.compare(walk, {z: [[2.0], [3.0]]}, oracle=pgm.Grid({"x": (-8.0, 12.0, 400)}))
    >>> ax = pgm.plot.comparison(found)
    """
    if not isinstance(found, Comparison):
        raise ModelError(f"comparison draws what pgm.compare returns, not a {type(found).__name__}")
    if statistic not in _STATISTICS:
        raise ModelError(f"statistic= is one of {list(_STATISTICS)}, not {statistic!r}")
    if oracle is not None and oracle not in found.oracles:
        raise ModelError(f"the comparison has no oracle {oracle!r}; it has {list(found.oracles)}")
    label = _STATISTICS[statistic]
    name = oracle or next(iter(found.oracles), "")
    rows = _chosen(found, state, schedule)
    if all(np.isnan(_values(row, statistic, name)).all() for row in rows):
        raise ModelError(
            f"no row has a {statistic}: give pgm.compare {_NEEDS[statistic]}, or see the rows' "
            "errors"
        )
    across, axis = along(np.arange(found.steps + 1), times)
    ax = given_or_new(ax)
    ax.set_yscale("log")
    linearisers, schedules = ([*dict.fromkeys(names)] for names in _names(rows))
    for row in rows:
        look: dict[str, Any] = {
            "color": PALETTE[linearisers.index(row.lineariser) % len(PALETTE)],
            "ls": DASHES[schedules.index(row.schedule) % len(DASHES)],
            "marker": _MARKS[linearisers.index(row.lineariser) // len(PALETTE) % len(_MARKS)],
            "markevery": 0.1,
            "markersize": 5.0,
        }
        text = ", ".join([row.lineariser, *([row.schedule] if len(schedules) > 1 else [])])
        judgement = row.by_oracle.get(name) if statistic == "kl" else None
        if judgement is not None:
            _band(ax, across, judgement, look["color"])
            text += " ?" if judgement.weak else ""
        values = _values(row, statistic, name)
        _draw(ax, across, values, f"{text} (failed)" if row.error else text, look)
    if statistic == "kl":
        kinds = {row.kind: row.schedule for row in rows}
        for row in found.oracle_rows:
            own = row.lineariser.removeprefix("oracle: ") == name
            values = _values(row, statistic, name)
            own &= row.kind in kinds and row.state == rows[0].state
            if own and np.nanmax(values, initial=0):
                style = DASHES[schedules.index(kinds[row.kind]) % len(DASHES)]
                text = f"{row.lineariser}, {row.kind},\nfrom its own Gaussian"
                _draw(ax, across, values, text, {"color": MUTED, "ls": style})
    else:
        ax.axhline(float(np.nanmax([r.nees_expected for r in rows])), color=INK, lw=0.8, zorder=1.5)
    name_time(ax, axis, label)
    useful_legend(ax)
    return ax


def _values(row: Row, statistic: str, oracle: str) -> Array:
    """A statistic of a row at each step, (T+1,); NaN where it has none."""
    if statistic == "nees":
        return row.nees_by_step
    found = row.by_oracle.get(oracle)
    return np.full(len(row.nees_by_step), np.nan) if found is None else found.kl_by_step


def _band(ax: Axes, across: npt.NDArray[Any], judgement: Judgement, colour: str) -> None:
    """Shade 1.96 standard errors about a KL; downwards no further than a tenth of it."""
    values, error = judgement.kl_by_step, BAND * judgement.error_by_step
    known = (values > 0.0) & (error > 0.0)
    if known.any():
        low = np.where(known, np.maximum(values - error, 0.1 * values), np.nan)
        high = np.where(known, values + error, np.nan)
        ax.fill_between(across, low, high, color=colour, alpha=0.18, lw=0.0, zorder=1.8)


def _draw(
    ax: Axes, across: npt.NDArray[Any], values: Array, label: str, look: dict[str, Any]
) -> None:
    marker = look.pop("marker", None) or ("." if len(across) == 1 else None)
    positive = np.where(values > 0.0, values, np.nan)
    ax.plot(across, positive, lw=1.4, marker=marker, zorder=2.2, label=plain(label), **look)


def _chosen(found: Comparison, state: Variable | None, schedule: str | None) -> list[Row]:
    if state is None and len(found.states) > 1:
        raise ModelError(f"the comparison is of {listed(found.states)}; name one, state=...")
    state = found.states[0] if state is None else state
    rows = [
        row
        for row in found.rows
        if row.state == state and (schedule is None or row.schedule == schedule)
    ]
    if not rows:
        known = [*dict.fromkeys(row.schedule for row in found.rows)]
        raise ModelError(
            f"the comparison has no rows of state={state!r}, schedule={schedule!r}; it has states "
            f"{listed(found.states)} and schedules {known}"
        )
    return rows


def _names(rows: list[Row]) -> tuple[list[str], list[str]]:
    return [row.lineariser for row in rows], [row.schedule for row in rows]


# White where the innovations are as large as their covariances say.
_SCALE = matplotlib.colormaps["PuOr_r"].with_extremes(bad=OBSERVED)
_TICKS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)


@public
def ranking(
    found: Ranking,
    *,
    windows: int = 60,
    times: npt.ArrayLike | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the NIS a degree of freedom of ranked sensors in windows of time, a strip each.

    Orange is more than the covariances say, purple less, grey without a reading; a frame is the
    stretch that speaks most against a sensor, dotted where that may be chance (p > 1 %).

    Parameters
    ----------
    found : Ranking
        The result of `pgm.consistency.ranking`.
    windows : int
        The most windows, of equal length.
    times : array_like, optional
        (T+1,), of steps 0 to T, for the horizontal axis; the steps themselves without.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.

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
