"""Networks of tables to the Bayesian interchange format, BIF, and its XML form, XMLBIF 0.3."""

import itertools
import json
import re
from collections.abc import Iterable, Iterator

from pgm.arguments import public
from pgm.cpds import TableCPD
from pgm.errors import ModelError
from pgm.io import sources
from pgm.io.networks.cursor import shown
from pgm.io.sources import Source
from pgm.networks import BayesianNetwork

# What every reader takes without quotes; a keyword is quoted besides.
PLAIN = re.compile(r"(?:[A-Za-z0-9_.<>=+%-]|/(?![/*]))+")
KEYWORDS = {
    "network",
    "variable",
    "probability",
    "type",
    "discrete",
    "property",
    "table",
    "default",
}
# Characters that XML 1.0 has no way to write.
IMPOSSIBLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
# Written as references: markup, what a parser would change, and all that an encoding may lack.
REFERRED = re.compile("[^\x20-\x7e]|[&<>]")


def tables(network: BayesianNetwork) -> list[TableCPD]:
    """The CPDs of a network of tables; refuses any other network, and variables at steps."""
    if not isinstance(network, BayesianNetwork):
        raise ModelError(f"what is written is a BayesianNetwork, not {type(network).__name__}")
    found = [cpd for cpd in network.cpds if isinstance(cpd, TableCPD)]
    if len(found) < len(network.cpds):
        odd = next(cpd for cpd in network.cpds if not isinstance(cpd, TableCPD))
        raise ModelError(f"{odd!r}: these files hold tables of discrete variables alone", cpd=odd)
    for cpd in found:
        if cpd.child.step is not None:
            raise ModelError(
                f"{cpd.child!r} is of a step, for which these files have no place; write a network "
                f"with a variable of another name, like '{cpd.child.name}_{cpd.child.step}'",
                variable=cpd.child,
                cpd=cpd,
            )
    return found


def _rows(cpd: TableCPD) -> Iterator[Iterable[str]]:
    """The numbers of each row of a table, the last parent's state moving fastest."""
    return (map(repr, row) for row in cpd.table.reshape(-1, cpd.child.size).tolist())


@public
def write_bif(network: BayesianNetwork, target: Source) -> None:
    r"""Write a network of tables as BIF, which `read_bif` reads back to the same network.

    Names that are no plain words are quoted, as in JSON; numbers have as many digits as their
    doubles need.

    Parameters
    ----------
    network : BayesianNetwork
        A static network of discrete variables.
    target : str, Path or open file
        A path, gzipped where it ends in ``.gz``, or a file opened for text or bytes (UTF-8).

    Raises
    ------
    FileError
        If the target is no path or file open for writing, or has an encoding without a name's
        letters.
    ModelError
        If the network is not of tables, or a variable is of a step.

    Examples
    --------
    >>> import io
    >>> from pgm.examples import coin
    >>> file = io.StringIO()
    >>> pgm.write_bif(coin, file)
    >>> print(file.getvalue())
    network unknown {
    }
    variable side {
      type discrete [ 2 ] { heads, tails };
    }
    probability ( side ) {
      table 0.25, 0.75;
    }
    <BLANKLINE>
    """
    sources.write(target, "".join(_bif(tables(network))))


def _bif(cpds: Iterable[TableCPD]) -> Iterator[str]:
    yield "network unknown {\n}\n"
    for cpd in cpds:
        states = _listed(cpd.child.states)
        yield f"variable {_named(cpd.child.name)} {{\n"
        yield f"  type discrete [ {cpd.child.size} ] {{ {states} }};\n}}\n"
    for cpd in cpds:
        given = _listed(v.name for v in cpd.given)
        yield f"probability ( {_named(cpd.child.name)}{' | ' if given else ''}{given} ) {{\n"
        quoted = [list(map(_named, v.states)) for v in cpd.given]
        for combination, row in zip(itertools.product(*quoted), _rows(cpd), strict=True):
            head = f"({', '.join(combination)})" if combination else "table"
            yield f"  {head} {', '.join(row)};\n"
        yield "}\n"


def _listed(names: Iterable[str]) -> str:
    return ", ".join(map(_named, names))


def _named(name: str) -> str:
    if PLAIN.fullmatch(name) and name not in KEYWORDS:
        return name
    # Escapes for what a text file may not keep: line ends, lone surrogates.
    return json.dumps(name, ensure_ascii=not name.isprintable())


@public
def write_xmlbif(network: BayesianNetwork, target: Source) -> None:
    """Write a network of tables as XMLBIF 0.3, which `read_xmlbif` reads back to the same network.

    Parameters
    ----------
    network : BayesianNetwork
        A static network of discrete variables.
    target : str, Path or open file
        A path, gzipped where it ends in ``.gz``, or a file opened for text or bytes.

    Raises
    ------
    FileError
        If the target is no path or file open for writing, or has an encoding without a name's
        letters.
    ModelError
        If the network is not of tables, a variable is of a step, or a name holds a control
        character, which XML cannot write.

    Examples
    --------
    >>> import tempfile
    >>> from pgm.examples import coin
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     pgm.write_xmlbif(coin, f"{folder}/coin.xml")
    ...     pgm.read_xmlbif(f"{folder}/coin.xml").variables
    (side,)
    """
    sources.write(target, "".join(_xmlbif(tables(network))))


def _xmlbif(cpds: Iterable[TableCPD]) -> Iterator[str]:
    yield '<?xml version="1.0"?>\n<BIF VERSION="0.3">\n<NETWORK>\n<NAME>unknown</NAME>\n'
    for cpd in cpds:
        yield f'<VARIABLE TYPE="nature">\n  {_element("NAME", cpd.child.name, cpd)}\n'
        yield from (f"  {_element('OUTCOME', state, cpd)}\n" for state in cpd.child.states)
        yield "</VARIABLE>\n"
    for cpd in cpds:
        yield f"<DEFINITION>\n  {_element('FOR', cpd.child.name, cpd)}\n"
        yield from (f"  {_element('GIVEN', parent.name, cpd)}\n" for parent in cpd.given)
        yield "  <TABLE>\n"
        yield from (f"    {' '.join(row)}\n" for row in _rows(cpd))
        yield "  </TABLE>\n</DEFINITION>\n"
    yield "</NETWORK>\n</BIF>\n"


def _element(tag: str, name: str, cpd: TableCPD) -> str:
    wrong = IMPOSSIBLE.search(name)
    if wrong:
        raise ModelError(
            f"{cpd!r}: XML cannot write the character {wrong[0]!r} of the name {shown(name)}; "
            "write BIF, or rename it",
            variable=cpd.child,
            cpd=cpd,
        )
    preserve = "" if name == name.strip() else ' xml:space="preserve"'
    text = REFERRED.sub(lambda found: f"&#{ord(found[0])};", name)
    return f"<{tag}{preserve}>{text}</{tag}>"
