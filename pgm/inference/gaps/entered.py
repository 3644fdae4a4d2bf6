"""The evidence that a posterior was given, and the beliefs of its gaps."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pgm.beliefs.own.family import BeliefFamily
from pgm.clustergraph import ClusterGraph
from pgm.evidence import Evidence
from pgm.evidence.cells import Cells
from pgm.inference.gaps.by_pattern import by_pattern
from pgm.posteriors.outcome import Outcome
from pgm.schedules.options import Call
from pgm.variables import Variable


@dataclass(frozen=True, eq=False)
class Entered:
    """The evidence of a call on a network without time, as the user gave it.

    Attributes
    ----------
    family, graph, evidence, call
        As of the call; what could change in the evidence is copied.
    answered : bool
        Whether the call's outcome has the beliefs of all gaps. Else it has left out of the network
        the components that were not observed of variables on which no other depends, and these have
        the beliefs of `by_pattern`.
    """

    family: BeliefFamily[Any]
    graph: ClusterGraph
    evidence: Evidence
    call: Call
    answered: bool

    @cached_property
    def cells(self) -> Cells:
        """The evidence, checked, by run."""
        return Cells.of(self.evidence, self.graph.network.lead)

    def leaves_out(self, variable: object) -> bool:
        """Whether the outcome lacks a belief of a variable that was not observed in full."""
        if self.answered or variable not in self.evidence:
            return False
        return isinstance(variable, Variable) and self.cells.gaps(variable)

    @cached_property
    def left_out(self) -> bool:
        """Whether the outcome lacks the belief of some variable not observed in full."""
        return any(map(self.leaves_out, self.evidence))

    @cached_property
    def by_pattern(self) -> Outcome[Any]:
        """The beliefs of the same evidence, each pattern of gaps solved by itself."""
        return by_pattern(self.family, self.graph, self.cells, self.call._replace(tells=False))


def kept(evidence: Evidence) -> Mapping[Variable, Any]:
    """Evidence whose arrays and lists no user can change any more."""
    return {v: _kept(value) for v, value in evidence.items()}


def _kept(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.copy() if value.flags.writeable else value
    return value if isinstance(value, _FIXED) else copy.deepcopy(value)


_FIXED = (str, int, float, np.generic, type(None))
