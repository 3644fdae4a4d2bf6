"""`python -m benchmarks.page`: the last run's numbers into the guide's page on speed."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.command import OUT
from benchmarks.rows import ROWS
from benchmarks.verdicts import verdicts

PAGE = Path("docs") / "speed.md"
FIRST, LAST = "<!-- measured -->", "<!-- end of what was measured -->"
COLUMNS = ("pgm", "filterpy", "stonesoup", "dynamax", "cuthbert", "gtsam", "pyagrum", "pgmpy")


def main() -> None:
    """Rewrite what stands between the page's markers, and copy the figure."""
    summary = json.loads((OUT / "summary.json").read_text(encoding="utf-8"))
    before, rest = PAGE.read_text(encoding="utf-8").split(FIRST)
    _, after = rest.split(LAST)
    lines = "\n".join(measured(summary))
    PAGE.write_text(f"{before}{FIRST}\n{lines}\n{LAST}{after}", encoding="utf-8")
    shutil.copy(OUT / "cost_against_size.png", PAGE.parent / "images")


def measured(summary: Mapping[str, Any]) -> Iterator[str]:
    """Lines of Markdown: times by row and library, what must hold, and versions."""
    how = "make bench-quick" if summary["quick"] else "make bench"
    yield f"Microseconds a unit, medians of `{how}`; compiling is not in them.\n"
    rows = [row for row in ROWS if row.name in summary]
    yield from _table(
        ("row", "unit", *COLUMNS),
        (
            (f"`{row.name}`", row.unit, *(_micro(summary[row.name].get(c)) for c in COLUMNS))
            for row in rows
        ),
    )
    others = [
        f"`{row.name}.{library}` {_micro(value)}"
        for row in rows
        for library, value in summary[row.name].items()
        if library not in COLUMNS
    ]
    compiling = [
        f"`{row}.{library}` {value:.1f} s"
        for row, each in summary["compile"].items()
        for library, value in each.items()
    ]
    large = [
        f"`{name}.{library}` {summary[name][library]:.3g} s, {peak / 2**20:.0f} MiB"
        for name, peaks in summary["memory"].items()
        for library, peak in peaks.items()
    ]
    yield f"\nFurther: {', '.join([*others, *large])}.\n"
    yield f"Compiling, once for each shape: {', '.join(compiling)}.\n"
    yield from _table(
        ("what must hold", "measured", "asked", ""),
        (
            (
                each.what,
                f"{each.measured:.2f}",
                f"{'≥' if each.least else '≤'} {each.asked:g}",
                "holds" if each.holds else "**does not hold**",
            )
            for each in verdicts(summary)
        ),
    )
    yield "\n" + ", ".join(f"{name} {version}" for name, version in summary["versions"].items())


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    for cells in (head, ["---"] * len(head), *rows):
        yield f"| {' | '.join(cells)} |"


def _micro(value: float | None) -> str:
    return "" if value is None else f"{1e6 * value:.3g}" if value < 1e-3 else f"{1e6 * value:.0f}"


if __name__ == "__main__":
    main()
