"""Networks to the Bayesian interchange format, BIF."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterable, Iterator

from pgm.cpds import TableCPD
from pgm.io.networks import sources
from pgm.io.networks.sources import Source
from pgm.io.networks.written import rows, tables
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


def write_bif(network: BayesianNetwork, target: Source) -> None:
    r"""Write a network of tables as BIF, which `read_bif` reads back to the same network.

    Names that are no plain words are quoted, as in JSON; numbers have as many digits as their
    doubles need.

    Parameters
    ----------
    network : BayesianNetwork
        Of discrete variables without steps.
    target : str, Path or open file
        A path, gzipped where it ends in ``.gz``, or a file opened for text or bytes (UTF-8).

    Raises
    ------
    FileError
        If the target is no path or file open for writing, or has an encoding without a name's
        letters.
    ModelError
        If the network is not of tables, or a variable is of a step.
    """
    sources.write(target, "".join(_lines(tables(network))))


def _lines(cpds: Iterable[TableCPD]) -> Iterator[str]:
    yield "network unknown {\n}\n"
    for cpd in cpds:
        states = _listed(cpd.child.states)
        yield f"variable {_named(cpd.child.name)} {{\n"
        yield f"  type discrete [ {cpd.child.size} ] {{ {states} }};\n}}\n"
    for cpd in cpds:
        given = _listed(v.name for v in cpd.given)
        yield f"probability ( {_named(cpd.child.name)}{' | ' if given else ''}{given} ) {{\n"
        quoted = [list(map(_named, v.states)) for v in cpd.given]
        for combination, row in zip(itertools.product(*quoted), rows(cpd), strict=True):
            head = f"({', '.join(combination)})" if combination else "table"
            yield f"  {head} {', '.join(map(repr, row))};\n"
        yield "}\n"


def _listed(names: Iterable[str]) -> str:
    return ", ".join(map(_named, names))


def _named(name: str) -> str:
    if PLAIN.fullmatch(name) and name not in KEYWORDS:
        return name
    # Escapes for what a text file may not keep: line ends, lone surrogates.
    return json.dumps(name, ensure_ascii=not name.isprintable())
