"""Axes of plots of numbers: made and named."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from pgm.errors import ModelError

# The unit of all lengths, or of components by name.
Unit = str | Mapping[str, str] | None


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


def unit_of(component: str, unit: Unit, known: Collection[str], *, angle: bool) -> str:
    """The unit of one of the known components; empty where nothing is known of it."""
    others = "rad" if angle else ""
    if unit is None:
        return others
    if isinstance(unit, str):
        return others or unit
    if not isinstance(unit, Mapping):
        raise ModelError(
            f'unit= is a text, "m", or one for each component by name, {{"east": "m"}}; found '
            f"{unit!r}"
        )
    for name in unit:
        if name not in known:
            raise ModelError(f"unit= is given of {name!r}; the components are {[*known]}")
    return unit.get(component, others)


def with_unit(text: str, *units: str) -> str:
    """A text, and in brackets the unit, if it is the same of all."""
    return f"{text} [{units[0]}]" if units[0] and len(set(units)) == 1 else text


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
