"""A belief on a map: each cell the darker, the more probable it is."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import Normalize, to_rgba
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Rectangle
from matplotlib.textpath import text_to_path

from pgm.errors import ModelError
from pgm.factors import Table
from pgm.plot.axes import given_or_new, name_axes
from pgm.plot.beliefs.chances import as_index, as_places, chances, name_states
from pgm.plot.colours import CHANCE, MUTED, PALETTE, readable_on

# Numbers in more cells than this are too many to read, and lines between more hide the cells.
_WRITTEN = 30
_RULED = 600
# Of numbers, in points, where there is room, and in small cells; how much of a cell they fill.
_LETTERS, _SMALLEST, _FULL = 8.3, 5.5, 0.9


def belief_map(
    belief: Table,
    *,
    places: npt.ArrayLike | None = None,
    most: float | None = None,
    truth: str | int | tuple[str | int, str | int] | None = None,
    numbers: bool | None = None,
    outside: str = "none",
    ax: Axes | None = None,
) -> Axes:
    """Draw a belief over cells as a map, seen from above.

    Rows go down from the top. The drawn mesh is ``ax.collections[0]``, from which
    ``figure.colorbar`` makes a bar.

    Parameters
    ----------
    belief : Table
        At one step: over two variables, whose states are rows and columns, or over one, whose
        states are cells with `places`.
    places : array_like of int, optional
        (K, 2): row and column of each state. Places of no state are left empty.
    most : float, optional
        The probability of the darkest colour, for maps that are to be compared; without, that of
        the most probable cell.
    truth : str, int or pair of these, optional
        The cell that is right, by name or number, which is framed; a row and a column for two
        variables.
    numbers : bool, optional
        Whether probabilities are written in the cells; without, in up to 30 cells where they can
        be read.
    outside : str
        Colour of the map where there is no cell.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError
        If the belief is over other variables or several steps, or an argument does not fit it.
    NumericalError
        If the belief is all zero.

    Examples
    --------
    >>> place = pgm.Discrete("place", states=("hall", "room"))
    >>> ax = pgm.plot.belief_map(pgm.Table(place, [0.25, 0.75]), places=[[0, 0], [0, 1]])
    >>> [text.get_text() for text in ax.texts]
    ['0.25', '0.75']
    """
    found = chances(belief, (1, 2), 0, "one belief, at one step, over one or two variables")
    if (len(belief.scope) == 1) != (places is not None):
        raise ModelError(
            "places are the cells of a table over one variable, whose states have no rows and "
            "columns of their own; a table over two has"
        )
    at = as_places(places, found.size) if places is not None else _grid(found.shape)
    if most is None:
        most = float(found.max())
    elif not (np.isfinite(most) and most > 0.0):
        raise ModelError(f"most must be a probability above 0, not {most!r}")
    right = None if truth is None else at[_place(belief, truth)]

    ax = given_or_new(ax)
    ax.set_facecolor(outside)
    first, last = at.min(axis=0), at.max(axis=0)
    shape = last - first + 1
    mesh = np.full(shape, np.nan)
    mesh[tuple((at - first).T)] = found.ravel()
    # Lines around cells alone: where there is none, nothing is drawn.
    lines = np.where(np.isnan(mesh).reshape(-1, 1), to_rgba(MUTED, 0.0), to_rgba(MUTED))
    ruled: dict[str, Any] = {"edgecolors": lines, "linewidth": 0.4}
    rows, columns = (np.arange(f, e + 2) - 0.5 for f, e in zip(first, last, strict=True))
    norm = Normalize(0.0, most, clip=True)
    ax.pcolormesh(
        columns,
        rows,
        np.ma.masked_invalid(mesh),
        cmap=CHANCE,
        norm=norm,
        **(ruled if found.size <= _RULED else {"rasterized": True}),
    )
    texts = [f"{p:.3g}" if p >= 5e-4 else f"{p:.0g}" for p in found.ravel().tolist()]
    letters = _fitting(texts, ax, shape)
    if numbers if numbers is not None else found.size <= _WRITTEN and letters >= _SMALLEST:
        for (row, column), probability, text in zip(
            at.tolist(), found.ravel().tolist(), texts, strict=True
        ):
            ax.text(
                column,
                row,
                text,
                ha="center",
                va="center",
                fontsize=max(letters, _SMALLEST),
                color=readable_on(CHANCE(float(norm(probability)))),
            )
    if right is not None:
        row, column = right.tolist()
        # A frame inside the cell, since a mark in the middle would hide the number.
        frame = Rectangle(
            (column - 0.45, row - 0.45), 0.9, 0.9, fill=False, ec=PALETTE[1], lw=2.2, zorder=3.0
        )
        frame.set_label("truth")
        ax.add_patch(frame)
    ax.set_xlim(columns[0], columns[-1])
    ax.set_ylim(rows[-1], rows[0])
    ax.set_aspect("equal")
    if len(belief.scope) == 2:
        name_states(ax, ax.xaxis, belief.scope[1])
        name_states(ax, ax.yaxis, belief.scope[0])
        name_axes(ax, belief.scope[1].name, belief.scope[0].name)
    else:
        ax.set_xticks([])
        ax.set_yticks([])
    return ax


def _fitting(texts: Iterable[str], ax: Axes, shape: npt.NDArray[Any]) -> float:
    frame = ax.get_window_extent()
    cell = 72.0 / ax.figure.dpi * min(frame.width / shape[1], frame.height / shape[0])
    font = FontProperties(size=_LETTERS)
    widest = max(text_to_path.get_text_width_height_descent(one, font, False)[0] for one in texts)
    return float(min(_LETTERS, _LETTERS * _FULL * cell / widest))


def _grid(shape: tuple[int, ...]) -> npt.NDArray[np.int_]:
    return np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 2)


def _place(belief: Table, truth: str | int | tuple[str | int, str | int]) -> int:
    states = truth if isinstance(truth, tuple) else (truth,)
    if len(states) != len(belief.scope):
        raise ModelError(
            f"the truth {truth!r} has {len(states)} parts; one was due for each of "
            f"{list(belief.scope)}"
        )
    index = [as_index(v, state) for v, state in zip(belief.scope, states, strict=True)]
    return int(np.ravel_multi_index(index, tuple(v.size for v in belief.scope)))
