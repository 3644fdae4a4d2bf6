"""Networks from the Bayesian interchange format, BIF: its blocks, and the variables."""

from __future__ import annotations

from pgm.io.networks import sources
from pgm.io.networks.assembly import Assembly
from pgm.io.networks.bif_names import names_to, of_length
from pgm.io.networks.bif_tables import probability
from pgm.io.networks.cursor import END, Cursor, shown
from pgm.io.networks.sources import LIMIT, Source
from pgm.networks import BayesianNetwork


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

    References
    ----------
    Cozman, F. (1996), The interchange format for Bayesian networks, version 0.15.
    """
    content = sources.read(source, limit)
    cursor = Cursor(content.text(), content.origin)
    assembly = Assembly(cursor.fault, normalise=normalise, limit=limit)
    for start in _declarations(cursor, assembly):
        cursor.restart(start)
        probability(cursor, assembly)
    return assembly.network()


def _declarations(cursor: Cursor, assembly: Assembly) -> list[int]:
    """Declare all variables; where the probability blocks start."""
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
