"""Schedules on graphs of any shape: messages are sent until none changes.

Messages are numbered: 2e goes along edge e of the graph's sepsets, from the lower cluster to the
higher, and 2e + 1 back. A family of messages, tables or square roots, computes and keeps them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.inference.schedule import Flooding, Loopy, Residual, Sequential, Status
from pgm.kernels.arrays import Array, Integers, Mask

Round = TypeVar("Round")


@dataclass(frozen=True, eq=False)
class Directed:
    """The messages of a cluster graph: two for each sepset.

    Attributes
    ----------
    source, target : ndarray of int
        (messages,): the clusters between which each goes.
    clusters : int
        Number of clusters.
    """

    source: Integers
    target: Integers
    clusters: int

    @classmethod
    def of(cls, graph: ClusterGraph) -> Directed:
        """Number the messages of a graph."""
        edges = np.array(list(graph.sepsets), dtype=np.intp).reshape(-1, 2)
        return cls(edges.ravel(), edges[:, ::-1].ravel(), len(graph))

    def __len__(self) -> int:
        return self.source.size

    @cached_property
    def outgoing(self) -> list[list[int]]:
        """The messages that each cluster sends."""
        found: list[list[int]] = [[] for _ in range(self.clusters)]
        for message, source in enumerate(self.source.tolist()):
            found[source].append(message)
        return found

    def inputs(self, message: int) -> list[int]:
        """The messages that one is made of: those to its source, but not from its target."""
        return [other ^ 1 for other in self.outgoing[self.source[message]] if other != message]

    def dependents(self, message: int) -> list[int]:
        """The messages that one has a part in."""
        return [other for other in self.outgoing[self.target[message]] if other != message ^ 1]


class Messages(Protocol[Round]):
    """A family of messages: how they are computed, kept and compared."""

    @property
    def directed(self) -> Directed:
        """Their numbers."""
        ...

    @property
    def runs(self) -> int:
        """Number of runs."""
        ...

    def round(self, messages: Sequence[int]) -> Round:
        """Lay out the computation of some messages, in batches of one shape."""
        ...

    def propose(self, round: Round) -> Array:
        """Compute them from the messages kept; how much each would change, (messages, runs)."""
        ...

    def accept(self, round: Round, active: Mask) -> None:
        """Keep what was proposed, damped, for the runs that are active, (runs,)."""
        ...

    def relinearise(self, active: Mask) -> Array | None:
        """Linearise nonlinear CPDs at the beliefs: how far means moved, (runs,), in deviations.

        None where there is nothing to linearise.
        """
        ...
