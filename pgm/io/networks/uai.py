"""Networks and evidence from the UAI format of inference competitions."""

from __future__ import annotations

import itertools
import math
import re
from array import array
from collections.abc import Mapping, Sequence
from typing import NoReturn

import numpy as np

from pgm.arguments import public
from pgm.errors import FileError
from pgm.factors import Table
from pgm.factors.axes import AXES
from pgm.io import sources
from pgm.io.networks.assembly import Assembly
from pgm.io.networks.cursor import ITEM, numbers, shown
from pgm.io.networks.formats import UAI, refuse_others
from pgm.io.networks.uai_writers import numbered
from pgm.io.sources import LIMIT, Content, Source, line_of
from pgm.kernels.arrays import Array
from pgm.networks import MarkovNetwork
from pgm.variables import Discrete

BAYES, MARKOV = "BAYES", "MARKOV"
# The variables of a table, by index, and where they stand in the file.
Scope = tuple[list[int], int]
# The largest count or index.
MOST = 2**31 - 1
COMMENT = re.compile("#[^\r\n]*+")
# Words that may stand for a number too small for float64: by an exponent, or by many zeros. Each
# run of digits is gone through once.
FAINT = re.compile(r"(?<![\d.])(?:[\d.]++[eE]-\d{3,}+|\d*+\.0{300,}+\d*+(?:[eE][-+]?\d++)?)")
SOME = re.compile("[1-9]")


@public
def read_uai(source: Source, *, normalise: bool = False, limit: int = LIMIT) -> MarkovNetwork:
    """The network of a UAI file: a `BayesianNetwork` of type BAYES, a `MarkovNetwork` of MARKOV.

    Such a file has no names: variables are called by their indices, ``"0"``, ``"1"``, ..., and so
    are their states. The states of a table's last variable move fastest; of type BAYES it is the
    child. A variable that no table of a Markov network has stands in a table of ones. Comments,
    from ``#`` to the end of a line, are skipped.

    Parameters
    ----------
    source, limit
        See `read_bif`.
    normalise : bool, optional
        See `read_bif`; of type BAYES alone.

    Returns
    -------
    BayesianNetwork or MarkovNetwork
        Its variables are `Discrete`; of type BAYES in the order of their indices as far as parents
        before children allow, and of type MARKOV as they come in the tables.

    Raises
    ------
    FileError, OSError
        See `read_bif`.

    Examples
    --------
    Two variables of two states, with the tables p(0) and p(1 | 0), and with one table of both:

    >>> import io
    >>> file = io.StringIO("BAYES 2  2 2  2  1 0  2 0 1  2 0.25 0.75  4 0.5 0.5 0.1 0.9")
    >>> network = pgm.read_uai(file)
    >>> network.cpds[1].table
    array([[0.5, 0.5],
           [0.1, 0.9]])
    >>> pgm.read_uai(io.StringIO("MARKOV 2  2 2  1  2 0 1  4  2 1 1 2"))
    MarkovNetwork(φ(0, 1))

    References
    ----------
    UAI 2008 Workshop, Evaluation of probabilistic inference systems: file format.
    """
    content = sources.read(source, limit)
    refuse_others(content, UAI)
    words = Words(content, heading=True)
    assembly = Assembly(words.fault, normalise=normalise, limit=limit)
    count = words.count("the number of variables")
    sizes = [words.count("a number of states") for _ in range(count)]
    if 0 in sizes:
        words.fail(f"the variable {sizes.index(0)} has no states", sizes.index(0) + 1)
    assembly.expect(count + sum(sizes), 0)
    functions = words.count("the number of tables")
    directed = words.kind == BAYES
    if directed and functions != len(sizes):
        words.fail(f"{functions} tables of {len(sizes)} variables; each has one", words.at - 1)
    scopes: list[Scope] = []
    for _ in range(functions):
        start = words.at
        scope = [words.count("an index") for _ in range(words.count("the number of variables"))]
        least = 1 if directed else 0
        if not least <= len(scope) <= AXES:
            words.fail(f"a table of {len(scope)} variables; it is of {least} to {AXES}", start)
        if max(scope, default=-1) >= len(sizes):
            words.fail(
                f"a table of the variable {max(scope)}, and variables count from 0 to "
                f"{len(sizes) - 1}",
                start,
            )
        scopes.append((scope, start))
    if directed:
        children = {scope[-1] for scope, _ in scopes}
        orphan = next((k for k in range(len(sizes)) if k not in children), None)
        if orphan is not None:
            words.fail(f"no table has the variable {orphan} as its child, the last one named", 0)
    tables = []
    for scope, _ in scopes:
        due = math.prod(sizes[k] for k in scope)
        found = words.count("the number of entries")
        if found != due:
            words.fail(
                f"{found} entries of the table over {scope} where {due} are due, one for each "
                "combination of states",
                words.at - 1,
            )
        tables.append((words.at, words.take(due)))
    words.finish()
    # Only now: the file holds as many numbers as its variables have states.
    for k, size in enumerate(sizes):
        assembly.declare(str(k), tuple(map(str, range(size))), k + 1)
    if not directed:
        return _undirected(words, [*assembly.variables.values()], scopes, tables)
    for (scope, start), (first, table) in zip(scopes, tables, strict=True):
        *given, child = map(str, scope)
        family = assembly.family(child, given, start)
        assembly.reserve(family)
        size = family.child.size
        places = range(first, words.at, size)
        assembly.table(family, table.reshape(-1, size), places.__getitem__)
    return assembly.network()


