"""Matrices with the names of their rows and columns, cut where they are large."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy.typing as npt

from pgm.display.numbers import column, number
from pgm.display.places import few
from pgm.display.summary import LEFT_OUT, Listing

# The most rows and columns of which all are shown.
ROWS, COLUMNS = 8, 7


def named_matrix(
    rows: Sequence[str],
    columns: Sequence[str],
    values: npt.NDArray[Any],
    symbol: str,
    before: Sequence[tuple[str, npt.NDArray[Any]]] = (),
) -> Listing:
    """A matrix with the names of its rows and columns.

    Parameters
    ----------
    rows, columns : sequence of str
    values : ndarray
        (rows, columns).
    symbol : str
        The matrix's own, at the head of its first column.
    before : sequence of (str, ndarray)
        Columns of numbers beside it, with their symbols.
    """
    shown = few(len(rows), ROWS)
    kept = [k for k in shown if k is not None]
    heads, cells = [""], [[rows[k] for k in kept]]
    for name, vector in before:
        heads.append(name)
        cells.append([number(value) for value in vector[kept]])
    for k, name in enumerate(columns[:COLUMNS]):
        heads.append(name if k else f"{symbol}: {name}")
        cells.append(column(values[kept, k]))
    if len(columns) > COLUMNS:
        heads.append(LEFT_OUT)
        cells.append([LEFT_OUT] * len(kept))
    found = dict(zip(kept, zip(*cells, strict=True), strict=True))
    return Listing(heads, [None if k is None else found[k] for k in shown])
