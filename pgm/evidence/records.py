"""Evidence from a table of records: one column a variable, one record a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import numpy as np

from pgm.boundary import as_floats
from pgm.errors import EvidenceError
from pgm.evidence.columns import Column, columns_of
from pgm.evidence.names import as_states
from pgm.factors.scope import Scope, as_scope, listed
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Discrete, Variable


class HasVariables(Protocol):
    """A network, for instance."""

    @property
    def variables(self) -> Scope:
        """Its variables."""
        ...


def records(
    table: Any,
    network: HasVariables | Iterable[Variable],
    columns: Iterable[str] | None = None,
) -> dict[Variable, Integers | Array]:
    """Make evidence of a table of records.

    Column c of the table is evidence of the variable that is written c, row k is run k:
    ``infer(graph, records(frame, network))``. The result is a mapping like any other, to which
    evidence may be added.

    Parameters
    ----------
    table : mapping, numpy structured array or pandas.DataFrame
        A mapping is of names to columns; all columns are equally long. Cells of a discrete
        variable are names of states, or whole numbers, their indices; the numbers may be floats,
        since a column with NaN is. Not observed in this record is None, NaN, pandas' NA, a masked
        cell, −1, or an empty text that is no state's name. Categorical columns are the quickest.
        Cells of a continuous variable are numbers, (records,) of a scalar, (records, d) of a
        vector; NaN is a component not observed, of a variable on which no other depends.
    network : BayesianNetwork or iterable of Variable
        Whose variables the columns are; a copy at a step is written like ``x[3]``.
    columns : iterable of str, optional
        Those that are read; all, if not given, each of which must be of a variable.

    Returns
    -------
    dict
        Of each column's variable the indices of its states, (records,), with −1 for "not
        observed"; of a continuous one its values, (records, d).

    Raises
    ------
    EvidenceError
        If the table is none, has no records or columns of unequal length, a column is of no
        variable, or a cell is no state; naming the column and the record, counted from 0.
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
    strangers = [name for name in found if name not in known]
    if strangers:
        raise _unknown(strangers, known)
    return {known[name]: _values(known[name], column) for name, column in found.items()}


def _by_name(network: Any) -> dict[str, Variable]:
    """The variables as columns are named after them."""
    variables = as_scope(
        getattr(network, "variables", network), "records: the network", ordered=False
    )
    return {repr(variable): variable for variable in variables}


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
    return _numbers(variable, column)


def _numbers(variable: Variable, column: Column) -> Array:
    """The values of a continuous variable, (records, d)."""
    cells = column.cells if column.categories is None else column.categories.astype(str)
    array = as_floats(
        cells,
        f"column {variable!r}",
        EvidenceError,
        labels=variable.components,
        missing=True,
        variable=variable,
    )
    if array.ndim == 1 and variable.dimension == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[1] != variable.dimension:
        raise EvidenceError(
            f"column {variable!r} has shape {array.shape}; (records, {variable.dimension}) was "
            f"due, its components ({listed(variable.components)}): put their columns together, "
            f"{{{repr(variable)!r}: frame[[...]]}}",
            variable=variable,
        )
    bad = np.isinf(array).any(axis=1)
    if bad.any():
        raise EvidenceError(
            f"column {variable!r} has infinity in record {int(bad.argmax())}; finite numbers were "
            "due, or NaN where nothing was observed",
            variable=variable,
        )
    return array
