"""`python -m benchmarks.page`: the last run's numbers into the guide's pages on speed."""

from __future__ import annotations

import json
import shutil
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import cliffs, neighbours
from benchmarks.command import OUT
from benchmarks.row import Row
from benchmarks.rows import ROWS
from benchmarks.verdicts import Verdict, verdicts

PAGE = Path("docs") / "speed.md"
FULL = "speed_full.md"
FIRST, LAST = "<!-- measured -->", "<!-- end of what was measured -->"
COLUMNS = (
    *("pgm", "pgm_compiled", "filterpy", "stonesoup", "dynamax", "hmmlearn", "cuthbert"),
    *("gtsam", "scipy", "pyagrum", "pgmpy", "particles", "amcl"),
)
FAMILIES = ("repository", "cold", "sets", "reading")  # rows of many networks
HEAD = ("row", "unit", *COLUMNS)


def main() -> None:
    """Rewrite what stands between the page's markers, and the full page; copy the figure."""
    summary = json.loads((OUT / "summary.json").read_text(encoding="utf-8"))
    before, rest = PAGE.read_text(encoding="utf-8").split(FIRST)
    _, after = rest.split(LAST)
    lines = "\n".join(measured(summary))
    PAGE.write_text(f"{before}{FIRST}\n{lines}\n{LAST}{after}", encoding="utf-8")
    PAGE.with_name(FULL).write_text("\n".join(full(summary)) + "\n", encoding="utf-8")
    shutil.copy(OUT / "cost_against_size.png", PAGE.parent / "images")


def measured(summary: Mapping[str, Any]) -> Iterator[str]:
    """Lines of Markdown: the table that can be held, changes, and what does not hold."""
    rows = _timed(summary)
    yield _how(summary)
    yield "Rows of networks are ranges over all of them; × is how many times `pgm`'s cost.\n"
    yield from _table(HEAD, _short(rows, summary))
    changes = list(cliffs.told(summary))
    if changes:
        yield "\nOne change of the model, and how many times the unchanged model's cost it takes:\n"
        yield from _table(cliffs.HEAD, changes)
    near = list(neighbours.told(summary))
    if near:
        yield "\nNeighbours of the plain compiled step, each with its limit:\n"
        yield from _table(neighbours.HEAD, near)
    every = list(verdicts(summary))
    broken = [each for each in every if not each.holds]
    yield (
        f"\nOf {len(every)} requirements, each of them [told beside this page]({FULL}), "
        + (f"{len(broken)} do not hold:\n" if broken else "all hold.")
    )
    if broken:
        yield from _table(ASKED, map(_asked, broken))
    yield _versions(summary)


def full(summary: Mapping[str, Any]) -> Iterator[str]:
    """Lines of Markdown: times by row and library, what must hold, and versions."""
    rows = _timed(summary)
    yield "# Speed, row by row\n"
    yield f"[What the rows are, and how they are measured]({PAGE.name}).\n"
    yield _how(summary)
    yield from _table(HEAD, (_line(row, summary) for row in rows))
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
    yield from _table(ASKED, map(_asked, verdicts(summary)))
    yield _versions(summary)


def _timed(summary: Mapping[str, Any]) -> list[Row]:
    """The rows of libraries; those of changes and neighbours have tables of their own."""
    others = (*cliffs.ROWS, *neighbours.ROWS)
    return [row for row in ROWS if row.name in summary and row not in others]


def _how(summary: Mapping[str, Any]) -> str:
    how = "make bench-quick" if summary["quick"] else "make bench"
    return f"Microseconds a unit, medians of `{how}`; compiling is not in them.\n"


def _short(rows: Iterable[Row], summary: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    """A line for each row, and one for all rows of a family."""
    families: dict[str, list[Row]] = {family: [] for family in FAMILIES}
    for row in rows:
        family = row.name.split("_")[0]
        if family in families:
            families[family].append(row)
        else:
            yield _line(row, summary)
    for family, members in families.items():
        if len(members) == 1:
            yield _line(members[0], summary)
        elif members:
            times = [summary[row.name] for row in members]
            ours = [_micro(pick(each["pgm"] for each in times)) for pick in (min, max)]
            ratios = (_ratios(times, library) for library in COLUMNS[1:])
            name = f"`{family}_…`, {len(members)} networks"
            yield name, members[0].unit, "–".join(ours), *ratios


def _ratios(times: Iterable[Mapping[str, float]], library: str) -> str:
    """How many times pgm's cost: range and median."""
    found = [each[library] / each["pgm"] for each in times if library in each]
    if not found:
        return ""
    low, high, middle = (_digits(pick(found)) for pick in (min, max, statistics.median))
    return f"{low}–{high} ×, median {middle} ×"


def _line(row: Row, summary: Mapping[str, Any]) -> Sequence[str]:
    times = summary[row.name]
    return f"`{row.name}`", row.unit, *(_micro(times.get(library)) for library in COLUMNS)


ASKED = ("what must hold", "measured", "asked", "")


def _asked(each: Verdict) -> Sequence[str]:
    return (
        each.what,
        f"{each.measured:.2f}",
        f"{'≥' if each.least else '≤'} {each.asked:g}",
        "holds" if each.holds else "**does not hold**",
    )


def _versions(summary: Mapping[str, Any]) -> str:
    return "\n" + ", ".join(f"{name} {version}" for name, version in summary["versions"].items())


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    for cells in (head, ["---"] * len(head), *rows):
        yield f"| {' | '.join(cells)} |"


def _micro(value: float | None) -> str:
    return "" if value is None else _digits(1e6 * value)


def _digits(value: float) -> str:
    """Three digits, and all before the point."""
    return f"{value:.3g}" if value < 1e3 else f"{value:.0f}"


if __name__ == "__main__":
    main()
