"""Cluster graphs of dynamic networks: compiled once as a template, whatever the number of steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.checks import Edge
from pgm.compile.layout import SliceLayout
from pgm.compile.machine import Compiled
from pgm.display import InCode
from pgm.errors import GraphError
from pgm.factors.scope import Scope
from pgm.networks import DynamicBayesianNetwork


class DynamicGraph(ClusterGraph, ABC):
    """A tree of clusters of a dynamic network, whose clusters 0..T hold its CPDs.

    Cluster 0 holds the states at step 0, the prior and the families of the sensors; cluster t
    holds the states of steps t−1 and t and the other variables of the CPDs at t. What else there
    is, and what is joined, is for the kinds of graphs to say. Clusters and sepsets are views,
    made on request from one template.
    """

    model: DynamicBayesianNetwork
    steps: int
    layout: SliceLayout

    def __init__(
        self, model: DynamicBayesianNetwork, steps: int, compiled: Compiled | None = None
    ) -> None:
        self._set(model=model, steps=steps, layout=SliceLayout(model, compiled))

    # A graph of slices is no graph of a network without time, whatever else it has in common.
    @property
    def network(self) -> DynamicBayesianNetwork:  # type: ignore[override]
        """The model, as `model`."""
        return self.model

    @property
    def clusters(self) -> Sequence[Cluster]:
        """The clusters, by index."""
        return _Clusters(self)

    @property
    def sepsets(self) -> Mapping[Edge, Scope]:
        """The states that each pair of joined clusters, lower index first, agrees about."""
        return _Sepsets(self)

    def neighbours(self, cluster: int | Cluster) -> tuple[int, ...]:
        """The clusters joined to one: their indices, in order; as of `ClusterGraph`."""
        return self._joined(self.index(cluster))

    @property
    def is_tree(self) -> bool:
        """Whether it has no loops: it has none."""
        return True

    @property
    def width(self) -> int:
        """The largest number of variables in a cluster, less one."""
        return max(len(cluster.scope) for cluster, _ in self._alike) - 1

    def _view(self, index: int) -> Cluster:
        cpds = self.model.cpds_at(index)
        families = tuple(tuple(v.at(index) for v in cpd.scope) for cpd in cpds)
        hidden = self.layout.pair if index else self.layout.states
        scope = dict.fromkeys(v.at(index) for v in hidden)
        scope |= dict.fromkeys(v for family in families for v in family)
        return Cluster(index, tuple(scope), cpds, families)

    def states_at(self, *steps: int) -> Scope:
        """All states at some steps, as a tuple of variables ``x.at(step)``."""
        return tuple(state.at(step) for step in steps for state in self.layout.states)

    @abstractmethod
    def within(self, steps: int) -> Sequence[int]:
        """The indices of the clusters whose variables are at the steps 0..steps."""

    @property
    @abstractmethod
    def _count(self) -> int:
        """The number of clusters."""

    @abstractmethod
    def _joined(self, index: int) -> tuple[int, ...]:
        """The neighbours of a cluster, in order."""

    @abstractmethod
    def _sepset(self, i: int, j: int) -> Scope:
        """Between two clusters that are joined, lower index first."""

    def families(self) -> Iterator[Scope]:
        """Of the prior at step 0, the transition at 1..T, the sensors where their parents are."""
        model = self.model
        for step in range(self.steps + 1):
            for cpd in (*(model.transition if step else model.prior), *model.observation):
                if step or not set(cpd.parents) & set(model.controls):
                    yield tuple(variable.at(step) for variable in cpd.scope)


class _Clusters(InCode, Sequence[Cluster]):
    def __init__(self, graph: DynamicGraph) -> None:
        self._graph = graph

    def __len__(self) -> int:
        return self._graph._count

    def __getitem__(self, index: Any) -> Any:
        found = range(len(self))[index]
        if isinstance(found, range):
            return tuple(map(self._graph._view, found))
        return self._graph._view(found)

    def __repr__(self) -> str:
        return f"<clusters 0..{len(self) - 1}>"


class _Sepsets(InCode, Mapping[Edge, Scope]):
    def __init__(self, graph: DynamicGraph) -> None:
        self._graph = graph

    def __repr__(self) -> str:
        return f"<{len(self)} sepsets between clusters 0..{len(self)}>"

    def __len__(self) -> int:
        return self._graph._count - 1

    def __iter__(self) -> Iterator[Edge]:
        joined = self._graph._joined
        return ((i, j) for i in range(self._graph._count) for j in joined(i) if i < j)

    def __contains__(self, edge: object) -> bool:
        if not isinstance(edge, tuple) or len(edge) != 2 or edge[0] not in range(len(self) + 1):
            return False
        return edge[1] in self._graph._joined(int(edge[0]))

    def get(self, edge: Edge, default: Any = None) -> Any:
        try:
            return self[edge]
        except GraphError:
            return default

    def __getitem__(self, edge: Edge) -> Scope:
        if edge not in self:
            raise GraphError(
                f"clusters {edge[0]} and {edge[1]} are not joined; graph.neighbours(cluster) tells "
                f"which are, of 0..{len(self)}",
                cluster=edge[0],
            )
        return self._graph._sepset(min(edge), max(edge))


class SliceGraph(DynamicGraph):
    """The chain of clusters 0..T of a dynamic network; see `DynamicGraph`.

    The sepset between t and t+1 is all states at t.
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
        yield self._view(0), 1
        if self.steps:
            yield self._view(1), self.steps

    @property
    def _title(self) -> str:
        return f"SliceGraph(clusters 0..{self.steps}, sepsets of {list(self.model.states)})"
