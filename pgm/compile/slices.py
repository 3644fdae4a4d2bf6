"""The chain of slices of a dynamic network: one cluster a step."""

from __future__ import annotations

from collections.abc import Iterator

from pgm.clustergraph import Cluster
from pgm.compile.dynamic import DynamicGraph
from pgm.factors.scope import Scope


class SliceGraph(DynamicGraph):
    """The chain of clusters 0..T of a dynamic network.

    Cluster 0 holds the states at step 0, the prior and the families of the sensors; cluster t
    holds the states of steps t−1 and t and the other variables of the CPDs at t. The sepset
    between t and t+1 is all states at t. Clusters are views, made on request from one template.

    Attributes
    ----------
    model : DynamicBayesianNetwork
    steps : int
        T, the last step.
    """

    def within(self, steps: int) -> range:
        """The clusters 0..steps."""
        return range(min(steps, self.steps) + 1)

    @property
    def _count(self) -> int:
        return self.steps + 1

    def _joined(self, index: int) -> tuple[int, ...]:
        return tuple(k for k in (index - 1, index + 1) if 0 <= k <= self.steps)

    def _sepset(self, i: int, j: int) -> Scope:
        return self.states_at(i)

    @property
    def _alike(self) -> Iterator[tuple[Cluster, int]]:
        yield self.cluster(0), 1
        if self.steps:
            yield self.cluster(1), self.steps

    def __repr__(self) -> str:
        return f"SliceGraph(clusters 0..{self.steps}, sepsets of {list(self.model.states)})"
