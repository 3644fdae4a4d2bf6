"""Networks from the Bayesian interchange format, BIF."""

from __future__ import annotations

from array import array
from collections.abc import Container
from dataclasses import dataclass, field

import numpy as np

from pgm.arguments import public
from pgm.io import sources
from pgm.io.networks.assembly import Assembly, Family
from pgm.io.networks.cursor import END, MARK, Cursor, shown
from pgm.io.networks.formats import BIF, refuse_others
from pgm.io.sources import LIMIT, Source
from pgm.kernels.arrays import Array
from pgm.networks import BayesianNetwork

# The same list divided by commas and by white space: "very high, low" is two names or three.
Names = tuple[list[str], list[str]]


@public
def read_bif(source: Source, *, normalise: bool = False, limit: int = LIMIT) -> BayesianNetwork:
    r"""The network of a BIF file.

    Names are words, or quoted: then as in JSON, with ``\"`` for a quote and ``\\`` for a
    backslash. Words that no comma divides are one name where that fits the declarations. Comments
    (``//``, ``/* */``) and properties are skipped. The entries of a ``table`` are in the order of
    the format, the child's state moving slowest; a ``default`` is for the rows that are not given.

    Parameters
    ----------
    source : str, Path or open file
        A path, or a file opened as text or as bytes (then of UTF-8); gzipped or not.
    normalise : bool, optional
        Whether columns that do not quite sum to one are divided by their sums. Without it, what
        a `TableCPD` takes is taken as it is: a sum may be off by 5e-7 for each state. Sums that
        rounding to two decimals does not explain are refused in any case.
    limit : int, optional
        How many bytes the file may hold, once unpacked; its tables may have an entry for each 4
        of them, and its variables and states, which take more room than their names, be one for
        each 128.

    Returns
    -------
    BayesianNetwork
        Its variables are `Discrete`, and in the order of their declarations as far as parents
        before children allow.

    Raises
    ------
    FileError
        If the file is no network; the message names the line, what was found, what to do.
    OSError
        If the file cannot be opened.

    Examples
    --------
    >>> import io
    >>> file = io.StringIO(
    ...     "variable side { type discrete [2] { heads, tails }; }"
    ...     "probability (side) { table 0.25, 0.75; }"
    ... )
    >>> network = pgm.read_bif(file)
    >>> network.variables[0].states, network.cpds[0].table
    (('heads', 'tails'), array([0.25, 0.75]))

    References
    ----------
    Cozman, F. (1996), The interchange format for Bayesian networks, version 0.15.
    """
    content = sources.read(source, limit)
    refuse_others(content, BIF)
    cursor = Cursor(content.text(), content.origin)
    assembly = Assembly(cursor.fault, normalise=normalise, limit=limit)
    for start in _declarations(cursor, assembly):
        cursor.restart(start)
        probability(cursor, assembly)
    return assembly.network()


def _declarations(cursor: Cursor, assembly: Assembly) -> list[int]:
    probabilities: list[int] = []
    networks = 0
    while cursor.step() or cursor.kind is not END:
        match cursor.keyword():
            case "probability":
                probabilities.append(cursor.start)
                cursor.skip_block()
            case "variable":
                _variable(cursor, assembly)
            case "network" if not networks:
                networks = 1
                _network(cursor)
            case "network":
                cursor.fail("a second network starts; put it into a file of its own")
            case _:
                cursor.fail(
                    f"expected network, variable or probability, found {cursor.found()}; notes "
                    "go into comments, // or /* */"
                )
    return probabilities


def _network(cursor: Cursor) -> None:
    names_to(cursor, "{", "after the network's name")
    cursor.step()
    while cursor.keyword() == "property":
        cursor.skip_property()
        cursor.step()
    cursor.must_be("}", "at the end of the network block, or a property")


def _variable(cursor: Cursor, assembly: Assembly) -> None:
    at = cursor.start
    names, _ = names_to(cursor, "{", "after the variable's name")
    if len(names) != 1:
        cursor.fail(f"a variable has one name, not {len(names)}; quote a name that holds commas")
    states: list[str] | None = None
    while True:
        cursor.step()
        match cursor.keyword():
            case "type" if states is None:
                states = _states(cursor, names[0])
            case "property":
                cursor.skip_property()
            case _:
                break
    cursor.must_be("}", f"at the end of the variable {shown(names[0])}")
    if states is None:
        raise cursor.fault(f"the variable {shown(names[0])} has no type; add one", at)
    assembly.declare(names[0], states, at)


def _states(cursor: Cursor, name: str) -> list[str]:
    if cursor.step() != "discrete":
        cursor.fail(
            f"the variable {shown(name)} is of type {cursor.found()}; only discrete is read"
        )
    cursor.expect("[", "before the number of states")
    count = cursor.step()
    if not (count.isascii() and count.isdigit() and len(count) < 10):
        cursor.fail(f"expected the number of states of {shown(name)}, found {cursor.found()}")
    cursor.expect("]", "after the number of states")
    cursor.expect("{", "before the states")
    names, words = names_to(cursor, "}", "after the states")
    states = of_length(int(count), names, words)
    if states is None:
        cursor.fail(
            f"{int(count)} states of {shown(name)} are announced and {len(names)} named; correct "
            "one, and put commas between names"
        )
    cursor.expect(";", "after the states")
    return states


@dataclass(slots=True)
class Statements:
    """The statements of a block about its family's probabilities, as far as it has been read.

    places, starts: Where each row belongs in the table, and where it starts in the file.
    table, default: The numbers of such a statement, and where it starts.
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


def names_to(cursor: Cursor, close: str, what: str) -> Names:
    """Read names up to one of some marks, which is read too."""
    names: list[str] = []
    words: list[str] = []
    first = 0  # of the words since the last comma
    while True:
        text = cursor.step()
        if cursor.kind != MARK:
            if cursor.kind is END:
                cursor.fail(f"expected '{close[-1]}' {what}, found the end of the file")
            words.append(text)
            continue
        if len(words) > first:
            names.append(words[-1] if len(words) == first + 1 else " ".join(words[first:]))
            first = len(words)
        if text in close:
            return names, words
        if text != ",":
            cursor.fail(
                f"expected '{close[-1]}' {what}, found '{text}'; quote a name that holds it"
            )


def of_length(count: int, names: list[str], words: list[str]) -> list[str] | None:
    """Whichever division gives as many names as are due."""
    if len(names) == count:
        return names
    return words if len(words) == count else None


def declared(variables: Container[str], names: list[str], words: list[str]) -> list[str]:
    """Whichever division gives names of variables; that by commas, if neither does."""
    if all(name in variables for name in names) or any(name not in variables for name in words):
        return names
    return words
