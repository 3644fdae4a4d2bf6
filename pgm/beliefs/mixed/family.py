"""Mixtures of Gaussians and tables, as a family of beliefs: the only one of mixed networks."""

from __future__ import annotations

from typing import Any, ClassVar

from pgm.beliefs.mixed.run import run
from pgm.beliefs.own.family import BeliefFamily
from pgm.clustergraph import ClusterGraph
from pgm.errors import GraphError
from pgm.evidence import Evidence
from pgm.posteriors.outcome import Outcome
from pgm.schedules.options import Call
from pgm.schedules.schedule import Loopy


class Mixed(BeliefFamily[Any]):
    """Tables of discrete variables, and mixtures over their configurations of continuous ones."""

    takes: ClassVar[frozenset[str]] = frozenset({"lineariser", "start", "iterations", "damping"})
    beliefs: ClassVar[str] = "mixtures of a mixed network"
    spare: ClassVar[str] = "is not for networks of discrete and continuous variables"
    by_pattern: ClassVar[bool] = True

    def infer_static(self, graph: ClusterGraph, evidence: Evidence, call: Call) -> Outcome[Any]:
        """The tables and mixtures of a network without time."""
        if isinstance(call.schedule, Loopy):
            raise GraphError(
                f"{call.schedule!r} sends messages round loops, and a mixed network is summed "
                "over its configurations: leave the schedule out, or give pgm.Calibration(...)"
            )
        return run(graph, evidence, call)


MIXED = Mixed()
