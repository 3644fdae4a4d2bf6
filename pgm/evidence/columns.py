"""The columns of a table: of a mapping, a structured array or a data frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_tuple, masked_whole
from pgm.errors import EvidenceError
from pgm.factors.scope import listed


@dataclass(frozen=True, eq=False)
class Column:
    """The cells of a column.

    Attributes
    ----------
    name : str
    cells : ndarray
        (records, ...); of a categorical column the codes of the categories, −1 for none; a frame
        of columns with names as it is.
    categories : ndarray or None
        Of a categorical column.
    """

    name: str
    cells: Any
    categories: npt.NDArray[Any] | None = None


def columns_of(table: Any, wanted: Iterable[str] | None) -> dict[str, Column]:
    """The columns of a table by name; those that are wanted, or all.

    A data frame is what has ``columns`` and can be asked for one by name: pandas need not be
    there.

    Raises
    ------
    EvidenceError
        If it is no table, has no records or columns of unequal length, or lacks a column that is
        wanted, or any.
    """
    if isinstance(table, Mapping):
        names = list(table)
    elif isinstance(table, np.ndarray) and table.dtype.names:
        if table.ndim != 1:
            raise EvidenceError(f"records are a row of them, not an array of shape {table.shape}")
        names = list(table.dtype.names)
    elif hasattr(table, "columns") and hasattr(table, "__getitem__"):
        names = list(table.columns)
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise EvidenceError(f"two columns are called {twice!r}; leave one of them out")
    else:
        raise EvidenceError(
            "records are a mapping of names to columns, a structured array or a data frame, not "
            f"{type(table).__name__}"
        )
    if wanted is not None:
        if isinstance(wanted, str):
            raise EvidenceError(f"columns= takes several names, [{wanted!r}], not a text")
        asked = as_tuple(wanted)
        if asked is None:
            raise EvidenceError(f"columns= takes names, such as {names[:1]}, not {wanted!r}")
        missing = [name for name in asked if name not in names]
        if missing:
            raise EvidenceError(f"the table has no column {missing[0]!r}; it has ({listed(names)})")
        names = list(dict.fromkeys(asked))
    if not names:
        raise EvidenceError("the table has no columns: evidence of nothing is {}")
    found = {name: _column(name, table[name]) for name in names}
    lengths = {name: len(column.cells) for name, column in found.items()}
    short, long = (pick(lengths, key=lengths.__getitem__) for pick in (min, max))
    if lengths[short] < lengths[long]:
        raise EvidenceError(
            f"column {short!r} has {lengths[short]} records and column {long!r} {lengths[long]}; "
            "all columns of a table are equally long"
        )
    if not lengths[long]:
        raise EvidenceError("the table has no records: there is no run in it")
    return found


def _column(name: str, values: Any) -> Column:
    categorical = getattr(values, "cat", values)
    codes, categories = (getattr(categorical, a, None) for a in ("codes", "categories"))
    if codes is not None and categories is not None:
        return Column(name, np.asarray(codes), np.asarray(categories))
    values = masked_whole(values)
    if isinstance(values, np.ma.MaskedArray):
        masked = np.ma.getmaskarray(values)
        values = np.asarray(values).astype(object)
        values[masked] = None
    if hasattr(values, "columns") and hasattr(values, "__getitem__"):
        return Column(name, values)
    cells = values
    if not hasattr(values, "__array__"):
        if isinstance(values, str | bytes | set | frozenset) or not isinstance(values, Iterable):
            raise EvidenceError(f"column {name!r} is {values!r}, not a row of cells")
        cells = _array(list(values))
    array = np.asarray(cells)
    if array.ndim == 0:
        raise EvidenceError(f"column {name!r} is {values!r}, not a row of cells")
    if array.dtype == object and getattr(values, "dtype", array.dtype).kind in "iuf":
        array = values.to_numpy(dtype=float, na_value=np.nan)  # pandas' numbers with NA
    return Column(name, array)


def _array(cells: list[Any]) -> npt.NDArray[Any]:
    """A list's cells; what stands among numbers and is none stays what it is."""
    if {str, bool, np.bool_, type(None)}.isdisjoint(map(type, cells)):
        with suppress(ValueError):  # rows of unequal length
            found = np.asarray(cells)
            if found.dtype.kind in "iufc":
                return found
    array = np.empty(len(cells), dtype=object)
    array[:] = cells
    return array
