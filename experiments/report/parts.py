"""The parts of an experiment's record as HTML."""

from __future__ import annotations

import base64
import mimetypes
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

# Of the figures that `experiments.record.Record` writes.
DPI = 150
# A number, perhaps with its error, range or unit behind it.
_NUMBER = re.compile(r"[<>≈]?\s*[-−+]?(\d[\d.,]*(e[-+]?\d+)?|nan|inf)(\s*([±(/…%–]|to ).*)?", re.I)
_NOTHING = {"", "-", "–", "—"}


def part(entry: Mapping[str, Any], folder: Path) -> str:
    """A figure, table or note of a page, as `experiments.record.Record` keeps it.

    Raises
    ------
    ValueError
        If it is none of these.
    """
    if "figure" in entry:
        return _figure(folder / entry["figure"], entry["caption"])
    if "table" in entry:
        return table(entry["table"], entry["columns"], entry["rows"])
    if "note" in entry:
        return f"<p class=note>{escape(entry['note'])}</p>"
    raise ValueError(f"a page has figures, tables and notes; found {sorted(entry)}")


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of texts; columns of numbers are set right."""
    right = [_numeric(cells) for cells in zip(*rows, strict=True)] or [False] * len(columns)

    def line(tag: str, cells: Iterable[str]) -> str:
        found = (
            f"<{tag}{' class=number' if number else ''}>{escape(cell)}</{tag}>"
            for cell, number in zip(cells, right, strict=True)
        )
        return f"<tr>{''.join(found)}</tr>"

    body = "\n".join(line("td", row) for row in rows)
    return (
        f"<h4>{escape(title)}</h4>\n<div class=table><table>\n"
        f"<thead>{line('th', columns)}</thead>\n<tbody>\n{body}\n</tbody>\n</table></div>"
    )


def settings(values: Mapping[str, Any]) -> str:
    """Settings in a line."""
    return " · ".join(f"{escape(name)} {escape(_plain(value))}" for name, value in values.items())


def _figure(path: Path, caption: str) -> str:
    kind = mimetypes.guess_type(path.name)[0]
    content = path.read_bytes()
    data = base64.b64encode(content).decode()
    words = escape(caption or path.stem.replace("_", " "))
    below = f"\n<figcaption>{words}</figcaption>" if caption else ""
    return (
        f'<figure>\n<img src="data:{kind};base64,{data}"{_width(content)} alt="{words}">'
        f"{below}\n</figure>"
    )


def _width(content: bytes) -> str:
    """As wide as a figure is on paper, an inch being 96 of a page's pixels."""
    if not content.startswith(b"\x89PNG"):
        return ""
    pixels = int.from_bytes(content[16:20], "big")
    return f" width={round(pixels * 96 / DPI)}"


def _numeric(cells: Iterable[str]) -> bool:
    filled = [cell.strip() for cell in cells if cell.strip() not in _NOTHING]
    return bool(filled) and all(_NUMBER.fullmatch(cell) for cell in filled)


def _plain(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Mapping):
        return f"({', '.join(f'{k} {_plain(v)}' for k, v in value.items())})"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(map(_plain, value))}]"
    return "none" if value is None else str(value)
