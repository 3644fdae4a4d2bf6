"""The command: rows are checked, timed and told."""

from __future__ import annotations

import argparse
import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

from benchmarks import cliffs, figure, memory, neighbours, recorded
from benchmarks.choice import Choice, short
from benchmarks.row import Row
from benchmarks.verdicts import verdicts
from experiments.record import folder, note, table, versions
from pgm.io.sources import whole

OUT = Path("results") / "bench"
PEERS = (
    "filterpy",
    "stonesoup",
    "dynamax",
    "jax",
    "hmmlearn",
    "cuthbert",
    "gtsam",
    "pyagrum",
    "pgmpy",
    "particles",
    "amcl",
)


def main(arguments: list[str] | None = None) -> None:
    """Run rows and curves, print tables, write summary.json and the figure."""
    everything = Choice()
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Time pgm and other libraries on the same work, once they agree.",
    )
    parser.add_argument("--quick", action="store_true", help="smaller work, fewer repeats")
    parser.add_argument(
        "--only",
        help="some, with commas between them, or the words some begin with, as in cliffs: "
        f"{', '.join(everything.names)}",
    )
    parser.add_argument(
        "--against",
        help=f"beside pgm only some libraries, or changes: {', '.join(everything.others)}",
    )
    parser.add_argument("--repeats", type=int, help="timed calls of each library")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for results")
    parser.add_argument(
        "--record",
        action="store_true",
        help="write benchmarks/figures.json, of which the pages are",
    )
    options = parser.parse_args(arguments)
    if options.record and (options.quick or options.against):
        parser.error("--record is of whole rows at full size: not with --quick or --against")
    if options.repeats is not None and options.repeats < 1:
        parser.error(f"--repeats must be 1 or more, not {options.repeats}")
    try:
        chosen = chosen_by(options)
    except ValueError as error:
        parser.error(str(error))
    out, quick = folder(options.out), options.quick
    repeats = options.repeats or (3 if quick else 7)
    summary: dict[str, Any] = {"versions": known(), "quick": quick}
    summary |= {"compile": {}, "memory": {}, "curves": {}}
    note(f"versions: {summary['versions']}")
    for row in chosen.rows:
        times, compiling = run(row, quick, repeats)
        if times:
            summary[row.name], summary["compile"][row.name] = times, compiling
    for large in chosen.networks:
        times, summary["memory"][large.name] = memory.measure(large)
        if times:
            summary[large.name] = times
    for curve in chosen.curves:
        summary["curves"][curve.name] = curve.measure(quick, min(repeats, 2 if quick else 5))
    if summary["curves"]:
        figure.draw(summary["curves"], out / "cost_against_size.png")
    tell(summary)
    with whole(out / "summary.json") as path:
        path.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    if options.record:
        recorded.add(recorded.entries(summary), _command(options), summary["versions"])


def _command(options: argparse.Namespace) -> str:
    """The words that make this run again."""
    only = "" if options.only is None else f" --only {options.only}"
    return f"python -m benchmarks{only}"


def chosen_by(options: argparse.Namespace) -> Choice:
    """The choice of a run, by its options.

    Raises
    ------
    ValueError
        Where there is nothing of a name.
    """
    chosen = short() if options.quick else Choice()
    if options.only is not None:
        chosen = Choice().only(options.only)
    return chosen if options.against is None else chosen.against(options.against)


def run(row: Row, quick: bool, repeats: int) -> tuple[dict[str, float], dict[str, float]]:
    """Seconds a unit, and seconds of compiling, by library; prints them.

    None, where pgm's own part lacks something.
    """
    size = row.quick if quick and row.quick else row.size
    ready, missing = row.prepared(size)
    if "pgm" in missing:
        note(f"{row.name} is left out: {missing['pgm']}")
        return {}, {}
    row.agree(ready, size)
    times = row.timed(ready, min(repeats, row.repeats or repeats))
    compiling = {k: each.compiling for k, each in ready.items() if each.compiling is not None}
    table(
        f"{row.name}: microseconds a {row.unit}",
        ("library", "µs", "/ pgm", "compiling [s]"),
        [
            (library, 1e6 * value, value / times["pgm"], compiling.get(library, ""))
            for library, value in times.items()
        ],
    )
    for library, why in missing.items():
        note(f"{row.name}: {library} is left out, {why}")
    return times, compiling


def tell(summary: dict[str, Any]) -> None:
    """Print the curves, and what must hold."""
    for name, libraries in summary["curves"].items():
        sizes = list(libraries["pgm"])
        table(
            f"{name}: microseconds a step, or simulation, by size",
            ("library", *(f"{size:,}" for size in sizes)),
            [
                (library, *(1e6 * costs[size] for size in sizes))
                for library, costs in libraries.items()
            ],
        )
    changes = list(cliffs.told(summary))
    if changes:
        table("changes: times the unchanged model's cost", cliffs.HEAD, changes)
    near = list(neighbours.told(summary))
    if near:
        table("neighbours of the plain compiled step", neighbours.HEAD, near)
    found = list(verdicts(summary))
    if found:
        table(
            "what must hold",
            ("what", "measured", "asked", "holds"),
            [
                (
                    each.what,
                    each.measured,
                    f"{'at least' if each.least else 'at most'} {each.asked:g}",
                    "yes" if each.holds else "NO",
                )
                for each in found
            ],
        )


def known() -> dict[str, str]:
    """Versions of what is compared, and on what machine."""
    here = versions() | {"processor": _processor()}
    for peer in PEERS:
        try:
            here[peer] = metadata.version(peer)
        except metadata.PackageNotFoundError:
            here[peer] = "not installed"
    return here


def _processor() -> str:
    """Its name, where the system tells it."""
    described = Path("/proc/cpuinfo")
    lines = described.read_text(encoding="utf-8").splitlines() if described.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
