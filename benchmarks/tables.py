"""Tables of the pages, as lines of Markdown, of the figures that were recorded."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from benchmarks import cliffs, first_call, gains, neighbours, recorded
from benchmarks.recorded import digits
from benchmarks.row import Row
from benchmarks.rows import ROWS
from benchmarks.verdicts import Verdict, verdicts

Figures = Mapping[str, Any]
Lines = Iterator[str]

OURS = "pgm", "pgm_compiled"
FAMILIES = ("repository", "cold", "sets", "reading")  # rows of many networks
NUMBERS = "NumPy", "compiled", "elsewhere"
HEAD = ("row", "unit", *NUMBERS, "run")
ASKED = ("what must hold", "measured", "asked", "")
BESIDE = {  # rows of `make bench`, and their words in the guide
    "smoother of one robot, Taylor": ("rts_taylor",),
    "smoother of one robot, unscented": ("rts_unscented",),
    "… of 60 steps, prepared": ("short",),
    "one robot in its loop, Taylor": ("online_taylor",),
    "one robot in its loop, unscented": ("online_unscented",),
    "smoother of a linear chain (NumPy: balanced tree)": ("linear",),
    "smoother of 12, 24, 50 components": ("components_12", "components_24", "components_50"),
    "filter of 1,000 robots, Taylor": ("ekf_robots",),
    "filter of 1,000 robots, unscented": ("ukf_robots",),
    "one step of 10,000 simulations, Taylor": ("ekf_one_step",),
    "one step of 10,000 simulations, unscented": ("ukf_one_step",),
    "a target of 2, 3, 5 motions, interacting multiple model": ("imm_2", "imm_3", "imm_5"),
    "… of 2, 3 motions, a Gaussian for each pair": ("gpb2_2", "gpb2_3"),
    "… 1,000 targets of 2 motions, interacting multiple model": ("imm_runs",),
    "optimum of 10,000 poses (NumPy: balanced tree)": ("map",),
}
LOOP = {"`Taylor()`": ("online_taylor",), "`Unscented()`": ("online_unscented",)}
NETWORKS = {
    "M3500: 3,500 poses, 5,453 edges": ("graph_m3500",),
    "… declared, compiled and solved": ("graph_m3500_whole",),
    "… pose by pose, by `GrowingMap`": ("graph_m3500_growing",),
    "intel: 1,728 poses": ("graph_intel",),
    "a drawn town of 10,000 poses, 20,687 edges": ("graph_city",),
    "30 landmarks, 200 poses": ("landmarks_30",),
    "300 landmarks, 2,000 poses": ("landmarks_300",),
    "field of 100 × 100 (SciPy: means alone)": ("field_100",),
    "field of 300 × 300 (SciPy: means alone)": ("field_300",),
    "chain of 100,000 (SciPy: means alone)": ("field_chain",),
}


def rows(figures: Figures) -> Lines:
    """Rows of libraries; networks of a family in one line."""
    yield from _table(HEAD, _short(_timed(figures), figures))
    yield from _runs(figures, (row.name for row in _timed(figures)))


def every(figures: Figures) -> Lines:
    """Rows of libraries, each in its line; compiling, and memory."""
    timed = _timed(figures)
    yield from _table(HEAD, (_line(row, figures) for row in timed))
    found = figures["found"]
    compiling = [
        f"`{name}.{library}` {value:.1f} s"
        for name, entry in found.items()
        for library, value in entry.get("compiling", {}).items()
    ]
    large = [
        f"`{name}.{library}` {entry['seconds'][library]:.3g} s, {peak / 2**20:.0f} MiB"
        for name, entry in found.items()
        for library, peak in entry.get("bytes", {}).items()
    ]
    yield f"\nLarge networks, tree and all marginals, and memory held: {', '.join(large)}.\n"
    yield f"Compiling, once for each shape: {', '.join(compiling)}."
    yield from _runs(figures, [row.name for row in timed], versions=True)


def asked(figures: Figures) -> Lines:
    """All that must hold."""
    yield from _table(ASKED, map(_asked, verdicts(recorded.summary(figures))))


def broken(figures: Figures) -> Lines:
    """How much must hold, and what does not."""
    found = list(verdicts(recorded.summary(figures)))
    wrong = [each for each in found if not each.holds]
    count = f"{len(wrong)} do not hold:\n" if wrong else "all hold."
    yield f"Of {len(found)} requirements {count}"
    if wrong:
        yield from _table(ASKED, map(_asked, wrong))


def changes(figures: Figures) -> Lines:
    """Changes of the model, and how many times the unchanged model's cost they take."""
    yield from _table(cliffs.HEAD, cliffs.told(recorded.summary(figures)))
    yield from _runs(figures, (row.name for row in cliffs.ROWS))


def near(figures: Figures) -> Lines:
    """Neighbours of the plain compiled step."""
    yield from _table(neighbours.HEAD, neighbours.told(recorded.summary(figures)))
    yield from _runs(figures, (row.name for row in neighbours.ROWS))


def gained(figures: Figures) -> Lines:
    """Steps by NumPy and in machine code."""
    yield from _table(gains.HEAD, gains.told(figures["found"][gains.NAME]["ways"]))
    yield from _runs(figures, [gains.NAME])


