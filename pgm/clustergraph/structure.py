"""Cluster graphs as structure: what a schedule sends messages on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import networkx as nx
import numpy as np

from pgm.clustergraph.checks import Edge, check_families, check_running_intersection
from pgm.cpds import CPD
from pgm.errors import GraphError
from pgm.factors.scope import Scope, dimension, names


@dataclass(frozen=True, eq=False)
class Cluster:
    """A set of variables, with the CPDs whose product is its potential.

    Attributes
    ----------
    index : int
    scope : tuple of Variable
    cpds : tuple of CPD
    families : tuple of tuple of Variable
        The family of each CPD, child first, all inside the scope.
    """

    index: int
    scope: Scope
    cpds: tuple[CPD, ...]
    families: tuple[Scope, ...]

    @property
    def size(self) -> int:
        """Number of components of its variables."""
        return dimension(self.scope)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Cluster) and (self.index, self.scope, self.cpds) == (
            other.index,
            other.scope,
            other.cpds,
        )

    def __hash__(self) -> int:
        return hash((self.index, self.scope))

    def __repr__(self) -> str:
        return f"Cluster({self.index}: {names(self.scope)})"


class ClusterGraph(ABC):
    """An undirected graph of clusters; its edges are labelled with sepsets.

    Structure alone: it holds no evidence, message or belief.
    """

    @property
    @abstractmethod
    def clusters(self) -> Sequence[Cluster]:
        """The clusters, by index."""

    @property
    @abstractmethod
    def sepsets(self) -> Mapping[Edge, Scope]:
        """The variables that each pair of joined clusters, lower index first, agrees about."""

    def neighbours(self, index: int) -> tuple[int, ...]:
        """The clusters joined to one."""
        return tuple(i + j - index for i, j in self.sepsets if index in (i, j))

    def index(self, cluster: int | Cluster) -> int:
        """The index of a cluster, given by index or value."""
        found = cluster.index if isinstance(cluster, Cluster) else cluster
        if not isinstance(found, int | np.integer) or not 0 <= found < len(self.clusters):
            raise GraphError(
                f"there is no cluster {cluster!r}; clusters are 0..{len(self.clusters) - 1}",
                cluster=cluster,
            )
        return int(found)

    @abstractmethod
    def families(self) -> Iterable[Scope]:
        """The families of all CPDs of the network, each of which needs a cluster."""

    def check(self) -> None:
        """Prove family preservation and running intersection.

        Raises
        ------
        GraphError
            Naming the variable and the clusters concerned.
        """
        clusters = list(self.clusters)
        scopes = [cluster.scope for cluster in clusters]
        check_families(scopes, [cluster.families for cluster in clusters], self.families())
        check_running_intersection(scopes, self.sepsets)

    def to_networkx(self) -> nx.Graph:
        """Nodes are indices with the attribute ``cluster``; edges have ``sepset``."""
        graph = nx.Graph()
        graph.add_nodes_from((cluster.index, {"cluster": cluster}) for cluster in self.clusters)
        graph.add_edges_from((i, j, {"sepset": scope}) for (i, j), scope in self.sepsets.items())
        return graph

    def __iter__(self) -> Iterator[Cluster]:
        return iter(self.clusters)

    def __len__(self) -> int:
        return len(self.clusters)
