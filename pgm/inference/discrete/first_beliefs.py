"""A graph's first question is answered directly; later questions are answered by a plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.evidence.static import BoundStates
from pgm.inference.discrete.first_question import Answer, answer
from pgm.inference.discrete.storage import Storage
from pgm.inference.discrete.tree_beliefs import TreeBeliefs
from pgm.inference.limits import Room, require_size
from pgm.kernels.arrays import Array
from pgm.variables import Discrete


@dataclass(frozen=True, eq=False)
class FirstBeliefs:
    """Beliefs of one run, from a graph's first question; other requests are passed to a plan.

    Marginals and log-evidence are there; joints, messages and beliefs of clusters are read from
    tables that are laid out and calibrated when the first of them is asked for.
    """

    graph: ClusterGraph
    evidence: BoundStates
    _room: Room
    _answer: Answer

    @classmethod
    def of(cls, graph: ClusterGraph, evidence: BoundStates, room: Room) -> FirstBeliefs | None:
        """Answer a graph's first question, of evidence without leading axes.

        None, if it is not the first; or where numbers do not do, or the evidence is impossible:
        then logarithms serve, or tell what contradicts what.
        """
        if not _first(graph):
            return None
        require_size(graph, graph.sizes, "tables")
        found = answer(graph, evidence)
        return None if found is None else cls(graph, evidence, room, found)

    def marginal(self, variable: Discrete) -> Array:
        """The probabilities of a variable, (states,)."""
        return self._answer.marginals[variable]

    def log_evidence(self) -> Array:
        """The value ln p(evidence), ()."""
        return np.asarray(self._answer.log_evidence)

    @cached_property
    def _planned(self) -> TreeBeliefs:
        """The calibrated tables of a plan, made when more than marginals is first asked for."""
        return TreeBeliefs.of(self.graph, self.evidence, self._room)

    @property
    def storage(self) -> Storage:
        """The layout of the tables that `read` is given."""
        return self._planned.storage

    def read(self, reader: Callable[[Array], Array]) -> Array:
        """The result of a function of the tables."""
        return self._planned.read(reader)

    def log_total(self, cluster: int) -> Array:
        """The logarithm of p(evidence) of a cluster's tree, ()."""
        return self._planned.log_total(cluster)

    def message(self, source: int, target: int) -> tuple[Array, Array]:
        """The message from one cluster to a neighbour, (sizes..., 1), and its log-scale."""
        return self._planned.message(source, target)


def _first(graph: ClusterGraph) -> bool:
    """Whether this is a graph's first question, and no plan exists; marks it as asked."""
    if graph._derived:
        return False
    graph.derived(_asked)
    return True


def _asked(graph: ClusterGraph) -> bool:
    """The mark that a graph was asked: `derived` keeps it."""
    return True
