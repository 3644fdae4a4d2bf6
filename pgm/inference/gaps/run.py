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
from pgm.schedules.impossible import ALLOW, ImpossibleEvidence
from pgm.schedules.options import Call


def run(
    family: BeliefFamily[Any], graph: ClusterGraph, evidence: Evidence, call: Call
) -> tuple[Outcome[Any], Entered]:
    """The beliefs of a network without time, and its evidence."""
    answered = not family.by_pattern
    try:
        outcome = family.infer_static(graph, evidence, call)
    except (Incomplete, Contradiction, ImpossibleEvidence) as error:
        allowed = isinstance(error, Incomplete) or call.impossible == ALLOW
        if answered or not allowed:
            raise
        outcome, answered = None, True
    if outcome is None:
        outcome = by_pattern(family, graph, Cells.of(evidence, graph.network.lead), call)
    return outcome, Entered(family, graph, kept(evidence), call, answered)
