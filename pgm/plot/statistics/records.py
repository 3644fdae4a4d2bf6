"""The convergence of a schedule: the residual of each iteration."""

import math

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.ticker import MaxNLocator

from pgm.arguments import public
from pgm.errors import ModelError
from pgm.inference import Kind, Status
from pgm.kernels.arrays import Array
from pgm.plot.drawing.axes import band, given_or_new, name_axes, useful_legend
from pgm.plot.drawing.colours import INK, Look, look_of

# More runs than this are a band and a median.
_LINES = 8
# Where all residuals are zero, the axis is about this number.
_TINY = 1e-16


@public
def convergence(
    status: Status,
    *,
    tolerance: float | None = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the residual of each iteration on a logarithmic axis.

    Up to eight runs are a line each; more are their median within the band from the least to the
    greatest. A residual of zero, which has no logarithm, is a triangle at the bottom of the axis.
    A run's line ends where it has no residual (NaN) or an infinite one. Call it again with the
    same `ax` to compare schedules: each takes the next colour.

    Parameters
    ----------
    status : Status
        For instance ``posterior.status``.
    tolerance : float, optional
        That of the schedule, drawn as a dashed line.
    label, colour, ax
        See `trajectory`.

    Raises
    ------
    ModelError
        If `status` is none, or of beliefs that are not iterated, or the tolerance is negative.

    Examples
    --------
    >>> from pgm.examples import squares, z
    >>> smoothed = pgm.smooth(squares, {z: [[9.0]]}, iterations=10)
    >>> ax = pgm.plot.convergence(smoothed.status, tolerance=1e-6)
    """
    if not isinstance(status, Status):
        raise ModelError(
            f"convergence draws a Status, like posterior.status, not {type(status).__name__}"
        )
    if status._figures is not None:
        raise ModelError(f"{status!r} is of beliefs that are not iterated, and has no residuals")
    if tolerance is not None and not 0.0 <= tolerance < np.inf:
        raise ModelError(f"tolerance must be 0 or more, not {tolerance!r}")
    residuals = np.asarray(status.residuals, dtype=float)
    residuals = residuals.reshape(len(residuals), math.prod(residuals.shape[1:]))
    residuals = np.where(np.isfinite(residuals), residuals, np.nan)
    # The first linearisation of a tree has no residual.
    across = status.iterations - len(residuals) + 1 + np.arange(len(residuals))

    ax = given_or_new(ax)
    ax.set_yscale("log")
    look = look_of(ax, colour)
    label = "residual" if label is None else str(label)
    draw = _draw_band if residuals.shape[1] > _LINES else _draw_lines
    draw(ax, across, residuals, label, look)
    if tolerance:
        ax.axhline(
            tolerance, color=INK, lw=0.9, ls="--", zorder=1.5, label=f"tolerance {tolerance:g}"
        )
        if not np.any(residuals > 0.0):
            # Alone it spans no axis.
            about = np.array([[0.0, 0.1 * tolerance], [0.0, 10.0 * tolerance]])
            ax.update_datalim(about, updatex=False)
    _mark_zeros(ax, across, residuals, look.colour)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    name_axes(ax, "iteration", "residual")
    useful_legend(ax)
    if not ax.dataLim.minposy < np.inf:
        # The axis still follows what is drawn on it later.
        ax.set_ylim(_TINY, 1e4 * _TINY, auto=None)
    return ax


def _draw_lines(
    ax: Axes, across: npt.NDArray[np.int_], residuals: Array, label: str, look: Look
) -> None:
    count = residuals.shape[1]
    positive = np.where(residuals > 0.0, residuals, np.nan)
    for k in range(count):
        ax.plot(
            across,
            positive[:, k],
            color=to_rgba(look.colour, 1.0 if count == 1 else 0.7),
            ls=look.dash,
            lw=1.5 if count == 1 else 1.1,
            marker=".",
            markersize=4.0 if len(across) <= 60 else 0.0,
            zorder=2.2,
            label=label if k == 0 else None,
        )


def _draw_band(
    ax: Axes, across: npt.NDArray[np.int_], residuals: Array, label: str, look: Look
) -> None:
    """The band is of positive residuals; the median is of all, and ends where it is zero."""
    positive = np.where(residuals > 0.0, residuals, np.nan)
    least, most = (f.reduce(positive, axis=1) for f in (np.fmin, np.fmax))
    rows = (row[~np.isnan(row)] for row in residuals)
    middle = np.array([np.median(row) if row.size else np.nan for row in rows])
    middle = np.where(middle > 0.0, middle, np.nan)
    many = f"{label}, {residuals.shape[1]} runs"
    band(ax, across, least, most, look.colour, many, dash=look.dash, inside=0.18, outline=0.4)
    ax.plot(
        across,
        middle,
        color=look.colour,
        ls=look.dash,
        lw=1.6,
        zorder=2.2,
        label=f"{label}, median",
    )


def _mark_zeros(ax: Axes, across: npt.NDArray[np.int_], residuals: Array, tint: str) -> None:
    zeros = across[(residuals == 0.0).any(axis=1)]
    if zeros.size:
        ax.plot(
            zeros,
            np.full(zeros.shape, 0.02),
            "v",
            color=tint,
            markersize=5.0,
            transform=ax.get_xaxis_transform(),
            clip_on=False,
            zorder=2.4,
            label=None if any(one.get_label() == "zero" for one in ax.lines) else "zero",
        )
