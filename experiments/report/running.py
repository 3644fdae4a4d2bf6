"""Experiments run one after another; one that fails does not take the others with it."""

from __future__ import annotations

import inspect
import io
import json
import sys
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import typer

from experiments.catalogue import summary_line
from experiments.record import SUMMARY, refusal


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of one experiment.

    Attributes
    ----------
    name, title : str
        Its name, and the first line of its docstring.
    command : str
        That makes the same results below ``results/``.
    folder : Path
        Where its results are.
    seconds : float
        How long it ran.
    summary : mapping or None
        Its summary.json; None where it wrote none.
    said : str
        What it printed.
    error : str
        Its refusal in a line, or else its traceback; empty where it did not fail.
    """

    name: str
    title: str
    command: str
    folder: Path
    seconds: float
    summary: Mapping[str, Any] | None
    said: str
    error: str


def run_all(
    experiments: Mapping[str, Any], out: Path, *, seed: int, quick: bool
) -> Iterator[Outcome]:
    """Run experiments one at a time, each into a folder of its own; see `make_report`."""
    for name, experiment in experiments.items():
        folder = out / name
        settings: dict[str, Any] = {"out": folder}
        if "seed" in inspect.signature(experiment.run).parameters:
            settings["seed"] = seed
        if quick:
            settings |= experiment.QUICK
        begin, said, error, summary = time.perf_counter(), _Tee(), "", None
        try:
            # An earlier run's would hide that this one wrote none.
            (folder / SUMMARY).unlink(missing_ok=True)
            with redirect_stdout(said):
                experiment.run(**settings)
            summary = _summary(folder)
        except Exception as failure:
            error = refusal(failure) or traceback.format_exc()
        finally:
            plt.close("all")
        yield Outcome(
            name,
            summary_line(experiment),
            _command(name, experiment, settings),
            folder,
            time.perf_counter() - begin,
            summary,
            said.getvalue(),
            error,
        )


def _command(name: str, experiment: Any, settings: Mapping[str, Any]) -> str:
    """The settings that are not the defaults, as options."""
    app = typer.Typer(add_completion=False)
    app.command()(experiment.run)
    words = ["python -m experiments", name]
    for option in typer.main.get_command(app).params:
        value = settings.get(str(option.name), option.default)
        if option.name != "out" and value != option.default:
            words += _words(option, value)
    return " ".join(words)


def _words(option: Any, value: Any) -> list[str]:
    """A setting as the command line takes it: a place, a flag or an option."""
    if option.param_type_name == "argument":
        return [str(value)]
    if isinstance(value, bool):
        return [(option.opts if value else option.secondary_opts)[0]]
    several = value if isinstance(value, list) else [value]
    return [f"{option.opts[0]} {each}" for each in several]


def _summary(folder: Path) -> Mapping[str, Any] | None:
    """The summary that an experiment wrote, if all its pictures are there."""
    path = folder / SUMMARY
    if not path.exists():
        return None
    found: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    for entry in found["page"]:
        if "figure" in entry and not (folder / entry["figure"]).exists():
            raise FileNotFoundError(f"the page names {entry['figure']}, which was not written")
    return found


class _Tee(io.StringIO):
    """Prints, and keeps what was printed."""

    def __init__(self) -> None:
        super().__init__()
        self._out = sys.stdout

    def write(self, text: str) -> int:
        self._out.write(text)
        return super().write(text)
