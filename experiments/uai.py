"""A problem of the inference competitions, answered as they ask for it."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Annotated

import typer

import pgm
from experiments.record import note


def uai(
    file: Annotated[Path, typer.Argument(help="The network, of type BAYES or MARKOV.")],
    task: Annotated[str, typer.Option(help="PR, MAR or MAP.")] = "MAR",
    evidence: Annotated[
        Path | None, typer.Option(help="The evidence; FILE.evid, where there is one.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Where it goes; printed, if not.")] = None,
) -> None:
    """Answer a problem in a UAI file exactly, by a junction tree."""
    network = pgm.read_uai(file)
    beside = file.with_name(f"{file.name}.evid")
    given = evidence or (beside if beside.exists() else None)
    read = pgm.read_uai_evidence(given, network) if given else {}
    known: dict[pgm.Variable, int] = dict(read.items())
    graph = pgm.compile(network)
    answer = pgm.most_probable(graph, known) if task == "MAP" else pgm.infer(graph, known)
    text = io.StringIO()
    pgm.write_uai_result(task, answer, network, text, evidence=known)
    if out is None:
        note(text.getvalue().rstrip())
    else:
        out.write_text(text.getvalue())
