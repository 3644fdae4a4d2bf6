"""Networks to the XML form of the interchange format, XMLBIF 0.3."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from pgm.cpds import TableCPD
from pgm.errors import ModelError
from pgm.io.networks import sources
from pgm.io.networks.cursor import shown
from pgm.io.networks.sources import Source
from pgm.io.networks.written import rows, tables
from pgm.networks import BayesianNetwork

# Characters that XML 1.0 has no way to write.
IMPOSSIBLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
# Written as references: markup, what a parser would change, and all that an encoding may lack.
REFERRED = re.compile("[^\x20-\x7e]|[&<>]")


def write_xmlbif(network: BayesianNetwork, target: Source) -> None:
    """Write a network of tables as XMLBIF 0.3, which `read_xmlbif` reads back to the same network.

    Parameters
    ----------
    network : BayesianNetwork
        Of discrete variables without steps.
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
    """
    sources.write(target, "".join(_lines(tables(network))))


def _lines(cpds: Iterable[TableCPD]) -> Iterator[str]:
    yield '<?xml version="1.0"?>\n<BIF VERSION="0.3">\n<NETWORK>\n<NAME>unknown</NAME>\n'
    for cpd in cpds:
        yield f'<VARIABLE TYPE="nature">\n  {_element("NAME", cpd.child.name, cpd)}\n'
        yield from (f"  {_element('OUTCOME', state, cpd)}\n" for state in cpd.child.states)
        yield "</VARIABLE>\n"
    for cpd in cpds:
        yield f"<DEFINITION>\n  {_element('FOR', cpd.child.name, cpd)}\n"
        yield from (f"  {_element('GIVEN', parent.name, cpd)}\n" for parent in cpd.given)
        yield "  <TABLE>\n"
        yield from (f"    {' '.join(map(repr, row))}\n" for row in rows(cpd))
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
