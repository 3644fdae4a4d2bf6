"""The probability blocks of BIF."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

import numpy as np

from pgm.io.networks.assembly import Assembly, Family
from pgm.io.networks.bif_names import declared, names_to, of_length
from pgm.io.networks.cursor import Cursor, shown
from pgm.kernels.arrays import Array


@dataclass(slots=True)
class Statements:
    """The statements of a block about its family's probabilities, as far as it has been read.

    Attributes
    ----------
    places, starts : array of int
        Where each row belongs in the table, and where it starts in the file.
    values : array of float
        The numbers of all rows.
    table, default : tuple, optional
        The numbers of such a statement, and where it starts.
    """

    family: Family
    places: array[int] = field(default_factory=lambda: array("q"))
    starts: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    table: tuple[Array, int] | None = None
    default: tuple[Array, int] | None = None


def probability(cursor: Cursor, assembly: Assembly) -> None:
    """Read a probability block, and give the assembly its table; all variables are declared."""
    family = _head(cursor, assembly)
    assembly.reserve(family)
    found = Statements(family)
    _read(cursor, found)
    if found.table is None:
        _by_rows(cursor, assembly, found)
        return
    table, at = found.table
    if found.places or found.default:
        raise cursor.fault(
            f"the probabilities of {family!r} are a table and rows besides; keep one", at
        )
    assembly.table(family, table.reshape(family.child.size, -1).T, lambda row: at)


def _read(cursor: Cursor, found: Statements) -> None:
    """Read the statements of a block."""
    family = found.family
    size = family.child.size
    index = [{state: k for k, state in enumerate(v.states)} for v in family.given]
    cursor.expect("{", "before the probabilities")
    while True:
        cursor.step()
        start = cursor.start
        if cursor.at_mark("("):
            found.places.append(_place(cursor, family, index))
            found.starts.append(start)
            cursor.numbers(found.values)
            _require(
                cursor, family, len(found.values) - size * (len(found.places) - 1), size, start
            )
            if len(found.places) > family.rows:
                _check(cursor, found)  # one must be given twice
            continue
        match cursor.keyword():
            case "table" if found.table is None:
                found.table = _numbers(cursor, family, size * family.rows), start
            case "default" if found.default is None:
                found.default = _numbers(cursor, family, size), start
            case "property":
                cursor.skip_property()
            case _:
                break
    cursor.must_be("}", f"at the end of the probabilities of {family!r}")


def _by_rows(cursor: Cursor, assembly: Assembly, found: Statements) -> None:
    """Give the assembly a table that is given row by row."""
    _check(cursor, found)
    family = found.family
    rows: Array = np.empty((family.rows, family.child.size))
    at = family.at
    if found.default:
        rows[:], at = found.default
    rows[np.array(found.places)] = np.array(found.values).reshape(-1, family.child.size)
    starts = zip(found.places, found.starts, strict=True)
    assembly.table(family, rows, lambda row: dict(starts).get(row, at))


def _numbers(cursor: Cursor, family: Family, due: int) -> Array:
    start = cursor.start
    found = array("d")
    cursor.numbers(found)
    _require(cursor, family, len(found), due, start)
    return np.array(found)


def _head(cursor: Cursor, assembly: Assembly) -> Family:
    at = cursor.start
    cursor.expect("(", "after probability")
    names = declared(assembly.variables, *names_to(cursor, "|)", "after the variables of a table"))
    if cursor.at_mark("|"):
        if len(names) != 1:
            cursor.fail(f"probabilities of {len(names)} variables; name one before the bar")
        names += declared(assembly.variables, *names_to(cursor, ")", "after the parents"))
    if not names:
        cursor.fail("probabilities of no variable; name it")
    return assembly.family(names[0], names[1:], at)


def _place(cursor: Cursor, family: Family, index: list[dict[str, int]]) -> int:
    """Where in the table a row belongs."""
    names, words = names_to(cursor, ")", "after the parents' states")
    states = of_length(len(index), names, words)
    if states is None:
        cursor.fail(f"a row of {family!r} names {len(names)} states of its {len(index)} parents")
    place = 0
    for parent, state, places in zip(family.given, states, index, strict=True):
        if state not in places:
            cursor.fail(
                f"the parent {shown(parent.name)} of {family!r} has no state {shown(state)}; "
                "correct the row"
            )
        place = place * len(places) + places[state]
    return place


def _check(cursor: Cursor, found: Statements) -> None:
    """Refuse rows that are given twice, or not at all."""
    family = found.family
    given = np.array(found.places)
    different, first = np.unique(given, return_index=True)
    if different.size < given.size:
        again = np.setdiff1d(np.arange(given.size), first)[0]
        raise cursor.fault(
            f"the row of {family!r}{family.row(int(given[again]))} is given twice; keep one",
            found.starts[again],
        )
    absent = family.rows - different.size
    if absent and not found.default:
        gap = np.flatnonzero(np.append(different, -1) != np.arange(different.size + 1))[0]
        raise cursor.fault(
            f"{absent} of the {family.rows} rows of {family!r} are missing, the first"
            f"{family.row(int(gap))}; add them, or a default",
            family.at,
        )


def _require(cursor: Cursor, family: Family, found: int, due: int, at: int) -> None:
    if found != due:
        raise cursor.fault(
            f"{found} probabilities of {family!r} where {due} are due, as it has "
            f"{family.child.size} states",
            at,
        )