def _undirected(
    words: Words,
    variables: Sequence[Discrete],
    scopes: Sequence[Scope],
    tables: Sequence[tuple[int, Array]],
) -> MarkovNetwork:
    """The Markov network of a file's tables, each with the place of its first entry."""
    factors: list[Table] = []
    for (scope, start), (first, table) in zip(scopes, tables, strict=True):
        wrong = ~((table >= 0.0) & np.isfinite(table))
        if wrong.any():
            at = int(wrong.argmax())
            words.fail(f"{table[at]:.9g} is no entry of a factor; correct it", first + at)
        if len(set(scope)) < len(scope):
            words.fail(f"a table over {scope} has a variable twice; name each once", start)
        own = [variables[k] for k in scope]
        factors.append(Table(own, table.reshape([v.size for v in own])))
    held = {k for scope, _ in scopes for k in scope}
    factors += [Table.vacuous(v) for k, v in enumerate(variables) if k not in held]
    if not variables:
        raise words.fault("it declares no variable", None)
    return MarkovNetwork(factors)


@public
def read_uai_evidence(
    source: Source, network: MarkovNetwork, *, limit: int = LIMIT
) -> dict[Discrete, int]:
    """The evidence of a UAI file, for a network that `read_uai` read.

    Parameters
    ----------
    source : str, Path or open file
        Its numbers are how many variables are observed, then an index and a state of each; files
        of before 2010 say first that this is one sample.
    network : BayesianNetwork or MarkovNetwork
        Whose variables are told by their indices as in `write_uai`.
    limit : int, optional
        How many bytes the file may hold, once unpacked.

    Returns
    -------
    dict
        The index of the state of each variable that is observed.

    Raises
    ------
    FileError
        If the file is no such evidence; the message names the line, what was found, what to do.
    ModelError
        If the network is none of tables.

    Examples
    --------
    >>> import io
    >>> network = pgm.read_uai(io.StringIO("BAYES 1  2  1  1 0  2 0.25 0.75"))
    >>> pgm.read_uai_evidence(io.StringIO("1  0 1"), network)
    {0: 1}
    """
    variables = _by_index(network, "read_uai_evidence")
    content = sources.read(source, limit)
    refuse_others(content, "evidence")
    words = Words(content, heading=False)
    observed = words.count("the number of variables observed")
    # One sample that is announced leaves an odd count of numbers, where pairs leave an even one.
    if observed == 1 and words.left % 2:
        observed = words.count("the number of variables observed")
    if words.left != 2 * observed:
        words.fail(
            f"{words.left} numbers follow where {2 * observed} are due, an index and a state of "
            f"each of {observed} variables; one sample is read, not several",
            words.at - 1,
        )
    evidence: dict[Discrete, int] = {}
    for _ in range(observed):
        variable, state = words.variable(variables), words.count("a state")
        if state >= variable.size:
            words.fail(
                f"the variable {variable.name} has the states 0 to {variable.size - 1}, "
                f"not {state}",
                words.at - 1,
            )
        if evidence.setdefault(variable, state) != state:
            words.fail(
                f"the variable {variable.name} is observed in two states; keep one", words.at - 1
            )
    return evidence


