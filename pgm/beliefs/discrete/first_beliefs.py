"""Beliefs of the first question that is asked of a graph, answered without a plan.

A *question* is one inference with its evidence. A *plan* lays tables and messages out once for many
questions; `first_question` answers the first question without a plan, by marginals and the
log-evidence. Joints, messages and beliefs of clusters are computed with a plan, on request.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.beliefs.discrete.first_question import Answer, answer
from pgm.beliefs.discrete.storage import Storage
from pgm.beliefs.discrete.tree_beliefs import TreeBeliefs
from pgm.clustergraph import ClusterGraph
from pgm.evidence.static import BoundStates
from pgm.kernels.arrays import Array
from pgm.schedules.limits import Room, require_size
from pgm.variables import Discrete


@dataclass(frozen=True, eq=False)
class FirstBeliefs:
    """Beliefs of one run, from a graph's first question.

    Marginals and ln p(evidence) are computed at once. Joints, messages and beliefs of clusters are
    read from tables that a plan lays out and calibrates when the first of these is asked for.

    _room: How many table entries that plan may compute at once, and keep.
    _answer: The marginals and ln p(evidence).
    """

    graph: ClusterGraph
    evidence: BoundStates
    _room: Room
    _answer: Answer

    @classmethod
    def of(cls, graph: ClusterGraph, evidence: BoundStates, room: Room) -> FirstBeliefs | None:
        """The beliefs of a graph without loops, if this is the graph's first question; else None.

        The evidence must have no axes of runs. None is also returned if a number underflows or the
        evidence has probability zero. The caller then makes a plan, which calibrates with
        logarithms, or finds out which evidence contradicts itself. `room` limits the memory of the
        plan that is made later if a joint, message or belief is asked for. Tables that are too
        large raise `GraphError`.
        """
        if not _first(graph):
            return None
        require_size(graph, graph.sizes, "tables")
        found = answer(graph, evidence)
        return None if found is None else cls(graph, evidence, room, found)

    def marginal(self, variable: Discrete) -> Array:
        """The marginal of a variable given the evidence, (states,)."""
        return self._answer.marginals[variable]

    def log_evidence(self) -> Array:
        """The value ln p(evidence), ()."""
        return np.asarray(self._answer.log_evidence)

    @cached_property
    def _planned(self) -> TreeBeliefs:
        """The beliefs of all clusters by a plan, made when one of its tables is first asked for."""
        return TreeBeliefs.of(self.graph, self.evidence, self._room)

    @property
    def storage(self) -> Storage:
        """Where each cluster's table stands in the flat array of the plan's calibrated tables."""
        return self._planned.storage

    def read(self, reader: Callable[[Array], Array]) -> Array:
        """The result of `reader`, called with the calibrated tables in one flat array.

        The array is (entries of clusters + entries of sepsets,), in which
        ``storage.table(array, cluster)`` is the table of a cluster.
        """
        return self._planned.read(reader)

    def log_total(self, cluster: int) -> Array:
        """The value ln p(evidence in the tree that has `cluster`), ()."""
        return self._planned.log_total(cluster)

    def message(self, source: int, target: int) -> tuple[Array, Array]:
        """The message from one cluster to a neighbour: its values, and their log-scale, (1,).

        The message is the values, (sizes of the sepset..., 1), times exp(log-scale). The axis of
        length one is that of runs.
        """
        return self._planned.message(source, target)


def _first(graph: ClusterGraph) -> bool:
    """Whether a graph has had no question and no plan so far; the graph is then marked as asked.

    A later call thus returns False.
    """
    if graph._derived:
        return False
    graph.derived(_asked)
    return True


def _asked(graph: ClusterGraph) -> bool:
    """The constant True, which a graph keeps to tell that it has had its first question.

    ``graph.derived(_asked)`` calls this function once, and keeps the result with the graph, as it
    keeps plans.
    """
    return True
