"""Files of networks told by how they begin: for files that were given to another reader."""

from __future__ import annotations

import re
from dataclasses import dataclass

from pgm.io.sources import Content, line_of
from pgm.resources import FILES

BIF, XMLBIF, UAI = "BIF", "XMLBIF", "UAI"
# How much of a file is looked at, in characters or bytes.
HEAD = 4096


@dataclass(frozen=True, slots=True)
class Format:
    """A format by its beginning, behind white space and comments, and the way to read it."""

    name: str
    begins: re.Pattern[str]
    remedy: str


_PYAGRUM = f"pgm.from_pyagrum(pyagrum.loadBN({{!r}})), after pip install '{FILES}'"
_BY_PYAGRUM = f"it is not read here, and pyAgrum reads it: {_PYAGRUM}"
_BY_GENIE = (
    "neither pgm nor pyAgrum reads it; GeNIe opens it, and saves it as Hugin's .net, which pyAgrum "
    f"reads: {_PYAGRUM.format('network.net')}"
)
# SMILE's manual: the first parent is the most significant coordinate. pyAgrum 2.0 to 3.3 lets it
# move fastest, and so gives tables of several parents another meaning.
_XDSL = (
    "it is not read here, and pyAgrum 3.3 turns the order of several parents round; save it in "
    f"GeNIe as Hugin's .net, which pyAgrum reads: {_PYAGRUM.format('network.net')}"
)
# The type of a member of a class of O3PRM, before its name.
_MEMBER = r"(?!node|potential|function|utility|decision|discrete|continuous)\w+(?:\s*\([^()]*\))?"


def _format(name: str, begins: str, remedy: str) -> Format:
    return Format(name, re.compile(begins, re.IGNORECASE), remedy)


FORMATS = {
    BIF: _format("a BIF file", r"(?:network\b[^{]*|variable\s[^{]*)\{", "pgm.read_bif reads it"),
    XMLBIF: _format("an XMLBIF file", r"<BIF\b", "pgm.read_xmlbif reads it"),
    UAI: _format("a UAI file", r"(?:BAYES|MARKOV)\s", "pgm.read_uai reads it"),
    "XDSL": _format("a GeNIe file (XDSL)", r"<smile\b", _XDSL),
    "DSL": _format("a GeNIe file (DSL)", r"net\s+\w+\s*\{", _BY_PYAGRUM.format("network.dsl")),
    "O3PRM": _format(
        "a class of O3PRM",
        r"(?:package|import)\s+[\w.]+\s*;|(?:system|interface)\s+\w+[^{;]*\{"
        r"|type\s+\w+\s+(?:labels|extends|boolean|int|real)\b"
        r"|class\s+\w+\s+(?:extends|implements)\b"
        rf"|class\s+\w+\s*\{{\s*{_MEMBER}\s+\w+\s*(?:\{{|;|dependson\b)",
        _BY_PYAGRUM.format("network.o3prm"),
    ),
    "NET": _format(
        "a Hugin file (NET)",
        r"net\s*\{|class\s+\w+\s*\{|node\s+\w+\s*\{",
        _BY_PYAGRUM.format("network.net"),
    ),
    "DNE": _format("a Netica file (DNE)", r"bnet\s+\w+\s*\{", _BY_GENIE),
    "DSC": _format("a Microsoft belief network (DSC)", r"belief\s+network\b", _BY_GENIE),
    "XBN": _format("a Microsoft belief network (XBN)", r"<ANALYSISNOTEBOOK\b", _BY_GENIE),
    "ARFF": _format(
        "a table of records of Weka (ARFF), and no network",
        r"@relation\b",
        "scipy.io.arff.loadarff reads it, for pgm.records; Weka saves networks as XMLBIF, for "
        "pgm.read_xmlbif",
    ),
    "JGUM": _format(
        "a file of pyAgrum (JGUM)",
        r"\{\s*\"type\"\s*:\s*\"\w+\"\s*,\s*\"GumJsonVersion\"",
        _BY_PYAGRUM.format("network.jgum"),
    ),
    "JSON": _format(
        "JSON, which is not read here",
        r'\{\s*["}]|\[\s*["{\[\]\d-]',
        "write the network as BIF, XMLBIF or UAI where it was made; where a web site has answered "
        "in place of the file, fetch the raw file",
    ),
}
# White space, comments of all of these formats, and the head of an XML file; none is tried twice.
_BEFORE = re.compile(
    r"(?:\s++|//[^\r\n]*+|[%#][^\r\n]*+|/\*(?s:.*?)\*/|<\?(?s:.*?)\?>|<!--(?s:.*?)-->"
    r"|<!DOCTYPE[^\[>]*+(?:\[[^\]]*+\]\s*+)?>)*+"
)


def refuse_others(content: Content, own: str) -> None:
    """Refuse a file that begins as one of another format, and say which reader takes it."""
    data = content.data[:HEAD]
    text = data if isinstance(data, str) else data.decode("utf-8-sig", errors="replace")
    text = text.removeprefix("\ufeff")
    before = _BEFORE.match(text)
    start = before.end() if before else 0
    for key, each in FORMATS.items():
        if key != own and each.begins.match(text, start):
            raise content.origin.fault(f"it is {each.name}; {each.remedy}", line_of(text, start))
