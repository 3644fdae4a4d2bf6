"""Evidence from a table of records: one column a variable, one record a run."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import count, repeat
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_tuple, is_number, masked_whole
from pgm.display import titled
from pgm.errors import EvidenceError
from pgm.factors.axes import MISSING, STRANGER
from pgm.factors.scope import Scope, as_scope, column_names, listed
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Discrete, Variable

# Up to so many states, NumPy compares texts with each of them sooner than Python looks them up.
FEW = 8


class HasVariables(Protocol):
    """A network, for instance."""

    @property
    def variables(self) -> Scope:
        """The variables of the records."""
        ...


@public
def records(
    table: Any,
    network: HasVariables | Iterable[Variable],
    columns: Iterable[str] | None = None,
) -> dict[Variable, Integers | Array]:
    """Make evidence of a table of records.

    Column c of the table is evidence of the variable that is written c, row k is run k:
    ``infer(graph, records(frame, network))``. Of a vector a column ``x.east`` is one component, as
    `Posterior.to_frame` writes it, and components without a column are not observed. The result is
    a mapping like any other, to which evidence may be added.

    Parameters
    ----------
    table : mapping, numpy structured array or pandas.DataFrame
        A mapping is of names to columns; all columns are equally long. Cells of a discrete
        variable are names of states, or whole numbers, their indices; the numbers may be floats,
        since a column with NaN is. Not observed in this record is None, NaN, pandas' NA, a masked
        cell, −1, or an empty text that is no state's name. Categorical columns are the quickest.
        Cells of a continuous variable are numbers, (records,) of a scalar, (records, d) of a
        vector; NaN, None or pandas' NA is a component not observed in this record.
    network : BayesianNetwork, MarkovNetwork or iterable of Variable
        Whose variables the columns are; a copy at a step is written like ``x[3]``.
    columns : iterable of str, optional
        Those that are read; all, if not given, each of which must be of a variable.

    Returns
    -------
    dict
        For each column's variable the indices of its states, (records,), with −1 for "not
        observed"; of a continuous one its values, (records, d).

    Raises
    ------
    EvidenceError
        If the table is none, has no records or columns of unequal length, a column is of no
        variable, a vector has a column and its components, too, or a cell is no state; naming the
        column and the record, counted from 0.
    ModelError
        If the variables are none.

    Examples
    --------
    >>> rain = Discrete("rain", states=("no", "yes"))
    >>> wet = Discrete("wet", states=("no", "yes"))
    >>> records({"wet": ["yes", None, "no"]}, (rain, wet))
    {wet: array([ 1, -1,  0])}
    """
    known = _by_name(network)
    found = columns_of(table, columns)
    parts = {} if found.keys() <= known.keys() else _components(known)
    strangers = [name for name in found if name not in known and name not in parts]
    if strangers:
        raise _unknown(strangers, known)
    evidence: dict[Variable, Integers | Array] = {}
    for name, column in found.items():
        if name in known:
            evidence[known[name]] = _values(known[name], column)
            continue
        variable, place = parts[name]
        if repr(variable) in found:
            raise EvidenceError(
                f"column {repr(variable)!r} has all components, and {name!r} one of them again; "
                "leave one of them out",
                variable=variable,
            )
        values = _numbers(variable, column, name, 1)
        rows = evidence.setdefault(variable, np.full((len(values), variable.dimension), np.nan))
        rows[:, place] = values[:, 0]
    return evidence


def _by_name(network: Any) -> dict[str, Variable]:
    variables = as_scope(
        getattr(network, "variables", network), "records: the network", ordered=False
    )
    return {repr(variable): variable for variable in variables}


def _components(known: Mapping[str, Variable]) -> dict[str, tuple[Variable, int]]:
    """By name of a column, ``x.east``, the vector that it is a component of, and which one."""
    return {
        name: (variable, place)
        for variable in known.values()
        if not isinstance(variable, Discrete) and variable.dimension > 1
        for place, name in enumerate(column_names(variable))
    }


def _unknown(strangers: list[Any], known: Mapping[str, Variable]) -> EvidenceError:
    if isinstance(strangers[0], Variable):
        return EvidenceError(
            f"column {strangers[0]!r} is a variable; the columns of records are called by names, "
            "and a mapping of variables is evidence as it is"
        )
    return EvidenceError(
        f"the columns ({listed(strangers)}) are of no variable of the network, which has "
        f"({listed(sorted(known))}); rename them, or give columns=, the names of those to read"
    )


def _values(variable: Variable, column: Column) -> Integers | Array:
    if isinstance(variable, Discrete):
        return as_states(variable, column)
    return _numbers(variable, column, repr(variable), variable.dimension)


def _numbers(variable: Variable, column: Column, name: str, size: int) -> Array:
    """The numbers of a column, (records, size), NaN where missing: a variable's, or a component's.

    `name` is that of the column, for errors.
    """
    cells = column.cells if column.categories is None else column.categories.astype(str)
    array = as_floats(
        cells,
        f"column {name}",
        EvidenceError,
        labels=variable.components if size > 1 else (),
        missing=True,
        variable=variable,
    )
    if array.ndim == 1 and size == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[1] != size:
        due = "a number for each record was due"
        if size > 1:
            due = (
                f"(records, {size}) was due, its components ({listed(variable.components)}): put "
                f"their columns together, {{{repr(variable)!r}: frame[[...]]}}, or give them apart,"
                f" as {column_names(variable)[0]!r}"
            )
        raise EvidenceError(f"column {name} has shape {array.shape}; {due}", variable=variable)
    bad = np.isinf(array).any(axis=1)
    if bad.any():
        raise EvidenceError(
            f"column {name} has infinity in record {int(bad.argmax())}; finite numbers were "
            "due, or NaN where nothing was observed",
            variable=variable,
        )
    return array


@dataclass(frozen=True, eq=False)
class Column:
    """The cells of a column.

    cells: (records, ...); of a categorical column the codes of the categories, −1 for none; a frame
        of columns with names as it is.
    categories: Of a categorical column.
    """

    name: str
    cells: Any
    categories: npt.NDArray[Any] | None = None


def columns_of(table: Any, wanted: Iterable[str] | None) -> dict[str, Column]:
    """A table's columns by name: the wanted ones, or all.

    A data frame is what has ``columns`` and can be asked for one by name: pandas need not be
    there.
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
            raise EvidenceError(f"column {name!r} is {titled(values)}, not a row of cells")
        cells = _array(list(values))
    array = np.asarray(cells)
    if array.ndim == 0:
        raise EvidenceError(f"column {name!r} is {titled(values)}, not a row of cells")
    if array.dtype == object and getattr(values, "dtype", array.dtype).kind in "iuf":
        array = values.to_numpy(dtype=float, na_value=np.nan)  # pandas' numbers with NA
    return Column(name, array)