@public
def read_uai_query(
    source: Source, network: MarkovNetwork, *, limit: int = LIMIT
) -> tuple[Discrete, ...]:
    """The variables that a marginal MAP asks for, for a network that `read_uai` read.

    Parameters
    ----------
    source : str, Path or open file
        Its numbers are how many variables are asked for, then the index of each.
    network : BayesianNetwork or MarkovNetwork
        Whose variables are told by their indices as in `write_uai`.
    limit : int, optional
        How many bytes the file may hold, once unpacked.

    Returns
    -------
    tuple of Discrete
        As `most_probable` takes them, ``variables=``.

    Raises
    ------
    FileError
        If the file is no such question; the message names the line, what was found, what to do.
    ModelError
        If the network is none of tables.

    Examples
    --------
    >>> import io
    >>> network = pgm.read_uai(io.StringIO("BAYES 1  2  1  1 0  2 0.25 0.75"))
    >>> pgm.read_uai_query(io.StringIO("1  0"), network)
    (0,)
    """
    variables = _by_index(network, "read_uai_query")
    content = sources.read(source, limit)
    refuse_others(content, "evidence")
    words = Words(content, heading=False)
    asked = words.count("the number of variables asked for")
    if words.left != asked:
        words.fail(
            f"{words.left} numbers follow where {asked} are due, the index of each variable",
            words.at - 1,
        )
    found = dict[Discrete, None]()
    for _ in range(asked):
        variable = words.variable(variables)
        if variable in found:
            words.fail(f"the variable {variable.name} is asked for twice; keep one", words.at - 1)
        found[variable] = None
    return tuple(found)


def _by_index(network: MarkovNetwork, where: str) -> dict[str, Discrete]:
    """The variables of a network by their indices in its files."""
    return {str(k): variable for k, variable in enumerate(numbered(network, where))}


class Words:
    """The numbers of a file, read one by one and counted from 0.

    `kind` is the word before them, in files that begin with one.
    """

    kind: str = ""

    def __init__(self, content: Content, *, heading: bool) -> None:
        # Blanks for comments, so that lines and places stay.
        self._text = COMMENT.sub(lambda found: " " * len(found[0]), content.text())
        self._origin = content.origin
        self._start = self._heading() if heading else 0
        self._values = array("d")
        self.at = 0
        end = numbers(self._text, self._start, self._values)
        if end < len(self._text):
            found = shown(self._text[end : end + 100].split()[0])
            raise self._error(f"{found} stands where a number is due; correct or remove it", end)
        for word in FAINT.finditer(self._text, self._start):
            mantissa = re.split("[eE]", word[0])[0]
            if float(word[0]) < np.finfo(np.float64).tiny and SOME.search(mantissa):
                raise self._error(
                    f"{shown(word[0])} is too small for a number with all digits of float64; "
                    "multiply its table by a constant, or write 0",
                    word.start(),
                )

    @property
    def left(self) -> int:
        """The number of numbers left."""
        return len(self._values) - self.at

    def count(self, what: str) -> int:
        """The next number, which must be whole and not negative."""
        if not self.left:
            self.fail(f"the file ends where {what} is due; is it whole?")
        found = self._values[self.at]
        if not 0 <= found <= MOST or found != int(found):
            self.fail(f"{found:.9g} stands where {what} is due", self.at)
        self.at += 1
        return int(found)

    def variable(self, variables: Mapping[str, Discrete]) -> Discrete:
        """The variable whose index is the next number, of those by their names."""
        name = str(self.count("an index"))
        if name not in variables:
            self.fail(f"the network has no variable {name}; is it that of read_uai?", self.at - 1)
        return variables[name]

    def take(self, count: int) -> Array:
        """The next numbers, of a table."""
        if self.left < count:
            self.fail(f"{self.left} numbers are left of {count} of a table; is the file whole?")
        self.at += count
        return np.array(self._values[self.at - count : self.at])

    def finish(self) -> None:
        """Refuse words after the end of the network."""
        if self.left:
            self.fail(f"{self.left} numbers follow the last table; remove them", self.at)

    def fail(self, message: str, at: int | None = None) -> NoReturn:
        """Raise the error of a place, or of the end."""
        raise self.fault(message, len(self._values) if at is None else at)

    def fault(self, message: str, at: int | None) -> FileError:
        """The error of a place."""
        if at is None:
            return self._origin.fault(message)
        words = ITEM.finditer(self._text, self._start)
        word = next(itertools.islice(words, at, None), None)
        return self._error(message, word.start() if word else len(self._text))

    def _error(self, message: str, at: int) -> FileError:
        return self._origin.fault(message, line_of(self._text, at))

    def _heading(self) -> int:
        word = ITEM.search(self._text)
        self.kind, at = (word[0], word.start()) if word else ("", len(self._text.rstrip()))
        if word is None or self.kind not in (BAYES, MARKOV):
            raise self._error(
                f"expected {BAYES} or {MARKOV} at the start, found {shown(self.kind)}", at
            )
        return word.end()
