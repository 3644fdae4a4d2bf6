"""Any value in a few words of one line: arrays of a few numbers, or their shape."""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.display.numbers import DIGITS, column, number
from pgm.display.summary import LEFT_OUT, Listing, one_line, places

# Numbers that are listed, and those of a vector in one cell.
LISTED, VECTOR = 12, 4
_SHORT = reprlib.Repr()
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = _SHORT.maxset = 4
_SHORT.maxstring = _SHORT.maxother = 60


def brief(value: Any) -> str:
    """A value in a few words."""
    if isinstance(value, np.ndarray):
        if value.size <= LISTED and value.dtype.kind in "iufb":
            text = str(value.tolist())
            return f"array({text})" if value.ndim else text
        return f"array of shape {value.shape}"
    return one_line(_SHORT.repr(value))


def called(function: Any) -> str:
    """A function by its name, or another callable by its class."""
    return one_line(getattr(function, "__name__", type(function).__name__))


def vector(values: npt.NDArray[Any]) -> str:
    """The numbers of one value in one cell; states by their indices."""
    found = np.ravel(values)
    text = ", ".join(number(value) for value in found[:VECTOR])
    return text + f", {LEFT_OUT}" * (found.size > VECTOR)


def as_numbers(values: Any) -> npt.NDArray[Any] | None:
    """Values as an array of numbers, if they are such; None of others."""
    if isinstance(values, list | tuple | range):
        try:
            values = np.asarray(values)
        except (TypeError, ValueError, OverflowError):
            return None
    return values if isinstance(values, np.ndarray) and values.dtype.kind in "iuf" else None


def table(columns: Sequence[tuple[str, Any]], digits: int = DIGITS) -> Listing:
    """The first and last rows of columns of numbers, (n,) or (n, d) each, n as of the first.

    The first column has its own number of digits.
    """
    count = len(columns[0][1])
    shown = places((count,))
    rows = [place[0] for place in shown if place is not None]
    heads, cells = [], []
    for head, values in columns:
        array = as_numbers(values)
        if array is None or array.ndim not in (1, 2) or len(array) != count:
            heads.append(head)
            cells.append([brief(array if array is not None else values)] * len(rows))
            continue
        wide = array[:, None] if array.ndim == 1 else array
        for k in range(min(wide.shape[1], 2 * VECTOR)):
            heads.append(head if not k else "")
            cells.append(column(wide[rows, k], DIGITS if cells else digits))
    found = dict(zip(rows, zip(*cells, strict=True), strict=True))
    return Listing(heads, [None if at is None else found[at[0]] for at in shown], names=0)