def _array(cells: list[Any]) -> npt.NDArray[Any]:
    """A list's cells as an array; a cell among numbers that is not a number keeps its type."""
    if {str, bool, np.bool_, type(None)}.isdisjoint(map(type, cells)):
        with suppress(ValueError):  # rows of unequal length
            found = np.asarray(cells)
            if found.dtype.kind in "iufc" or found.ndim > 1:  # rows, in which may be None
                return found
    array = np.empty(len(cells), dtype=object)
    array[:] = cells
    return array


def as_states(variable: Discrete, column: Column) -> Integers:
    """The index of the state of each record, (records,); −1 where there is none."""
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
    """The index of each cell's state; `STRANGER` for a cell that names no state."""
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
        indices[others] = _whole(variable, _as_numbers([listing[k] for k in others]))
    return indices


def _as_numbers(cells: list[Any]) -> Array:
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
    if bad.any():
        first = int(bad.argmax())
        cell = column.cells[first]
        if column.categories is not None:
            cell = column.categories[cell]
        shown = cell.item() if isinstance(cell, np.generic) else cell
        hint = ""
        if not isinstance(shown, str) and str(shown) in variable.states:
            hint = "; states are texts, of which the column has some by column.astype(str)"
        raise EvidenceError(
            f"column {variable!r} has {shown!r} in record {first}, which is none of the states "
            f"({listed(variable.states)}), 0 to {variable.size - 1}, nor missing (None, NaN, −1 or "
            f"an empty text){hint}",
            variable=variable,
        )
