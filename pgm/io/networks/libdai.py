"""Factor graphs in the format of libDAI, .fg."""

from __future__ import annotations

import math
from typing import cast

import numpy as np

from pgm.arguments import public
from pgm.cpds import TableCPD
from pgm.factors import Table
from pgm.factors.axes import AXES
from pgm.io import sources
from pgm.io.networks.assembly import ENTRY
from pgm.io.networks.uai import Words
from pgm.io.networks.uai_writers import entries, numbered
from pgm.io.sources import LIMIT, Source
from pgm.networks import MarkovNetwork
from pgm.variables import Discrete


@public
def read_fg(source: Source, *, limit: int = LIMIT) -> MarkovNetwork:
    """The Markov network of a factor graph in libDAI's format, .fg.

    The file has the number of factors; then of each how many variables it has, their labels, their
    numbers of states, how many of its entries are not zero, and of each of these its place and its
    value. The states of the first variable move fastest. Variables are called by their labels, and
    states by their indices. Comments, from ``#`` to the end of a line, are skipped.

    Parameters
    ----------
    source, limit
        See `read_bif`.

    Returns
    -------
    MarkovNetwork

    Raises
    ------
    FileError, OSError
        See `read_bif`.

    Examples
    --------
    >>> import io
    >>> pgm.read_fg(io.StringIO("1  2  7 9  2 2  3  0 2.0  1 1.0  3 2.0")).factors[0]
    Table(7, 9) of (2, 2) states
      7  9: 0  1
      0     2  0
      1     1  2

    References
    ----------
    Mooij, libDAI: a free and open source C++ library for discrete approximate inference, 2010.
    """
    words = Words(sources.read(source, limit), heading=False)
    variables: dict[str, Discrete] = {}
    factors: list[Table] = []
    left = limit // ENTRY
    for _ in range(words.count("the number of factors")):
        start = words.at
        count = words.count("the number of variables")
        if count > AXES:
            words.fail(f"a factor of {count} variables; there is room for {AXES}", start)
        labels = [str(words.count("a label")) for _ in range(count)]
        if len(set(labels)) < count:
            words.fail(f"a factor has a variable twice: {', '.join(labels)}", start)
        sizes = [words.count("a number of states") for _ in range(count)]
        left -= math.prod(sizes)
        if left < 0:
            words.fail(
                "its tables have more entries than the limit leaves room for; where that is meant, "
                "raise the limit (limit=)",
                start,
            )
        for label, size in zip(labels, sizes, strict=True):
            if not size:
                words.fail(f"the variable {label} has no states", start)
            variable = variables.setdefault(label, Discrete(label, size))
            if variable.size != size:
                words.fail(
                    f"the variable {label} has {size} states here, and {variable.size} before",
                    start,
                )
        values, seen = np.zeros(math.prod(sizes)), set[int]()
        for _ in range(words.count("the number of entries")):
            place = words.count("the place of an entry")
            if place >= values.size:
                words.fail(f"a place {place} of {values.size} entries", words.at - 1)
            if place in seen:
                words.fail(f"the place {place} is given twice; keep one entry", words.at - 1)
            seen.add(place)
            (value,) = words.take(1).tolist()
            if not 0.0 <= value < math.inf:
                words.fail(f"{value:.9g} is no entry of a factor; correct it", words.at - 1)
            values[place] = value
        scope = [variables[label] for label in labels]
        factors.append(Table(scope, values.reshape(sizes, order="F")))
    words.finish()
    if not variables:
        raise words.fault("it has no variable", None)
    return MarkovNetwork(factors)


@public
def write_fg(network: MarkovNetwork, target: Source) -> None:
    """Write a network of tables in libDAI's format, .fg, which `read_fg` reads back.

    Parameters
    ----------
    network : BayesianNetwork or MarkovNetwork
        Of discrete variables, which are written by their indices as in `write_uai`.
    target : str, Path or open file
        See `write_bif`.

    Raises
    ------
    FileError, ModelError
        See `write_uai`.

    Examples
    --------
    >>> import io
    >>> from pgm.examples import coin
    >>> file = io.StringIO()
    >>> pgm.write_fg(coin, file)
    >>> file.getvalue().split()
    ['1', '1', '0', '2', '2', '0', '0.25', '1', '0.75']
    """
    index = {variable: k for k, variable in enumerate(numbered(network, "write_fg"))}
    lines = [str(len(network.factors))]
    for factor in cast(tuple[Table | TableCPD, ...], network.factors):
        axes = factor._potential.axes
        flat = entries(factor).ravel(order="F")
        some = np.flatnonzero(flat).tolist()
        lines += [
            "",
            str(len(axes)),
            " ".join(str(index[v]) for v in axes),
            " ".join(str(v.size) for v in axes),
            str(len(some)),
            *(f"{place} {flat[place].item()!r}" for place in some),
        ]
    sources.write(target, "\n".join(lines) + "\n")
