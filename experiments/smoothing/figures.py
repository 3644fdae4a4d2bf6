"""The figures: one column a lineariser, one colour a kind of belief."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

import pgm
import pgm.plot
from experiments.smoothing.judging import PLANE, Beliefs
from models.networks import sighting

Array = npt.NDArray[np.floating]


def rmse(beliefs: dict[str, Beliefs], truth: Array, times: Array) -> Figure:
    """RMSE over time, of the position above and of the heading below."""
    figure, axes = _grid(2, beliefs, (12.0, 6.4))
    for column, kinds in zip(axes.T, beliefs.values(), strict=True):
        for ax, components in zip(column, (PLANE, ("heading",)), strict=True):
            for kind, belief in kinds.items():
                pgm.plot.rmse(belief, truth, components=components, times=times, label=kind, ax=ax)
    _name(axes, "time [s]", ("error in the plane [m]", "error of the heading [rad]"))
    return _closed(figure)


def nees(beliefs: dict[str, Beliefs], truth: Array, times: Array) -> Figure:
    """NEES over time."""
    figure, axes = _grid(1, beliefs, (12.0, 4.0))
    for ax, kinds in zip(axes[0], beliefs.values(), strict=True):
        for kind, belief in kinds.items():
            pgm.plot.nees(belief, truth, times=times, label=kind, ax=ax)
        ax.set_yscale("log")
        ax.yaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("{x:g}")
    _name(axes, "time [s]", ("NEES / degrees of freedom",))
    return _closed(figure)


def coverage(beliefs: dict[str, Beliefs], truth: Array) -> Figure:
    """Coverage of regions of every confidence."""
    figure, axes = _grid(1, beliefs, (12.0, 4.4))
    for ax, kinds in zip(axes[0], beliefs.values(), strict=True):
        for kind, belief in kinds.items():
            pgm.plot.coverage(belief, truth, label=kind, ax=ax)
    for ax in axes[0, 1:]:
        ax.get_legend().remove()
        ax.set_ylabel("")
    return _closed(figure)


def innovations(posteriors: dict[str, pgm.results.Posterior], times: Array) -> Figure:
    """NIS of the filter over time, and the whiteness of its innovations."""
    figure, axes = _grid(2, posteriors, (12.0, 6.4), sharex=False)
    for column, posterior in zip(axes.T, posteriors.values(), strict=True):
        found = posterior.innovations[sighting]
        lags = min(20, len(np.unique(found.step)) - 1)
        pgm.plot.nis(found, times=times, label="filter", ax=column[0])
        pgm.plot.whiteness(found, lags=lags, label="filter", ax=column[1])
        column[0].set_xlabel("time [s]")
    for ax in axes[:, 1:].flat:
        ax.set_ylabel("")
    for ax in axes[0]:
        ax.get_legend().remove()
    return _closed(figure)


def convergence(status: dict[str, pgm.results.Status], tolerance: float) -> Figure:
    """How the iterated smoother settled."""
    figure, axes = _grid(1, status, (12.0, 3.6))
    for ax, found in zip(axes[0], status.values(), strict=True):
        pgm.plot.convergence(found, tolerance=tolerance, ax=ax)
    _name(axes, "linearisation", ("largest move of a mean [σ]",))
    return _closed(figure)


def _grid(
    rows: int, columns: Iterable[str], size: tuple[float, float], *, sharex: bool = True
) -> tuple[Figure, Any]:
    names = list(columns)
    figure, axes = plt.subplots(
        rows,
        len(names),
        figsize=size,
        sharex=sharex,
        sharey="row",
        squeeze=False,
        gridspec_kw={"wspace": 0.05},
        layout="constrained",
    )
    for ax, name in zip(axes[0], names, strict=True):
        ax.set_title(name)
    return figure, axes


def _name(axes: Any, across: str, down: tuple[str, ...]) -> None:
    """Label the outer axes alone, and put one legend below them."""
    figure = axes[0, 0].figure
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4 if len(labels) <= 4 else 3)
    ax: Axes
    for (row, column), ax in np.ndenumerate(axes):
        ax.set_xlabel(across if row == len(axes) - 1 else "")
        ax.set_ylabel(down[row] if column == 0 else "")
        if legend := ax.get_legend():
            legend.remove()


def _closed(figure: Figure) -> Figure:
    plt.close(figure)
    return figure
