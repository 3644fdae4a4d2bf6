"""`python -m experiments list`, or no word, lists the experiments; a name runs one of them."""

from __future__ import annotations

import io
import os
import sys
from importlib.util import find_spec

if not (find_spec("typer") and find_spec("rich")):  # told in a line, before they are imported
    sys.exit("the experiments need typer and rich: pip install '.[experiments]', or make demo")

import matplotlib as mpl
import typer

from experiments.catalogue import EXPERIMENTS, listing, summary_line
from experiments.record import note, refusal
from experiments.report import report
from experiments.studies.command import command
from experiments.uai import uai

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.callback(invoke_without_command=True)
def begin(context: typer.Context) -> None:
    """Experiments with filters, smoothers and linearisers."""
    mpl.use("Agg")
    if context.invoked_subcommand is None:
        show()


@app.command("list")
def show() -> None:
    """List the experiments by theme, and the data that some of them need."""
    for line in listing():
        note(line)


for _name, _experiment in EXPERIMENTS.items():
    app.command(_name, help=summary_line(_experiment))(_experiment.run)
app.command("report")(report)
app.command("sweep")(command(EXPERIMENTS))
app.command("uai")(uai)


def main() -> None:
    """Run the command line; a refusal, pgm's or of the machine, is told in a line."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # of letters that a terminal does not have
    try:
        app()
        sys.stdout.flush()
    except Exception as error:
        told = refusal(error)
        if not told:
            raise
        _tell(told)
        raise SystemExit(1) from error


def _tell(told: str) -> None:
    """Print a refusal, elsewhere where it is the standard output that cannot be written."""
    try:
        note(told, style="red")
        sys.stdout.flush()
    except OSError:
        sys.stderr.write(f"{told}\n")
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left to flush


if __name__ == "__main__":
    main()