def first(figures: Figures) -> Lines:
    """What the first call of a process takes."""
    lengths = figures["found"][first_call.NAME]["lengths"]
    yield from _table(first_call.HEAD, first_call.told(lengths))
    yield from _runs(figures, [first_call.NAME])


def _beside(words: Mapping[str, Sequence[str]]) -> Callable[[Figures], Lines]:
    """A table of rows beside other libraries, under words of the guide."""

    def lines(figures: Figures) -> Lines:
        found = figures["found"]
        here = {label: [name for name in names if name in found] for label, names in words.items()}
        yield from _table(
            ("row", *NUMBERS),
            ((label, *_cells(_times(figures, names))) for label, names in here.items() if names),
        )
        yield from _runs(figures, (name for names in here.values() for name in names))

    return lines


def _times(figures: Figures, names: Iterable[str]) -> list[Mapping[str, float]]:
    return [figures["found"][name]["seconds"] for name in names]


def _cells(times: Sequence[Mapping[str, float]]) -> tuple[str, ...]:
    """By NumPy, in machine code, and elsewhere: the times of some rows."""

    def numbers(library: str) -> str:
        return ", ".join(digits(1e6 * each[library]) for each in times if library in each)

    return *map(numbers, OURS), _elsewhere(times, numbers)


def _elsewhere(times: Iterable[Mapping[str, float]], told: Callable[[str], str]) -> str:
    """Every other contender, and what is told of it."""
    others = dict.fromkeys(library for each in times for library in each if library not in OURS)
    return "; ".join(f"{library} {told(library)}" for library in others)


TABLES: dict[str, Callable[[Figures], Lines]] = {
    "rows": rows,
    "every row": every,
    "what must hold": asked,
    "what does not hold": broken,
    "changes": changes,
    "neighbours": near,
    "gains": gained,
    "first calls": first,
    "beside other libraries": _beside(BESIDE),
    "one robot's loop": _beside(LOOP),
    "networks without time": _beside(NETWORKS),
}


def _timed(figures: Figures) -> list[Row]:
    """The rows of libraries; those of changes and neighbours have tables of their own.

    Raises
    ------
    FileNotFoundError
        Where the published pose graphs are not here, whose rows have other names then.
    """
    drawn = {row.name.replace("_drawn", "") for row in ROWS if "_drawn" in row.name}
    absent = [name for name in figures["found"] if name in drawn]
    if absent:
        raise FileNotFoundError(
            f"figures of {', '.join(absent)} are recorded, and the pose graphs are not here; "
            "PGM_DATA may name their folder's folder"
        )
    others = (*cliffs.ROWS, *neighbours.ROWS)
    return [row for row in ROWS if row.name in figures["found"] and row not in others]


def _short(timed: Iterable[Row], figures: Figures) -> Iterator[Sequence[str]]:
    """A line for each row, and one for all rows of a family."""
    families: dict[str, list[Row]] = {family: [] for family in FAMILIES}
    for row in timed:
        family = row.name.split("_")[0]
        if family in families:
            families[family].append(row)
        else:
            yield _line(row, figures)
    for family, members in families.items():
        if len(members) == 1:
            yield _line(members[0], figures)
        elif members:
            times = _times(figures, (row.name for row in members))
            ours = [digits(1e6 * pick(each["pgm"] for each in times)) for pick in (min, max)]
            name = f"`{family}_…`, {len(members)} networks"
            days = sorted({_day(figures, row) for row in members})
            elsewhere = _elsewhere(times, partial(_ratios, times))
            yield name, members[0].unit, "–".join(ours), "", elsewhere, ", ".join(days)


def _ratios(times: Iterable[Mapping[str, float]], library: str) -> str:
    """How many times pgm's cost: range and median."""
    found = [each[library] / each["pgm"] for each in times if library in each]
    low, high, middle = (digits(pick(found)) for pick in (min, max, statistics.median))
    return f"{low}–{high} ×, median {middle} ×"


def _line(row: Row, figures: Figures) -> Sequence[str]:
    return f"`{row.name}`", row.unit, *_cells(_times(figures, [row.name])), _day(figures, row)


def _day(figures: Figures, row: Row) -> str:
    """The day of a row's run, without the year, with a hyphen at which no line breaks."""
    return str(figures["found"][row.name]["run"])[5:10].replace("-", "\N{NON-BREAKING HYPHEN}")


def _asked(each: Verdict) -> Sequence[str]:
    return (
        each.what,
        f"{each.measured:.2f}",
        f"{'≥' if each.least else '≤'} {each.asked:g}",
        "holds" if each.holds else "**does not hold**",
    )


def _runs(figures: Figures, names: Iterable[str], *, versions: bool = False) -> Lines:
    """Of which runs a table is: day, command, processor; with the versions of all libraries."""
    used = {figures["found"][name]["run"] for name in names if name in figures["found"]}
    for run in sorted(used):
        how = figures["runs"][run]
        told = how["versions"] if versions else {"": how["versions"]["processor"]}
        with_versions = ", ".join(f"{name} {version}".strip() for name, version in told.items())
        yield f"\n*{run[:10]}, `{how['command']}`: {with_versions}.*"


def _table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> Lines:
    for cells in (head, ["---"] * len(head), *lines):
        yield f"| {' | '.join(cells)} |"
