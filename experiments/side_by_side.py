"""Diagrams beside each other, all with letters of one size."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

Drawing = Callable[..., Axes]

_TITLE, _GAP = 26.0, 24.0  # above a diagram and between two, in points


def side_by_side(drawings: Mapping[str, Drawing], columns: int, title: float = 11.0) -> Figure:
    """Draw diagrams in rows, each in an axes of the size that it takes in a figure of its own.

    Parameters
    ----------
    drawings : mapping of str to callable
        By title: draws on the axes `ax`, or in a new figure without.
    columns : int
        In a row.
    title : float
        The size of the titles, in points.
    """
    sizes = np.array([_size(draw) for draw in drawings.values()])
    rows = -(-len(sizes) // columns)
    padded = np.zeros((rows * columns, 2))
    padded[: len(sizes)] = sizes
    cells = padded.reshape(rows, columns, 2)
    widths = cells[..., 0].max(axis=0) + _GAP
    heights = cells[..., 1].max(axis=1) + _TITLE
    whole = np.array([widths.sum(), heights.sum()])
    figure = plt.figure(figsize=tuple(whole / 72.0))
    for k, (name, draw) in enumerate(drawings.items()):
        row, column = divmod(k, columns)
        top = whole[1] - heights[:row].sum() - _TITLE
        middle = widths[:column].sum() + 0.5 * widths[column]
        width, height = sizes[k]
        corner = np.array([middle - 0.5 * width, top - 0.5 * (heights[row] - _TITLE + height)])
        ax = figure.add_axes((*(corner / whole), *(sizes[k] / whole)))
        draw(ax=ax)
        figure.text(middle / whole[0], (top + 6.0) / whole[1], name, fontsize=title, ha="center")
    plt.close(figure)
    return figure


def _size(draw: Drawing) -> tuple[float, float]:
    """Width and height of a diagram that has a figure for itself, in points."""
    ax = draw()
    box, figure = ax.get_position(), plt.gcf()  # which it has made
    width, height = 72.0 * figure.get_size_inches()
    plt.close(figure)
    return box.width * width, box.height * height
