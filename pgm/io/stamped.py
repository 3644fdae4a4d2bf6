"""Stamped rows of a log, and the checks of the arrays that they are made of."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_mapping
from pgm.display import Shown, Summary, as_numbers, brief, count, table
from pgm.errors import EvidenceError
from pgm.evidence import Constant
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Variable

# Stamps less than this apart [s] are of one moment: decimals of a log and sums of time steps
# differ by rounding, which for seconds since 1970 is 0.2 µs.
SAME = 1e-6
YEAR = 31_556_952.0
# Seconds later than this, and whole numbers that are farther apart, are no seconds but of a finer
# unit: since 1970, milliseconds are 1e12, microseconds 1e15 and nanoseconds 1e18.
LATEST, WIDEST = 1e11, 1e5
EPOCH = 1e8
DAY = 86_400.0
UNITS = (("nanoseconds", 1e9), ("microseconds", 1e6), ("milliseconds", 1e3))
Scalar = TypeVar("Scalar", bound=np.generic)


@public
@dataclass(frozen=True, eq=False, repr=False)
class Stamped(Shown):
    """Rows of a log with their stamps; made by `stamped`.

    Attributes
    ----------
    stamps, values, given
        See `stamped`.

    Examples
    --------
    >>> pgm.stamped([0.1, 0.2], [5.1, 4.9])
    Stamped(2 rows, given [])
      stamp  value
        0.1    5.1
        0.2    4.9
    """

    stamps: Any
    values: Any
    given: Mapping[Variable, Any] = field(default_factory=dict)

    @property
    def _title(self) -> str:
        stamps = as_numbers(self.stamps)
        rows = brief(self.stamps) if stamps is None else count(stamps.size, "row")
        return f"Stamped({rows}, given [{listed(self.given)}])"

    def _summary(self) -> Summary:
        stamps = as_numbers(self.stamps)
        if stamps is None or stamps.ndim != 1:
            return Summary(self._title)
        columns = [("stamp", stamps), ("value", self.values)]
        columns += [(repr(variable), given) for variable, given in self.given.items()]
        return Summary(self._title, [table(columns, digits=15)])


@public
def stamped(
    stamps: npt.ArrayLike,
    values: npt.ArrayLike,
    given: Mapping[Variable, npt.ArrayLike | Constant] | None = None,
) -> Stamped:
    """Rows of a log with their stamps, for `timeline`.

    Parameters
    ----------
    stamps : array_like
        (n,), seconds, in any order; nanoseconds are refused, and so are dates.
    values : array_like
        (n, d), one row a stamp; (n,) where d = 1; or columns of a structured array or data frame
        called like the variable's components, such as ``log[["distance", "turn"]]``. NaN, or a
        masked value, is a component that a sensor has not taken.
    given : mapping of Variable to array_like, optional
        A sensor's observed parents, such as the landmark sighted: (n, d) each, (n,) where d = 1,
        or ``pgm.constant(value)`` where it is the same in all rows.

    Returns
    -------
    Stamped
        The rows as they were given; `timeline` checks them.

    Raises
    ------
    EvidenceError
        If `given` is no mapping.

    Examples
    --------
    >>> m = Variable("m", components=("east", "north"))
    >>> log = stamped([0.1, 0.2], [5.1, 4.9], {m: [[0.0, 5.0], [3.0, 4.0]]})
    """
    return Stamped(stamps, values, MappingProxyType(dict(as_mapping(given, "stamped: given"))))


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
    array = as_floats(value, what, EvidenceError, variable=variable).copy()
    if array.ndim != 1:
        raise EvidenceError(
            f"{what} have shape {array.shape}; a row of seconds, (n,), was due", variable=variable
        )
    _refuse_rows(what, np.flatnonzero(~np.isfinite(array)), "not a finite time", variable)
    _require_seconds(what, array, np.asarray(value).dtype.kind in "iu", variable)
    return array


def _require_seconds(what: str, stamps: Array, whole: bool, variable: Variable | None) -> None:
    """Refuse stamps of another unit, as far as numbers tell."""
    last = np.abs(stamps).max(initial=0.0)
    gap = float(np.median(np.abs(np.diff(stamps)))) if stamps.size > 1 else 0.0
    if last > LATEST:
        # Since 1970, unless rows would then be days apart: fine ones may count from 0.
        since = (u for u in UNITS if last >= u[1] * EPOCH and gap < u[1] * DAY)
        unit, share = next(since, UNITS[0])
        raise EvidenceError(
            f"{what} go to {last:.3g} s, {last / YEAR:.0f} years; they seem to be {unit}: divide "
            f"them by {share:.0e}",
            variable=variable,
        )
    if whole and gap >= WIDEST:
        raise EvidenceError(
            f"{what} are whole numbers {gap:.3g} apart (median), as nanoseconds are; seconds were "
            "due: divide them by 1e9; if they are seconds, say so by stamps.astype(float)",
            variable=variable,
        )


def as_table(
    what: str,
    value: Any,
    rows: int,
    columns: tuple[str, ...],
    variable: Variable,
    hint: str = "",
) -> Array:
    """A copy of values with one row for each stamp, (rows, columns)."""
    array = as_floats(
        value, what, EvidenceError, labels=columns, missing=True, variable=variable
    ).copy()
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


def _refuse_rows(what: str, rows: Integers, why: str, variable: Variable | None) -> None:
    if rows.size:
        raise EvidenceError(f"{what}, {rows_text(rows)}: {why}", variable=variable)
