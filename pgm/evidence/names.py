"""The cells of a column as indices of a discrete variable's states."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from itertools import count, repeat
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import is_number
from pgm.errors import EvidenceError
from pgm.evidence.columns import Column
from pgm.factors.indices import MISSING, STRANGER
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Discrete

# Up to so many states, NumPy compares texts with each of them sooner than Python looks them up.
FEW = 8


def as_states(variable: Discrete, column: Column) -> Integers:
    """The index of the state of each record, (records,); −1 where there is none.

    Raises
    ------
    EvidenceError
        If a cell is no state, naming the record.
    """
    cells = column.cells
    if cells.ndim != 1:
        raise EvidenceError(
            f"column {variable!r} has shape {cells.shape}; a state for each record was due",
            variable=variable,
        )
    if column.categories is None:
        indices = _indices(variable, cells)
    else:
        # The last place, which code −1 finds, is that of no category.
        meaning = np.append(_indices(variable, column.categories), MISSING)
        indices = meaning[cells]
    _refuse(variable, column, indices == STRANGER)
    return indices


def _indices(variable: Discrete, cells: npt.NDArray[Any]) -> Integers:
    """The index of each cell's state; `STRANGER` of what is none."""
    indices: Integers
    kind = cells.dtype.kind
    if kind in "iuf":
        return _whole(variable, cells)
    if kind not in "UTO":
        return np.full(cells.shape, STRANGER, dtype=np.intp)
    if kind == "U" and variable.size <= FEW:
        indices = np.full(cells.shape, STRANGER, dtype=np.intp)
        for state, index in [("", MISSING), *zip(variable.states, count(), strict=False)]:
            indices[cells == state] = index
        return indices
    # pandas has one NaN for all that is missing, so that it is found like any key.
    place: dict[Any, int] = {None: MISSING, np.nan: MISSING, "": MISSING}
    place |= {state: index for index, state in enumerate(variable.states)}
    listing = cells.tolist()
    try:
        found = map(place.get, listing, repeat(STRANGER))
        indices = np.fromiter(found, dtype=np.intp, count=len(listing))
    except (TypeError, ValueError):  # a list, for instance, is no key
        known = (place[c] if isinstance(c, str) and c in place else STRANGER for c in listing)
        indices = np.fromiter(known, dtype=np.intp, count=len(listing))
    # Texts are done. Among the rest may be numbers, and what stands for a missing one.
    others = [k for k in np.flatnonzero(indices == STRANGER) if not isinstance(listing[k], str)]
    if others:
        indices[others] = _whole(variable, _numbers([listing[k] for k in others]))
    return indices


def _numbers(cells: list[Any]) -> Array:
    if {int, float}.issuperset(map(type, cells)):
        with suppress(OverflowError):
            return np.array(cells, dtype=float)
    return np.array(list(map(_number, cells)))


def _number(cell: Any) -> float:
    """A cell as a number: NaN where one is missing, a half where it is none, or no index."""
    if cell is None or type(cell).__name__ in ("NAType", "NaTType"):
        return math.nan
    return float(cell) if is_number(cell) else 0.5


def _whole(variable: Discrete, cells: npt.NDArray[Any]) -> Integers:
    """Whole numbers as indices; they may be floats, among which NaN is a missing one."""
    missing = np.isnan(cells) | (cells == MISSING)
    fits = (cells >= 0) & (cells < variable.size) & (cells == np.trunc(cells))
    if not missing.all():
        _require_plain(variable)
    indices = np.full(cells.shape, STRANGER, dtype=np.intp)
    indices[missing] = MISSING
    indices[fits] = cells[fits]
    return indices


def _require_plain(variable: Discrete) -> None:
    """Refuse numbers for a variable whose states are called by other numbers."""
    for index, state in enumerate(variable.states):
        if re.fullmatch(r"[+-]?\d+(\.0*)?", state) and float(state) != index:
            raise EvidenceError(
                f"column {variable!r} holds numbers, which are indices of states, 0 to "
                f"{variable.size - 1}; but the states' names are other numbers "
                f"({listed(variable.states)}). Give the names as texts, column.astype(str), or "
                "those of the indices, numpy.array(variable.states)[column]",
                variable=variable,
            )


def _refuse(variable: Discrete, column: Column, bad: Mask) -> None:
    """Raise if any record is bad, naming the first."""
    if bad.any():
        first = int(bad.argmax())
        cell = column.cells[first]
        if column.categories is not None:
            cell = column.categories[cell]
        shown = cell.item() if isinstance(cell, np.generic) else cell
        raise EvidenceError(
            f"column {variable!r} has {shown!r} in record {first}, which is none of the states "
            f"({listed(variable.states)}), 0 to {variable.size - 1}, nor missing (None, NaN, −1 or "
            "an empty text)",
            variable=variable,
        )
