"""`python -m experiments` lists the experiments; with a name it runs one."""

from __future__ import annotations

import inspect
from types import ModuleType

import matplotlib as mpl
import typer

from experiments.catalogue import EXPERIMENTS
from experiments.record import note
from pgm import PgmError

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


def summary_line(experiment: ModuleType) -> str:
    """The first line of an experiment's docstring."""
    return (inspect.getdoc(experiment.run) or "").splitlines()[0]


@app.callback(invoke_without_command=True)
def listing(context: typer.Context) -> None:
    """Experiments with filters, smoothers and linearisers."""
    mpl.use("Agg")
    if context.invoked_subcommand is None:
        for name, experiment in EXPERIMENTS.items():
            note(f"{name:<19} {summary_line(experiment)}")


for _name, _experiment in EXPERIMENTS.items():
    app.command(_name, help=summary_line(_experiment))(_experiment.run)


def main() -> None:
    """Run the command line; an error of pgm's is told in a line."""
    try:
        app()
    except PgmError as error:
        note(f"{type(error).__name__}: {error}", style="red")
        raise SystemExit(1) from error


if __name__ == "__main__":
    main()
