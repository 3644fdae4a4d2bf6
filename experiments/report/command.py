"""The command `python -m experiments report`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from experiments.catalogue import EXPERIMENTS
from experiments.record import Seed, folder, note, versions, writing
from experiments.report.page import page, state
from experiments.report.running import Outcome, run_all
from pgm.io.sources import whole

Folder = Annotated[Path, typer.Option(help="Folder for the page and all results.")]
Only = Annotated[
    list[str] | None, typer.Option("--only", help="Run this experiment alone; may be repeated.")
]


def report(
    out: Folder = Path("results/report"),
    seed: Seed = 0,
    quick: Annotated[bool, typer.Option("--quick", help="Few runs, to see that all run.")] = False,
    only: Only = None,
) -> None:
    """Run every experiment, and write one page with all figures and tables."""
    for name in only or ():
        if name not in EXPERIMENTS:
            raise typer.BadParameter(
                f"there is no experiment {name!r}; there are {', '.join(EXPERIMENTS)}",
                param_hint="--only",
            )
    chosen = {name: e for name, e in EXPERIMENTS.items() if not only or name in only}
    outcomes = make_report(chosen, out, seed=seed, quick=quick)
    if any(outcome.error for outcome in outcomes):
        raise typer.Exit(1)


def make_report(
    experiments: Mapping[str, Any], out: Path, *, seed: int = 0, quick: bool = False
) -> list[Outcome]:
    """Run experiments below a folder, and write its index.html.

    Parameters
    ----------
    experiments : mapping of str to module
        With `run`, and `QUICK`, its quick settings.
    out : Path
    seed : int
        Of those that draw.
    quick : bool
        Whether to use the quick settings.

    Raises
    ------
    FolderError
        If nothing can be written into the folder.
    """
    begin = time.perf_counter()
    path = folder(out) / "index.html"
    outcomes: list[Outcome] = []
    for outcome in run_all(experiments, out, seed=seed, quick=quick):
        outcomes.append(outcome)
        if outcome.error:
            note(outcome.error, style="red")
        note(f"{outcome.name}: {outcome.seconds:.1f} s {state(outcome)}", style="bold")
    size = "quick settings" if quick else "full size"
    made = f"{datetime.now():%d %B %Y, %H:%M} · {size} · seed {seed} · {_took(begin)}"
    text = page(outcomes, versions(), made, quick)
    with writing(out), whole(path) as beside:
        beside.write_text(text, encoding="utf-8")
    note(str(path))
    return outcomes


def _took(begin: float) -> str:
    minutes, seconds = divmod(round(time.perf_counter() - begin), 60)
    return f"{minutes} min {seconds} s"
