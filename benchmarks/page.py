"""`python -m benchmarks.page`: tables of the pages, written anew from the recorded figures.

A page says where a table stands by a comment with its name, and where it ends.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks import figure, recorded
from benchmarks.tables import TABLES

ROOT = Path(__file__).parent.parent
CURVES = ROOT / "docs" / "images" / "cost_against_size.png"
MARKED = re.compile(
    r"(?P<first><!-- figures of speed: (?P<name>.*?) -->\n).*?(?P<last><!-- end of figures -->)",
    flags=re.DOTALL,
)


def main() -> None:
    """Rewrite what stands between marks, and draw the curves, if any were recorded."""
    figures = recorded.read()
    for page in pages():
        page.write_text(written(page.read_text(encoding="utf-8"), figures), encoding="utf-8")
    if curves := recorded.summary(figures)["curves"]:
        figure.draw(curves, CURVES)


def pages() -> list[Path]:
    """The pages that have such tables."""
    found = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in found if MARKED.search(page.read_text(encoding="utf-8"))]


def written(text: str, figures: Mapping[str, Any]) -> str:
    """A page with its tables as the figures are now.

    Raises
    ------
    KeyError
        Where there is no table of a name, or no figures for it.
    """

    def renewed(match: re.Match[str]) -> str:
        lines = "\n".join(TABLES[match["name"]](figures))
        return f"{match['first']}\n{lines}\n\n{match['last']}"

    return MARKED.sub(renewed, text)


if __name__ == "__main__":
    main()
