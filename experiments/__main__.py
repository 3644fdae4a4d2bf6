"""`python -m experiments` lists the experiments; with a name it runs one."""

from __future__ import annotations

import matplotlib as mpl
import typer

from experiments.catalogue import EXPERIMENTS, summary_line
from experiments.record import FolderError, note
from experiments.report import report
from pgm import PgmError

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.callback(invoke_without_command=True)
def listing(context: typer.Context) -> None:
    """Experiments with filters, smoothers and linearisers."""
    mpl.use("Agg")
    if context.invoked_subcommand is None:
        width = max(map(len, EXPERIMENTS))
        for name, experiment in EXPERIMENTS.items():
            note(f"{name:<{width}}  {summary_line(experiment)}")


for _name, _experiment in EXPERIMENTS.items():
    app.command(_name, help=summary_line(_experiment))(_experiment.run)
app.command("report")(report)


def main() -> None:
    """Run the command line; a refusal, pgm's or of the folder, is told in a line."""
    try:
        app()
    except (PgmError, FolderError) as error:
        note(f"{type(error).__name__}: {error}", style="red")
        raise SystemExit(1) from error


if __name__ == "__main__":
    main()
