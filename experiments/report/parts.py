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
# Tables of more columns or rows than these are folded under their titles.
WIDE, LONG = 9, 16
_PHONE = 42 * 16  # pixels, to which narrow windows scale a picture that is wider
_BEST = "Bold: best of its column"
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
        return figure(folder / entry["figure"], entry["caption"])
    if "table" in entry:
        return table(entry)
    if "note" in entry:
        return f"<p class=note>{escape(entry['note'])}</p>"
    raise ValueError(f"a page has figures, tables and notes; found {sorted(entry)}")


def table(entry: Mapping[str, Any]) -> str:
    """A table of texts, columns of numbers set right, and folded where it is long or supporting.

    Parameters
    ----------
    entry : mapping
        ``table`` is its title; ``columns``, ``rows``, ``about``, ``best`` and ``folded`` as
        `experiments.record.Record.table` keeps them, the last three may be absent.
    """
    columns, rows = entry["columns"], entry["rows"]
    right = [_numeric(cells) for cells in zip(*rows, strict=True)] or [False] * len(columns)
    best = {tuple(cell) for cell in entry.get("best", ())}

    def line(tag: str, cells: Sequence[str], row: int = -1) -> str:
        found = (
            f"<{tag}{_kind(right[k], (row, k) in best)}>{escape(cell)}</{tag}>"
            for k, cell in enumerate(cells)
        )
        return f"<tr>{''.join(found)}</tr>"

    body = "\n".join(line("td", row, r) for r, row in enumerate(rows))
    about = entry.get("about", "")
    if best:
        about = f"{about} {_BEST}{_grouped(entry)}; near ones may differ by chance.".strip()
    words = f"<p class=about>{escape(about)}</p>\n" if about else ""
    inside = (
        f"{words}<div class=table><table>\n<thead>{line('th', columns)}</thead>\n"
        f"<tbody>\n{body}\n</tbody>\n</table></div>"
    )
    title = escape(entry["table"])
    if entry.get("folded") or len(columns) > WIDE or len(rows) > LONG:
        size = f"{len(rows)} row{'s' * (len(rows) != 1)}"
        return (
            f"<details>\n<summary><span class=title>{title}</span> "
            f"<span class=meta>{size}</span></summary>\n{inside}\n</details>"
        )
    return f"<h4>{title}</h4>\n{inside}"


def figure(path: Path, caption: str) -> str:
    """A figure with its picture inside, as wide as on paper."""
    kind = mimetypes.guess_type(path.name)[0]
    content = path.read_bytes()
    data = base64.b64encode(content).decode()
    words = escape(caption)
    return (
        f'<figure>\n<div class=picture><img src="data:{kind};base64,{data}"{_width(content)} '
        f'alt="{words}"></div>\n<figcaption>{words}</figcaption>\n</figure>'
    )


def settings(values: Mapping[str, Any]) -> str:
    """Settings in a line."""
    return " · ".join(f"{escape(name)} {escape(_plain(value))}" for name, value in values.items())


def _kind(number: bool, best: bool) -> str:
    names = " ".join(["number"] * number + ["best"] * best)
    return f' class="{names}"' if best else " class=number" if number else ""


def _grouped(entry: Mapping[str, Any]) -> str:
    within = entry.get("within", ())
    return f", within rows of one {' and '.join(map(str, within))}" if within else ""


def _width(content: bytes) -> str:
    """As wide as a figure is on paper, an inch being 96 of a page's pixels."""
    if not content.startswith(b"\x89PNG"):
        return ""
    width = round(int.from_bytes(content[16:20], "big") * 96 / DPI)
    return f" width={width}{' class=wide' if width > _PHONE else ''}"


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
