"""`python -m experiments sweep`: a study of an experiment, begun or gone on with."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from time import monotonic
from types import ModuleType
from typing import Annotated, Any

import typer

from experiments.record import Record, Seed, note
from experiments.studies.errors import StudyError, require_packages
from experiments.studies.figures import CAPTION, SERIES, figure
from experiments.studies.settings import declared, words
from experiments.studies.study import PART_SIZE, Study
from experiments.studies.table import Table

# Seconds between lines of progress, where there is no terminal.
QUIET = 20.0


def command(experiments: dict[str, ModuleType]) -> Callable[..., None]:
    """The command, of the experiments that have a `sweep`."""
    sweeps: dict[str, Callable[..., Any]] = {
        name: module.sweep for name, module in experiments.items() if hasattr(module, "sweep")
    }

    def sweep(
        name: Annotated[str, typer.Argument(help="The experiment; a list of them without.")] = "",
        over: Annotated[
            list[str] | None, typer.Option(help="setting=value,value; as often as needed.")
        ] = None,
        runs: Annotated[int, typer.Option(min=1, help="Runs of each combination.")] = 10_000,
        seed: Seed = 0,
        part_size: Annotated[int, typer.Option(min=1, help="Runs of a part.")] = PART_SIZE,
        workers: Annotated[int, typer.Option(min=1, help="Processes on this machine.")] = 2,
        scheduler: Annotated[
            str | None, typer.Option(help="Address of a Dask scheduler, tcp://HOST:PORT.")
        ] = None,
        folder: Annotated[
            Path | None, typer.Option(help="Of the study; results/sweep_NAME without.")
        ] = None,
    ) -> None:
        """Run an experiment over a grid of settings, in parts that may be interrupted."""
        if not name:
            for line in listing(sweeps):
                note(line)
            return
        if name not in sweeps:
            raise StudyError(f"sweep {name}: the experiments to sweep are {', '.join(sweeps)}")
        require_packages()
        function = sweeps[name]
        grid = words(declared(function), over or [])
        study = Study(function, grid, runs=runs, seed=seed, part_size=part_size)
        place = folder or Path("results") / f"sweep_{name}"
        progress = True if sys.stderr.isatty() else Lines(note)
        try:
            study.run(place, scheduler=scheduler, workers=workers, progress=progress)
        except KeyboardInterrupt:
            note(f"stopped; the same command goes on from the parts in {place}")
            raise typer.Exit(130) from None
        leave(name, study.table(place), place)

    return sweep


def listing(sweeps: dict[str, Callable[..., Any]]) -> list[str]:
    """The experiments to sweep, and their settings."""
    lines = ["sweep NAME --over setting=value,value --runs N, of"]
    for name, function in sweeps.items():
        lines.append(f"  {name}")
        lines.extend(f"      {setting}" for setting in declared(function).values())
    return lines


def leave(name: str, table: Table, folder: Path) -> None:
    """Print the table, and write figure and summary into the study's folder."""
    study = table.study
    record = Record(
        f"sweep {name}",
        folder,
        over=study.over,
        **study.fixed,
        runs=study.runs,
        seed=study.seed,
        part_size=study.part_size,
    )
    without = sum(row.without for row in table.rows)
    record.table(
        f"{name}: {study.runs:,} runs of each setting",
        table.head(),
        table.cells(),
        about="Means over runs with their standard errors, and quantiles of a run."
        + (f" {without:,} figures of runs are undefined, and left out." if without else ""),
    )
    beyond = len(study.settings) > SERIES
    caption = CAPTION + (f" At most {SERIES} series are drawn." if beyond else "")
    record.figure(figure(table), "figures", caption)
    record.summary(rows=[row.numbers for row in table.rows])


class Lines:
    """Progress in lines: parts done, and an estimate of the rest.

    Parameters
    ----------
    tell : callable
        Takes a line.
    """

    def __init__(self, tell: Callable[[str], object]) -> None:
        self._tell = tell
        self._began = self._told = self._first = monotonic()

    def __call__(self, done: int, total: int) -> None:
        """Tell, unless it was told just before."""
        now = monotonic()
        if not done:
            self._began = self._told = now
            self._tell(f"{total:,} parts are missing")
            return
        if done == 1:
            self._first = now  # before it workers start, which says nothing of their speed
        if done == total:
            self._tell(f"{total:,} of {total:,} parts, {duration(now - self._began)}")
        elif done > 1 and now - self._told >= QUIET:
            self._told = now
            rest = (now - self._first) * (total - done) / (done - 1)
            self._tell(f"{done:,} of {total:,} parts, about {duration(rest)} left")


def duration(seconds: float) -> str:
    """A time in words."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
