"""Cluster graphs of dynamic networks: one template a step, for any number of steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.cluster import Edge
from pgm.compile.machine import Choice, Compilation
from pgm.cpds import CPD, AffineCPD, NonlinearGaussianCPD
from pgm.display import InCode
from pgm.errors import GraphError
from pgm.factors.scope import Scope, dimension, positions
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Index, Integers
from pgm.linearisers import FunctionTemplate
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable


class Place(NamedTuple):
    """The place of a CPD in the vector of a scope, of the parents that no evidence gives.

    `angles` are those of the child, and `before` where those of the step before stand; empty where
    the child does not depend on itself. A measurement's `child` is empty. `singular` says whether
    the CPD's noise is; None where that depends on evidence.
    """

    hidden: Scope
    parents: Index
    child: slice
    angles: Integers
    before: Integers
    template: FunctionTemplate | None
    singular: bool | None


@dataclass(frozen=True, eq=False)
class SliceLayout:
    """The vectors of a dynamic network's slice.

    A *slice* stacks the hidden variables of one step, states and controls, parents before
    children. A *pair* stacks the states of the step before, then the slice: the hidden scope of
    a cluster.
    """

    model: DynamicBayesianNetwork
    compiled: Choice = None

    @classmethod
    def of(cls, model: DynamicBayesianNetwork, compiled: Choice = None) -> SliceLayout:
        """The layout of a network, one for all graphs with the same choice of machine code."""
        found: SliceLayout | None = model.layouts.get(compiled)
        if found is None:
            found = cls(model, compiled)
            model.layouts[compiled] = found
        return found

    @cached_property
    def slice(self) -> Scope:
        """The hidden variables of a step, in the order of the slice vector."""
        return tuple(cpd.child for cpd in self.model.transition)

    @cached_property
    def states(self) -> Scope:
        """The states, in the order of the slice vector."""
        return self.model.states

    @cached_property
    def pair(self) -> Scope:
        """The states of the step before, then the slice."""
        return (*(state.previous for state in self.states), *self.slice)

    @cached_property
    def places(self) -> dict[Variable, Index]:
        """The place of each hidden variable in the slice vector."""
        return {variable: positions(self.slice, [variable]) for variable in self.slice}

    @cached_property
    def state_size(self) -> int:
        """Components of the states."""
        return dimension(self.states)

    @cached_property
    def slice_size(self) -> int:
        """Components of the slice."""
        return dimension(self.slice)

    @cached_property
    def state_places(self) -> Index:
        """The places of the states in the slice vector: all of it, where there are no controls."""
        return positions(self.slice, self.states)

    @cached_property
    def control_places(self) -> Integers:
        """The places of the controls in the slice vector."""
        everywhere = np.arange(self.slice_size)
        return np.setdiff1d(everywhere, everywhere[self.state_places])

    @cached_property
    def single(self) -> bool:
        """Whether one CPD makes the whole slice of the whole slice before."""
        return len(self.slice) == 1 and self.hidden(self.model.transition[0]) == self.pair[:1]

    @cached_property
    def probed(self) -> set[CPD]:
        """The CPDs whose functions have been called on trial."""
        return set()

    @cached_property
    def told(self) -> dict[Any, Any]:
        """Sweeps in machine code of the forms of plans that there were, with their tables."""
        return {}

    @cached_property
    def looked_at(self) -> set[tuple[Any, ...]]:
        """The rules and kinds of beliefs whose linearisations were looked at, for a warning."""
        return set()

    @cached_property
    def plans(self) -> list[Any]:
        """Plans without evidence, of the forms of evidence that there were last."""
        return []

    @cached_property
    def prior_means(self) -> dict[Variable, Array]:
        """The means of the states of affine priors, of the first run, (d,)."""
        return {
            cpd.child: cpd.offset.reshape(-1, cpd.child.dimension)[0]
            for cpd in self.model.prior
            if isinstance(cpd, AffineCPD)
        }

    @cached_property
    def begun(self) -> list[tuple[Array, Array]]:
        """The belief that machine code begins with, once it is found, where none has evidence."""
        return []

    def __getstate__(self) -> dict[str, Any]:
        return {"model": self.model, "compiled": self.compiled}

    @cached_property
    def _places(self) -> dict[tuple[CPD, Scope], Place]:
        return {}

    def place(self, cpd: CPD, scope: Scope) -> Place:
        """The place of a CPD in the vector of the scope that it belongs to, found once."""
        found = self._places.get((cpd, scope))
        if found is None:
            found = self._places[cpd, scope] = self._find(cpd, scope)
        return found

    def _find(self, cpd: CPD, scope: Scope) -> Place:
        hidden = self.hidden(cpd)
        child, angles = slice(0, 0), np.flatnonzero(cpd.child.angle_mask)
        if cpd.child in scope:
            place = positions(scope, [cpd.child])
            assert isinstance(place, slice)
            child = place
        before = angles[:0]
        if cpd.child.previous in hidden:
            before = np.arange(dimension(scope))[positions(scope, [cpd.child.previous])][angles]
        return Place(
            hidden,
            positions(scope, hidden),
            child,
            angles[: before.size],
            before,
            cpd._template(hidden) if isinstance(cpd, NonlinearGaussianCPD) else None,
            _is_singular(cpd),
        )

    def hidden(self, cpd: CPD) -> Scope:
        """The parents of a CPD's mean that no evidence gives, in the order of its function."""
        slice_ = set(self.slice)
        return tuple(parent for parent in cpd.given if parent.template in slice_)


def _is_singular(cpd: CPD) -> bool | None:
    """Whether a CPD's noise covariance is singular; None where it is not known beforehand."""
    cov = getattr(cpd, "cov", None)
    if not isinstance(cov, np.ndarray):
        return None
    return bool(roots.determined(roots.root(cov)).any())


class DynamicGraph(ClusterGraph, ABC):
    """A tree of clusters of a dynamic network, whose clusters 0..T hold its CPDs.

    Cluster 0 holds the states at step 0, the prior and the families of the sensors; cluster t
    holds the states of steps t−1 and t and the other variables of the CPDs at t. Clusters and
    sepsets are views, made on request from one template.
    """

    model: DynamicBayesianNetwork
    steps: int
    layout: SliceLayout

    def __init__(self, model: DynamicBayesianNetwork, steps: int, compiled: Choice = None) -> None:
        self._set(model=model, steps=steps, layout=SliceLayout.of(model, compiled))

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
        """For each cluster, its CPDs: the prior at step 0, the transition at 1..T, and sensors."""
        model = self.model
        for step in range(self.steps + 1):
            for cpd in (*(model.transition if step else model.prior), *model.observation):
                if step or (cpd.steps is None and not set(cpd.parents) & set(model.controls)):
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
    """The chain of clusters 0..T of a dynamic network, with all states at t between t and t+1."""

    @property
    def compilation(self) -> Compilation:
        """For each CPD, whether sweeps in machine code support it, or why not."""
        layout, model = self.layout, self.model
        scopes = [(model.prior, layout.states), (model.transition, layout.pair)]
        scopes.append((model.observation, layout.slice))
        places = {cpd: layout.place(cpd, scope) for cpds, scope in scopes for cpd in cpds}
        templates = {cpd: place.template for cpd, place in places.items()}
        return Compilation(self._title, templates, model.observation)

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
