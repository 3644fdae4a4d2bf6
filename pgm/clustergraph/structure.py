"""Cluster graphs as structure: what a schedule sends messages on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, TypeVar

import networkx as nx
import numpy as np

from pgm.clustergraph.assignment import assign, spanning_tree
from pgm.clustergraph.checks import Edge, check_families, check_running_intersection
from pgm.cpds import CPD
from pgm.errors import GraphError
from pgm.factors.scope import Scope, as_scope, dimension, names
from pgm.immutable import Immutable
from pgm.networks import BayesianNetwork
from pgm.variables import Variable

T = TypeVar("T")


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
        """Components of its continuous variables, or entries of its discrete ones' table."""
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


class ClusterGraph(Immutable):
    """An undirected graph of clusters; its edges are labelled with sepsets.

    Structure alone: it holds no evidence, message or belief. Made by `compile`, or by hand from
    sets of variables. Each CPD goes to the smallest cluster that holds its family.

    Parameters
    ----------
    network : BayesianNetwork
    clusters : sequence of sets of Variable
    sepsets : mapping of (int, int) to set of Variable, optional
        Of each pair of joined clusters. Without, a spanning tree whose sepsets are the full
        intersections, of maximum total size.

    Raises
    ------
    GraphError
        If a family is in no cluster (family preservation), or a variable's clusters and the
        sepsets that carry it form no tree (running intersection), naming variable and clusters.

    Examples
    --------
    >>> graph = ClusterGraph(net, [{a, b}, {b, c}, {c, a}],
    ...                      sepsets={(0, 1): {b}, (1, 2): {c}})  # doctest: +SKIP
    """

    network: BayesianNetwork
    _clusters: tuple[Cluster, ...]
    _sepsets: Mapping[Edge, Scope]

    def __init__(
        self,
        network: BayesianNetwork,
        clusters: Iterable[Iterable[Variable]],
        sepsets: Mapping[Edge, Iterable[Variable]] | None = None,
    ) -> None:
        if not isinstance(network, BayesianNetwork):
            raise GraphError(f"a cluster graph is of a BayesianNetwork, not of {network!r}")
        place = {variable: k for k, variable in enumerate(network.variables)}

        def scope(members: Iterable[Variable], where: str) -> Scope:
            """In the network's order, since sets have none of their own."""
            found = as_scope(members)
            for variable in found:
                if variable not in place:
                    raise GraphError(
                        f"{where} holds {variable!r}, which the network does not have",
                        variable=variable,
                    )
            return tuple(sorted(found, key=place.__getitem__))

        scopes = [scope(members, f"cluster {k}") for k, members in enumerate(clusters)]
        cpds = assign(network.cpds, scopes)
        if sepsets is None:
            joined = spanning_tree(scopes)
        else:
            joined = {}
            for edge, members in sepsets.items():
                i, j = _edge(edge, len(scopes))
                if (i, j) in joined:
                    raise GraphError(f"clusters {i} and {j} are given two sepsets", cluster=i)
                joined[i, j] = scope(members, f"the sepset between clusters {i} and {j}")
        check_running_intersection(scopes, joined)
        made = (
            Cluster(k, members, inside, tuple(cpd.scope for cpd in inside))
            for k, (members, inside) in enumerate(zip(scopes, cpds, strict=True))
        )
        ordered = {edge: joined[edge] for edge in sorted(joined)}
        self._set(network=network, _clusters=tuple(made), _sepsets=MappingProxyType(ordered))

    @property
    def clusters(self) -> Sequence[Cluster]:
        """The clusters, by index."""
        return self._clusters

    @property
    def sepsets(self) -> Mapping[Edge, Scope]:
        """The variables that each pair of joined clusters, lower index first, agrees about."""
        return self._sepsets

    @cached_property
    def _neighbours(self) -> tuple[tuple[int, ...], ...]:
        lists: list[list[int]] = [[] for _ in self._clusters]
        for i, j in self._sepsets:
            lists[i].append(j)
            lists[j].append(i)
        return tuple(tuple(sorted(found)) for found in lists)

    def neighbours(self, index: int) -> tuple[int, ...]:
        """The clusters joined to one."""
        return self._neighbours[index]

    @cached_property
    def is_tree(self) -> bool:
        """Whether it has no loops: a tree, or several."""
        return nx.is_forest(self.to_networkx()) if len(self) else True

    def index(self, cluster: int | Cluster) -> int:
        """The index of a cluster, given by index or value."""
        found = cluster.index if isinstance(cluster, Cluster) else cluster
        if not isinstance(found, int | np.integer) or not 0 <= found < len(self.clusters):
            raise GraphError(
                f"there is no cluster {cluster!r}; clusters are 0..{len(self.clusters) - 1}",
                cluster=cluster,
            )
        return int(found)

    def families(self) -> Iterable[Scope]:
        """The families of all CPDs of the network, each of which needs a cluster."""
        return (cpd.scope for cpd in self.network.cpds)

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

    def derived(self, make: Callable[..., T], *key: Any) -> T:
        """What a function makes of this graph and a key, made once.

        The place of plans that the layers above compile from the structure.
        """
        if (make, key) not in self._derived:
            self._derived[make, key] = make(self, *key)
        found: T = self._derived[make, key]
        return found

    @cached_property
    def _derived(self) -> dict[Any, Any]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in super().__getstate__().items() if k != "_derived"}

    def __iter__(self) -> Iterator[Cluster]:
        return iter(self.clusters)

    def __len__(self) -> int:
        return len(self.clusters)

    def __repr__(self) -> str:
        return f"ClusterGraph({len(self.clusters)} clusters, {len(self.sepsets)} sepsets)"


def _edge(edge: Any, count: int) -> Edge:
    """A pair of different clusters, lower index first."""
    try:
        i, j = sorted(map(int, edge))
    except (TypeError, ValueError):
        raise GraphError(f"sepsets map pairs of clusters to variables; {edge!r} is none") from None
    if i == j or not (i >= 0 and j < count):
        raise GraphError(
            f"a sepset joins two of the clusters 0..{count - 1}, not {edge!r}", cluster=i
        )
    return i, j
