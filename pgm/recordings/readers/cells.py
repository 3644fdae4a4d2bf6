"""Cells of a table of values in a text: lines, the names of columns, numbers."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pgm.factors.scope import listed
from pgm.io.networks.cursor import shown
from pgm.io.sources import Content, Origin, number

_DECIMAL = re.compile(r"[+-]?[0-9]+,[0-9]+")


@dataclass(frozen=True, slots=True)
class Cells:
    """The cells of a file: comments above the first line, lines with their numbers, decimals."""

    comments: Sequence[Sequence[str]]
    rows: Sequence[tuple[int, Sequence[str]]]
    origin: Origin
    delimiter: str
    decimal: str


def cells_of(held: Content, delimiter: str, decimal: str) -> Cells:
    """The cells of each line that has any, with its number from 1; comments at the top apart."""
    reader = csv.reader(io.StringIO(held.text(), newline=""), delimiter=delimiter)
    comments: list[Sequence[str]] = []
    rows: list[tuple[int, Sequence[str]]] = []
    try:
        for cells in reader:
            if cells and cells[0].lstrip().startswith("#"):
                if not rows:
                    comments.append(cells)
            elif any(map(str.strip, cells)):
                rows.append((reader.line_num, cells))
    except csv.Error as error:
        raise held.origin.fault(f"it is no table of values: {error}", reader.line_num) from None
    if not rows:
        raise held.origin.fault("it has no lines of values; is it another file, or cut?")
    return Cells(comments, rows, held.origin, delimiter, decimal)


def named(table: Cells, wanted: set[str]) -> tuple[Sequence[str], Cells]:
    """The names of the columns, and the lines below them.

    They are the first line, or a comment above it that has more of the names wanted.
    """
    (line, first), *rest = table.rows
    names = [name.strip() for name in first]
    headers = [names]
    for cells in table.comments:
        told = [name.strip() for name in cells]
        headers += [told, [told[0].lstrip("#").strip(), *told[1:]]]
    best = max(headers, key=lambda header: len(wanted & set(header)))
    if best is not names:
        return best, table
    if len(names) == 1 and (apart := [mark for mark in ";\t|, " if mark in names[0]]):
        raise table.origin.fault(
            f"its names are one cell, {shown(names[0])}; delimiter={apart[0]!r} divides it", line
        )
    for row, cells in rest:
        if any(map(str.strip, cells[len(first) :])):
            raise table.origin.fault(
                f"it has {len(cells)} cells, where {len(first)} columns have names; is there a "
                "comma within numbers? Then delimiter= and decimal= are to differ",
                row,
            )
    return names, replace(table, rows=rest)


def place(column: str | int, header: Sequence[str], table: Cells) -> int:
    """The place of a column that is named or numbered."""
    if not isinstance(column, str):
        return column
    if header.count(column) != 1:
        found = "no column" if column not in header else "several columns"
        raise table.origin.fault(f"it has {found} {column!r}; they are {listed(header)}")
    return header.index(column)


def number_in(word: str, size: float, line: int, table: Cells, missing: bool) -> float:
    """The number of a cell times the size of its unit; NaN of an empty one that may be missing."""
    if not word and missing:
        return math.nan
    if not word:
        raise table.origin.fault("an empty cell, where a number was due", line)
    if table.decimal == "." and _DECIMAL.fullmatch(word):
        raise table.origin.fault(f"{word!r} is no number; decimal=',' reads it as one", line)
    return number(word.replace(table.decimal, "."), line, table.origin) * size
