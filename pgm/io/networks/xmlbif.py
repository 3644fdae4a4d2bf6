"""Networks from the XML form of the interchange format, XMLBIF 0.3."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import Any
from xml.sax import SAXException, SAXParseException
from xml.sax.handler import ContentHandler

import numpy as np

from pgm.arguments import public
from pgm.errors import FileError
from pgm.io import sources
from pgm.io.networks.assembly import Assembly
from pgm.io.networks.cursor import numbers, shown
from pgm.io.networks.formats import XMLBIF, refuse_others
from pgm.io.sources import LIMIT, Content, Source
from pgm.networks import BayesianNetwork

# What may stand in what; a property holds anything, and is skipped.
INSIDE = {
    "": {"BIF"},
    "BIF": {"NETWORK"},
    "NETWORK": {"NAME", "VARIABLE", "DEFINITION"},
    "VARIABLE": {"NAME", "OUTCOME"},
    "DEFINITION": {"FOR", "GIVEN", "TABLE"},
}
# How deep a property may be nested.
DEEP = 64


@public
def read_xmlbif(source: Source, *, normalise: bool = False, limit: int = LIMIT) -> BayesianNetwork:
    """The network of an XMLBIF file, version 0.3.

    White space around names is dropped, unless their element says ``xml:space="preserve"``;
    properties are skipped. Files that define entities or refer to other files are refused.

    Parameters
    ----------
    source, normalise, limit
        See `read_bif`.

    Returns
    -------
    BayesianNetwork
        See `read_bif`.

    Raises
    ------
    FileError, OSError
        See `read_bif`.

    Examples
    --------
    >>> import io
    >>> from pgm.examples import coin
    >>> file = io.StringIO()
    >>> pgm.write_xmlbif(coin, file)
    >>> pgm.read_xmlbif(io.StringIO(file.getvalue())).cpds[0].table
    array([0.25, 0.75])

    References
    ----------
    Cozman, F. (1998), The interchange format for Bayesian networks, XMLBIF version 0.3.
    """
    content = sources.read(source, limit)
    refuse_others(content, XMLBIF)
    assembly = Assembly(content.origin.fault, normalise=normalise, limit=limit)
    for definition in _definitions(content, assembly):
        given = definition.given
        family = assembly.family(definition.child, given, definition.line)
        due = family.rows * family.child.size
        if len(definition.table) != due:
            raise content.origin.fault(
                f"{len(definition.table)} probabilities of {family!r} where {due} are due, "
                f"{family.child.size} for each of {family.rows} rows",
                definition.line,
            )
        assembly.reserve(family)
        rows = np.array(definition.table).reshape(-1, family.child.size)
        assembly.table(family, rows, lambda row, line=definition.line: line)  # type: ignore[misc]
    return assembly.network()


@dataclass(slots=True)
class Definition:
    """The element of a table, before all variables are known."""

    line: int
    child: str = ""
    given: list[str] = field(default_factory=list)
    table: array[float] = field(default_factory=lambda: array("d"))


def _definitions(content: Content, assembly: Assembly) -> list[Definition]:
    from defusedxml import sax  # type: ignore[import-untyped]
    from defusedxml.common import (  # type: ignore[import-untyped]
        EntitiesForbidden,
        ExternalReferenceForbidden,
    )

    parser = sax.make_parser()
    handler = Elements(parser, content, assembly)
    parser.setContentHandler(handler)
    try:
        # All at once: the parser would go back to the start of an open tag with every piece.
        parser.feed(content.data)
        parser.close()
    except FileError:
        raise
    except SAXParseException as error:
        raise content.origin.fault(
            f"it is no well-formed XML: {error.getMessage()}", error.getLineNumber()
        ) from None
    except EntitiesForbidden:
        raise handler.fault(
            "it defines entities, which are refused; write out what they stand for"
        ) from None
    except ExternalReferenceForbidden:
        raise handler.fault(
            "it refers to what is outside of the file, which is refused; remove the reference"
        ) from None
    except (SAXException, LookupError, ValueError) as error:
        raise handler.fault(f"it cannot be decoded: {error}; save it as UTF-8") from None
    return handler.definitions


class Elements(ContentHandler):
    """Takes elements as they come."""

    def __init__(self, parser: Any, content: Content, assembly: Assembly) -> None:
        self._parser, self._origin, self._assembly = parser, content.origin, assembly
        self.definitions: list[Definition] = []
        self._path = [""]
        self._skipped = 0  # how many elements deep in a property
        self._text: list[str] | None = None  # of a leaf
        self._preserve = False
        self._line = 0  # of the variable, definition or table
        self._name: str | None = None
        self._outcomes: list[str] = []
        self._definition = Definition(0)
        self._networks = 0

    def fault(self, message: str, line: int | None = None) -> FileError:
        """The error of a line, or of where the parser is."""
        return self._origin.fault(message, line or self._parser.getLineNumber())

    def startElement(self, tag: str, attributes: Any) -> None:
        """Open an element."""
        if self._skipped or tag == "PROPERTY":
            self._skipped += 1
            if self._skipped > DEEP:
                raise self.fault(
                    f"elements in a property are nested more than {DEEP} deep; remove them"
                )
            return
        allowed = INSIDE.get(self._path[-1], set())
        if tag not in allowed:
            where = f"in {self._path[-1]}" if self._path[-1] else "at the top"
            raise self.fault(
                f"the element {shown(tag)} stands {where}, where XMLBIF 0.3 has "
                f"{', '.join([*sorted(allowed), 'PROPERTY'])}; remove it, or correct the name"
            )
        self._path.append(tag)
        if tag == "NETWORK":
            self._networks += 1
            if self._networks > 1:
                raise self.fault("a second network starts; put it into a file of its own")
        elif tag == "VARIABLE":
            kind = attributes.get("TYPE", "nature")
            if kind != "nature":
                raise self.fault(f"a variable is of type {shown(kind)}; only nature is read")
            self._line, self._name, self._outcomes = self._parser.getLineNumber(), None, []
        elif tag == "DEFINITION":
            self._definition = Definition(self._parser.getLineNumber())
        elif tag not in INSIDE:
            self._text, self._preserve = [], attributes.get("xml:space") == "preserve"
            if tag == "TABLE":
                self._line = self._parser.getLineNumber()

    def characters(self, content: str) -> None:
        """Take some of the text of an element."""
        if self._skipped:
            return
        if self._text is not None:
            self._text.append(content)
        elif content.strip():
            raise self.fault(f"the text {shown(content)} stands between elements; remove it")

    def endElement(self, tag: str) -> None:
        """Close an element."""
        if self._skipped:
            self._skipped -= 1
            return
        self._path.pop()
        if self._text is not None:
            text, self._text = "".join(self._text), None
            self._leaf(tag, text if self._preserve else text.strip())
        elif tag == "VARIABLE":
            if self._name is None:
                raise self.fault("a variable has no NAME; add it", self._line)
            self._assembly.declare(self._name, self._outcomes, self._line)
        elif tag == "DEFINITION":
            if not self._definition.child or not self._definition.table:
                raise self.fault(
                    "a definition needs FOR, a variable, and TABLE, its numbers",
                    self._definition.line,
                )
            self.definitions.append(self._definition)

    def _leaf(self, tag: str, text: str) -> None:
        definition = self._definition
        if tag == "NAME" and self._path[-1] == "VARIABLE":
            if self._name is not None:
                raise self.fault("a variable has two names; keep one")
            self._name = text
        elif tag == "OUTCOME":
            self._outcomes.append(text)
        elif tag == "FOR":
            if definition.child:
                raise self.fault(
                    "a definition is for one variable, and this is the second; remove it"
                )
            definition.child = text
        elif tag == "GIVEN":
            definition.given.append(text)
        elif tag == "TABLE":
            if definition.table:
                raise self.fault("a definition has one table, and this is the second; remove it")
            end = numbers(text, 0, definition.table)
            if end < len(text):
                raise self.fault(
                    f"{shown(text[end:].split()[0])} stands where a number is due",
                    self._line + text.count("\n", 0, end),
                )
