"""Inference in a network without time, whatever cells of its variables were observed.

A family of beliefs solves a network for runs in which the same variables are observed, and leaves
out components that were not of variables on which no other depends. Where it finds evidence
`Incomplete`, or some of it impossible and the call allows that, runs are solved pattern by pattern.
"""

from __future__ import annotations

from typing import Any

from pgm.beliefs.gaussian.refusals import Contradiction
from pgm.beliefs.own.family import BeliefFamily
from pgm.clustergraph import ClusterGraph
from pgm.evidence import Evidence
from pgm.evidence.cells import Cells
from pgm.evidence.static import Incomplete
from pgm.inference.gaps.by_pattern import by_pattern
from pgm.inference.gaps.entered import Entered, kept
from pgm.posteriors.outcome import Outcome
from pgm.schedules.impossible import OF_RUNS, ImpossibleEvidence, allows
from pgm.schedules.options import Call


def run(
    family: BeliefFamily[Any], graph: ClusterGraph, evidence: Evidence, call: Call
) -> tuple[Outcome[Any], Entered]:
    """The beliefs of a network without time, and its evidence."""
    if not family.by_pattern:
        outcome, answered = family.infer_static(graph, evidence, call), True
    else:
        try:
            outcome, answered = _answer(family, graph, evidence, call)
        except (Contradiction, ImpossibleEvidence) as error:
            if error.run is not None and not allows(call.impossible):
                error.args = (f"{error}{OF_RUNS}",)
            raise
    return outcome, Entered(family, graph, kept(evidence), call, answered)


def _answer(
    family: BeliefFamily[Any], graph: ClusterGraph, evidence: Evidence, call: Call
) -> tuple[Outcome[Any], bool]:
    """The beliefs, and whether they are those of all gaps."""
    allow = allows(call.impossible)
    try:
        return family.infer_static(graph, evidence, call), False
    except (Incomplete, Contradiction, ImpossibleEvidence) as error:
        if not (allow or isinstance(error, Incomplete)):
            raise
    cells = Cells.of(evidence, graph.network.lead)
    return by_pattern(family, graph, cells, call), True
