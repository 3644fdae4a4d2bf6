"""Stamped rows of a log, and the checks of the arrays that they are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from numpy.lib.recfunctions import structured_to_unstructured

from pgm.errors import EvidenceError
from pgm.evidence import Constant
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Variable

# Stamps less than this apart [s] are of one moment: decimals of a log and sums of time steps
# differ by rounding, which for seconds since 1970 is 0.2 µs.
SAME = 1e-6
Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True, eq=False)
class Stamped:
    """Rows of a log with their stamps; made by `stamped`."""

    stamps: Any
    values: Any
    given: Mapping[Variable, Any] = field(default_factory=dict)


def stamped(
    stamps: npt.ArrayLike,
    values: npt.ArrayLike,
    given: Mapping[Variable, npt.ArrayLike | Constant] | None = None,
) -> Stamped:
    """Rows of a log with their stamps, for `timeline`.

    Parameters
    ----------
    stamps : array_like
        (n,), seconds, in any order.
    values : array_like
        (n, d), one row a stamp; (n,) where d = 1; or columns of a structured array or table, in
        order, such as ``log[["distance", "turn"]]``. NaN is a component that a
        sensor has not taken.
    given : mapping of Variable to array_like, optional
        A sensor's observed parents, such as the landmark sighted: (n, d) each, (n,) where d = 1,
        or ``pgm.constant(value)`` where it is the same in all rows.

    Examples
    --------
    >>> m = Variable("m", components=("east", "north"))
    >>> log = stamped([0.1, 0.2], [5.1, 4.9], {m: [[0.0, 5.0], [3.0, 4.0]]})
    """
    return Stamped(stamps, values, MappingProxyType(dict(given or {})))


def sealed(array: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
    """The array, read-only."""
    array.flags.writeable = False
    return array


def nearest(times: Array, stamps: Array) -> Integers:
    """The step of the state nearest to each stamp; midway between two, the earlier."""
    return np.searchsorted(times[:-1] + 0.5 * np.diff(times), stamps)


def require_stamped(variable: Variable, value: Any) -> Stamped:
    """Refuse rows without stamps."""
    if not isinstance(value, Stamped):
        raise EvidenceError(
            f"{variable!r}: rows of a log are given as pgm.stamped(stamps, values), not as "
            f"{type(value).__name__}",
            variable=variable,
        )
    return value


def as_stamps(what: str, value: Any, variable: Variable | None = None) -> Array:
    """A copy of stamps, (n,), finite."""
    kind = np.asarray(value).dtype
    if kind.kind in "mM":
        raise EvidenceError(
            f"{what} are dates ({kind}); seconds were due: "
            "(dates - dates[0]) / np.timedelta64(1, 's')",
            variable=variable,
        )
    array = _as_numbers(what, value, variable)
    if array.ndim != 1:
        raise EvidenceError(
            f"{what} have shape {array.shape}; a row of seconds, (n,), was due", variable=variable
        )
    _refuse_rows(what, np.flatnonzero(~np.isfinite(array)), "not a finite time", variable)
    return array


def as_table(
    what: str,
    value: Any,
    rows: int,
    columns: tuple[str, ...],
    variable: Variable,
    hint: str = "",
) -> Array:
    """A copy of one row of values for each stamp, (rows, columns)."""
    array = _as_numbers(what, value, variable)
    if array.ndim == 1 and len(columns) == 1:
        array = array[:, None]
    if array.shape == (0,) and rows == 0:
        array = array.reshape(0, len(columns))
    if array.ndim != 2 or array.shape[1] != len(columns):
        raise EvidenceError(
            f"{what} have shape {array.shape}; ({rows}, {len(columns)}) was due, one row a stamp "
            f"and one column for each of {', '.join(columns) or 'no component'}{hint}",
            variable=variable,
        )
    if len(array) != rows:
        raise EvidenceError(
            f"{what} have {len(array)} rows with {rows} stamps; one row a stamp was due",
            variable=variable,
        )
    return array


def require_finite_rows(what: str, table: Array, variable: Variable, remedy: str) -> None:
    """Refuse rows with NaN or infinity."""
    rows = np.unique(np.nonzero(~np.isfinite(table))[0])
    _refuse_rows(what, rows, f"NaN or infinite; {remedy}", variable)


def rows_text(rows: Integers) -> str:
    """Rows by number, the first few of many."""
    listed = ", ".join(str(row) for row in rows[:5])
    return f"row{'s' if rows.size > 1 else ''} {listed}{', ...' if rows.size > 5 else ''}"


def clock(stamp: float) -> str:
    """A stamp in words, to the microsecond."""
    return f"{stamp:.6f}".rstrip("0").rstrip(".") + " s"


def _as_numbers(what: str, value: Any, variable: Variable | None) -> Array:
    try:
        if getattr(getattr(value, "dtype", None), "names", None):  # columns picked by name
            return np.array(structured_to_unstructured(value), dtype=float)
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise EvidenceError(
            f"{what} must be an array of numbers, not {type(value).__name__}", variable=variable
        ) from None


def _refuse_rows(what: str, rows: Integers, why: str, variable: Variable | None) -> None:
    if rows.size:
        raise EvidenceError(f"{what}, {rows_text(rows)}: {why}", variable=variable)
