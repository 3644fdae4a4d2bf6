"""The best entries of a table's columns."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

# The number that a cell begins with; a mean is compared without its error.
_NUMBER = re.compile(r"[-−+]?\d[\d,]*\.?\d*(e[-+]?\d+)?")


def best_cells(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    best: Mapping[str, float],
    within: Sequence[str] = (),
) -> list[tuple[int, int]]:
    """The best cells as pairs of row and column, equal ones all.

    Parameters
    ----------
    columns : sequence of str
    rows : sequence of sequences of str
        Cells that do not begin with a number are passed over.
    best : mapping of str to float
        By column the value that is best come near to; -inf for the lowest, inf for the highest.
    within : sequence of str
        Columns that divide the rows into groups; in the first column a blank cell belongs to the
        group above.

    Raises
    ------
    ValueError
        If there is no such column.

    Examples
    --------
    >>> rows = [("filter", "0.40", "3.4"), ("smoother", "0.25 ± 0.01", "2.9"), ("none", "–", "")]
    >>> best_cells(("belief", "RMSE", "NEES"), rows, {"RMSE": -math.inf, "NEES": 3.0})
    [(1, 1), (1, 2)]
    """
    if unknown := [name for name in (*best, *within) if name not in columns]:
        raise ValueError(f"the table has no column {unknown[0]!r}; it has {', '.join(columns)}")
    groups = _groups(columns, rows, within)
    found = []
    for name, aim in best.items():
        k = list(columns).index(name)
        for group in groups:
            values = {r: value for r in group if (value := _number(rows[r][k])) is not None}
            if len(set(values.values())) > 1:
                least = min(_far(value, aim) for value in values.values())
                found += [(r, k) for r, value in values.items() if _far(value, aim) == least]
    return sorted(found)


def _groups(
    columns: Sequence[str], rows: Sequence[Sequence[str]], within: Sequence[str]
) -> list[list[int]]:
    """Rows of equal cells in some columns."""
    groups: dict[tuple[str, ...], list[int]] = {}
    at = [list(columns).index(name) for name in within]
    above = ""
    for r, row in enumerate(rows):
        above = row[0] or above
        groups.setdefault(tuple(above if k == 0 else row[k] for k in at), []).append(r)
    return list(groups.values())


def _number(cell: str) -> float | None:
    found = _NUMBER.match(cell.strip())
    return float(found[0].replace("−", "-").replace(",", "")) if found else None


def _far(value: float, aim: float) -> float:
    if math.isinf(aim):
        return -value if aim > 0 else value
    return abs(value - aim)
