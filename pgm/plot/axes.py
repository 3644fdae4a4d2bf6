"""Axes of plots of numbers: made, named, and given a legend."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from pgm.errors import ModelError


def check_axes(ax: Any) -> Axes:
    """The axes; refuses what is none, like the array that ``plt.subplots(2)`` returns."""
    if not isinstance(ax, Axes):
        raise ModelError(f"ax must be one matplotlib Axes, not {type(ax).__name__}; pick one")
    return ax


def given_or_new(ax: Axes | None) -> Axes:
    """The axes given, or that of a new figure."""
    if ax is None:
        return plt.subplots(layout="constrained")[1]
    return check_axes(ax)


def plain(name: str) -> str:
    """A name as matplotlib shows it word for word: dollar signs begin no formula."""
    return name.replace("$", r"\$")


def name_axes(ax: Axes, x: str, y: str) -> None:
    """Label the axes that have no label yet, with names word for word."""
    if not ax.get_xlabel():
        ax.set_xlabel(plain(x))
    if not ax.get_ylabel():
        ax.set_ylabel(plain(y))


def equal_aspect(ax: Axes) -> None:
    """One unit as long in x as in y, whether limits are shared with other axes or not."""
    shared = all(
        len(group.get_siblings(ax)) > 1
        for group in (ax.get_shared_x_axes(), ax.get_shared_y_axes())
    )
    ax.set_aspect("equal", adjustable="box" if shared else "datalim")


def useful_legend(ax: Axes, *, above: bool = False) -> None:
    """A legend where there are two things or more to tell apart, inside or above the axes."""
    labels = ax.get_legend_handles_labels()[1]
    if len(set(labels)) < 2:
        return
    if above:
        ax.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=min(len(labels), 4),
            frameon=False,
            borderaxespad=0.1,
            fontsize="small",
        )
    else:
        # Saying "best" aloud keeps matplotlib from warning that the search is slow on long paths.
        ax.legend(loc="best", framealpha=0.9, fontsize="small")
