"""A problem of the inference competitions, answered as they ask for it."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Annotated

import typer

import pgm
from experiments.record import note
from pgm import results
from pgm.io.networks.uai_writers import TASKS


def uai(
    file: Annotated[Path, typer.Argument(help="The network, of type BAYES or MARKOV.")],
    task: Annotated[str, typer.Option(help="PR, MAR, MAP or MMAP.")] = "MAR",
    evidence: Annotated[
        Path | None, typer.Option(help="The evidence; FILE.evid, where there is one.")
    ] = None,
    query: Annotated[
        Path | None, typer.Option(help="What MMAP asks for; FILE.query, if not given.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Where it goes; printed, if not.")] = None,
) -> None:
    """Answer a problem in a UAI file exactly, by a junction tree."""
    if task not in TASKS:
        raise typer.BadParameter(f"the task is one of {', '.join(TASKS)}, not {task!r}")
    wanted = query or file.with_name(f"{file.name}.query")
    if task == "MMAP" and not wanted.exists():
        raise typer.BadParameter(f"no question in {wanted}; name its file, --query FILE")
    network = pgm.read_uai(file)
    beside = file.with_name(f"{file.name}.evid")
    given = evidence or (beside if beside.exists() else None)
    read = pgm.read_uai_evidence(given, network) if given else {}
    known: dict[pgm.Variable, int] = dict(read.items())
    graph = pgm.compile(network)
    answer: results.MostProbable | results.Posterior
    if task == "MAP":
        answer = pgm.most_probable(graph, known)
    elif task == "MMAP":
        asked = pgm.read_uai_query(wanted, network)
        answer = pgm.most_probable(graph, known, variables=asked)
        if not answer.exact:
            typer.echo(
                f"the search was given up: ln p is {answer.log_probability:.6g} of this, and at "
                f"most {answer.bound:.6g}",
                err=True,
            )
    else:
        answer = pgm.infer(graph, known)
    text = io.StringIO()
    pgm.write_uai_result(task, answer, network, text)
    if out is None:
        note(text.getvalue().rstrip())
    else:
        out.write_text(text.getvalue())
