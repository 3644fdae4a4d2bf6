"""Summaries of values: a title, lines and listings, printed as text and as HTML, cut where long."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import product

# What is printed at most: lines, columns of letters, letters of one cell and of a title.
LINES, WIDTH, CELL, TITLE = 20, 100, 40, 300
INDENT = "  "
GAP = "  "
LEFT_OUT = "..."
# Numbers stand below each other in HTML too.
_CELL = "padding: 0 0.6em; white-space: pre; font-variant-numeric: tabular-nums"

# A row of cells; None stands for rows that are left out.
Row = Sequence[str] | None


@dataclass(frozen=True)
class Listing:
    """A table of cells, the first `names` columns being words; a row None stands for others."""

    heads: Sequence[str]
    rows: Sequence[Row]
    names: int = 1
    cell: int = CELL

    def lines(self, width: int) -> list[str]:
        """The lines of the table, without the columns that do not fit."""
        table = self._filled()
        if not any(map(any, table[:1])):
            table = table[1:]
        wide = [max(map(len, column)) for column in zip(*table, strict=True)]
        kept = len(wide)
        while kept > 2 and _total(wide[:kept], kept < len(wide)) > width:
            kept -= 1
        lines = []
        for row in table:
            cells = [
                cell.ljust(size) if k < self.names else cell.rjust(size)
                for k, (cell, size) in enumerate(zip(row[:kept], wide[:kept], strict=True))
            ]
            lines.append(GAP.join([*cells, *[LEFT_OUT] * (kept < len(wide))]).rstrip())
        return lines

    def html(self) -> str:
        """The table in HTML."""
        heads, *table = self._filled()
        head = "".join(f'<th style="{_CELL}">{escape(cell)}</th>' for cell in heads)
        rows = []
        for row in table:
            cells = [
                f'<td style="text-align: {"left" if k < self.names else "right"}; {_CELL}">'
                f"{escape(cell)}</td>"
                for k, cell in enumerate(row)
            ]
            rows.append(f"<tr>{''.join(cells)}</tr>")
        body = "".join(rows)
        top = f"<thead><tr>{head}</tr></thead>" if any(self.heads) else ""
        return f"<table>{top}<tbody>{body}</tbody></table>"

    def _filled(self) -> list[list[str]]:
        blank = [LEFT_OUT, *[""] * (len(self.heads) - 1)]
        rows = [self.heads, *(blank if row is None else row for row in self.rows)]
        return [[one_line(cell, self.cell) for cell in row] for row in rows]


@dataclass(frozen=True)
class Summary:
    """A value's text of a few lines, the first of them a title."""

    title: str
    parts: Sequence[str | Listing] = ()

    def text(self) -> str:
        """The summary as plain text, of no more lines than fit a terminal."""
        lines = [one_line(self.title, TITLE)]
        for part in self.parts:
            lines += [INDENT + line for line in _lines(part)]
        if len(lines) > LINES:
            lines[LINES - 1 :] = [INDENT + LEFT_OUT]
        return "\n".join(lines)

    def html(self, picture: str = "") -> str:
        """The summary in HTML, for notebooks, with the markup of a picture below the title."""
        parts = [f"<p><b>{escape(one_line(self.title, TITLE))}</b></p>", picture]
        for part in self.parts:
            words = f"<p>{escape(one_line(part))}</p>" if isinstance(part, str) else part.html()
            parts.append(words)
        return f"<div>{''.join(parts)}</div>"


def one_line(text: str, most: int | None = None) -> str:
    """A text without line breaks and other letters that would move the cursor."""
    line = "".join(letter if letter.isprintable() else _code(letter) for letter in text)
    return line if most is None or len(line) <= most else line[: most - 3] + LEFT_OUT


def _code(letter: str) -> str:
    return letter.encode("unicode_escape").decode("ascii")


def _lines(part: str | Listing) -> list[str]:
    width = WIDTH - len(INDENT)
    if isinstance(part, Listing):
        return part.lines(width)
    return textwrap.wrap(one_line(part), width, subsequent_indent=INDENT) or [""]


def _total(wide: Sequence[int], cut: bool) -> int:
    every = [*wide, *[len(LEFT_OUT)] * cut]
    return sum(every) + len(GAP) * (len(every) - 1)


# Rows of which all are shown, and the most that are shown of more.
ALL = 12
# Rows of the ends of one run: its first and last step, and what is between.
ENDS = 3

Place = tuple[int, ...]


def few(count: int, most: int = ALL) -> list[int | None]:
    """The places along one axis, the middle of a long one left out; None stands for it."""
    if count <= most:
        return list(range(count))
    first = (most + 1) // 2
    return [*range(first), None, *range(count - (most - first), count)]


def places(shape: Sequence[int], most: int = ALL) -> list[Place | None]:
    """Indices along several axes with the middle ones left out, marked by None."""
    if math.prod(shape) <= most:
        return list(product(*map(range, shape)))
    *outer, inner = shape
    runs, first = math.prod(outer), (0,) * len(outer)
    if runs == 1:
        return [None if step is None else (*first, step) for step in few(inner, max(most - 1, 1))]
    # The first and the last run, with both ends of their steps; or of the first alone.
    ends: list[Place | None] = [first, None]
    if most >= 2 * ENDS:
        ends = [first, *[None] * (runs > 2), tuple(size - 1 for size in outer)]
    steps = few(inner, 4 if most >= ALL else 2)
    found: list[Place | None] = []
    for run in ends:
        if run is None:
            found.append(None)
        else:
            found += [None if step is None else (*run, step) for step in steps]
    return found
