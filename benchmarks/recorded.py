"""The figures of speed that the pages show: one file, which the benchmarks write with `--record`.

Each entry says which run it is of, so that entries of several runs, of other days or machines, can
stand in one file. An entry is replaced whole: its contenders took turns in one run.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from pgm.io.sources import whole

FILE = Path(__file__).with_name("figures.json")
ENTRIES = "seconds", "compiling", "bytes", "by_size"


def digits(value: float) -> str:
    """Three digits, and all before the point."""
    return f"{value:.3g}" if value < 1e3 else f"{value:,.0f}"


def read() -> dict[str, Any]:
    """The file: ``runs``, by the minute of their end, and ``found``, entries by name."""
    figures: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return figures


def add(found: Mapping[str, Mapping[str, Any]], command: str, versions: Mapping[str, str]) -> None:
    """Replace these entries in the file by those of a run that ends now."""
    figures = read()
    run = datetime.now().isoformat(timespec="minutes")
    figures["runs"][run] = {"command": command, "versions": dict(versions)}
    figures["found"] |= {name: {"run": run} | dict(entry) for name, entry in found.items()}
    used = {entry["run"] for entry in figures["found"].values()}
    figures["runs"] = {name: each for name, each in figures["runs"].items() if name in used}
    with whole(FILE) as path:
        path.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


def entries(summary: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The entries of a summary of the command, by name."""
    others = {"versions", "quick", "compile", "memory", "curves"}
    found: dict[str, dict[str, Any]] = {
        name: {"seconds": times} for name, times in summary.items() if name not in others
    }
    for name, compiling in summary["compile"].items():
        found[name]["compiling"] = compiling
    for name, peaks in summary["memory"].items():
        found.setdefault(name, {})["bytes"] = peaks
    return found | {name: {"by_size": costs} for name, costs in summary["curves"].items()}


def summary(figures: Mapping[str, Any]) -> dict[str, Any]:
    """A summary, as of the command, of all that is recorded."""
    of: dict[str, dict[str, Any]] = {key: {} for key in ENTRIES}
    for name, entry in figures["found"].items():
        for key in entry.keys() & of.keys():
            of[key][name] = entry[key]
    curves = {
        name: {
            library: {int(size): cost for size, cost in costs.items()} for library, costs in each
        }
        for name, each in ((name, each.items()) for name, each in of["by_size"].items())
    }
    kept = {"compile": of["compiling"], "memory": of["bytes"], "curves": curves}
    return of["seconds"] | kept
