"""The cluster graph of a dynamic network: one cluster a step, compiled once as a template."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.checks import Edge
from pgm.compile.layout import SliceLayout
from pgm.errors import GraphError
from pgm.factors.scope import Scope
from pgm.networks import DynamicBayesianNetwork


class SliceGraph(ClusterGraph):
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

    model: DynamicBayesianNetwork
    steps: int
    layout: SliceLayout

    def __init__(self, model: DynamicBayesianNetwork, steps: int) -> None:
        self._set(model=model, steps=steps, layout=SliceLayout(model))

    # A graph of slices is no graph of a network without time, whatever else it has in common.
    @property
    def network(self) -> DynamicBayesianNetwork:  # type: ignore[override]
        """The model, as `model`."""
        return self.model

    @property
    def clusters(self) -> Sequence[Cluster]:
        """Clusters 0..T."""
        return _Clusters(self)

    @property
    def sepsets(self) -> Mapping[Edge, Scope]:
        """The states at t, for each edge (t, t+1)."""
        return _Sepsets(self)

    def neighbours(self, cluster: int | Cluster) -> tuple[int, ...]:
        """The clusters of the steps before and after."""
        step = self.index(cluster)
        return tuple(k for k in (step - 1, step + 1) if 0 <= k <= self.steps)

    @property
    def _alike(self) -> Iterator[tuple[Cluster, int]]:
        yield self.cluster(0), 1
        if self.steps:
            yield self.cluster(1), self.steps

    def families(self) -> Iterator[Scope]:
        """Of the prior at step 0, the transition at 1..T, the sensors where their parents are."""
        model = self.model
        for step in range(self.steps + 1):
            for cpd in (*(model.transition if step else model.prior), *model.observation):
                if step or not set(cpd.parents) & set(model.controls):
                    yield tuple(variable.at(step) for variable in cpd.scope)

    def cluster(self, step: int) -> Cluster:
        """The cluster of a step."""
        cpds = self.model.cpds_at(step)
        families = tuple(tuple(v.at(step) for v in cpd.scope) for cpd in cpds)
        hidden = self.layout.pair if step else self.layout.states
        scope = dict.fromkeys(v.at(step) for v in hidden)
        scope |= dict.fromkeys(v for family in families for v in family)
        return Cluster(step, tuple(scope), cpds, families)

    def __repr__(self) -> str:
        return f"SliceGraph(clusters 0..{self.steps}, sepsets of {list(self.model.states)})"


class _Clusters(Sequence[Cluster]):
    def __init__(self, graph: SliceGraph) -> None:
        self._graph = graph

    def __len__(self) -> int:
        return self._graph.steps + 1

    def __getitem__(self, index: Any) -> Any:
        found = range(len(self))[index]
        if isinstance(found, range):
            return tuple(map(self._graph.cluster, found))
        return self._graph.cluster(found)

    def __repr__(self) -> str:
        return f"<clusters 0..{self._graph.steps}>"


class _Sepsets(Mapping[Edge, Scope]):
    def __init__(self, graph: SliceGraph) -> None:
        self._graph = graph

    def __len__(self) -> int:
        return self._graph.steps

    def __iter__(self) -> Iterator[Edge]:
        return ((step, step + 1) for step in range(self._graph.steps))

    def __contains__(self, edge: object) -> bool:
        steps = range(self._graph.steps)
        return any(edge in ((k, k + 1), (k + 1, k)) for k in _numbers(edge) if k in steps)

    def get(self, edge: Edge, default: Any = None) -> Any:
        try:
            return self[edge]
        except GraphError:
            return default

    def __getitem__(self, edge: Edge) -> Scope:
        first = min(edge)
        if edge not in self:
            raise GraphError(
                f"clusters {edge[0]} and {edge[1]} are not joined; an edge joins t and t+1, in "
                f"0..{len(self)}",
                cluster=edge[0],
            )
        return tuple(state.at(first) for state in self._graph.layout.states)


def _numbers(edge: object) -> tuple[Any, ...]:
    return edge if isinstance(edge, tuple) else ()
