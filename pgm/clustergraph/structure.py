"""Cluster graphs as structure, which schedules send messages on; trees of clusters, rooted."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, repeat
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_tuple, is_whole
from pgm.clustergraph.cluster import (
    Cluster,
    Edge,
    amount,
    as_edge,
    assign,
    check_families,
    check_running_intersection,
    extent,
    is_forest,
    neighbourhoods,
    no_cluster,
    size,
    spanning_tree,
    work,
)
from pgm.cpds import CausalIndependence
from pgm.cpds.jacobians import check_jacobians
from pgm.display import Drawn, Summary, count, titled
from pgm.errors import GraphError
from pgm.factors.scope import MOST, Scope, as_scope, listed, unknown_name
from pgm.immutable import Immutable
from pgm.kernels.arrays import Integers
from pgm.networks import MarkovNetwork
from pgm.resources import uncollected
from pgm.variables import Variable

if TYPE_CHECKING:
    import networkx as nx

T = TypeVar("T")
Places = tuple[int, ...]

# Plans that a graph keeps: one for each set of observed variables that is asked about in turn.
PLANS_KEPT = 32


@public
class ClusterGraph(Drawn, Immutable):
    """An undirected graph of clusters; its edges are labelled with sepsets.

    Structure alone: it holds no evidence, message or belief. Made by `compile`, or by hand from
    sets of variables. Each factor, or CPD, goes to the smallest cluster that holds its variables.

    Parameters
    ----------
    network : MarkovNetwork
        A `BayesianNetwork`, or any other.
    clusters : sequence of sets of Variable
    sepsets : mapping of (int, int) to set of Variable, optional
        The sepset of each pair of joined clusters. Without, a tree whose sepsets are the full
        intersections: a maximum-weight spanning tree, where that has running intersection.

    Raises
    ------
    GraphError
        If a family is in no cluster (family preservation), or a variable's clusters and the
        sepsets that carry it form no tree (running intersection), naming variable and clusters.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> graph = pgm.ClusterGraph(pair, [{a}, {a, b}], sepsets={(0, 1): {a}})
    >>> pgm.infer(graph, {b: [2.0]})[a].mean
    array([1.])
    """

    network: MarkovNetwork
    # The network whose factors the clusters hold: `network`, CPDs of independent causes in theirs.
    _factorised: MarkovNetwork
    # Variables by their place in that network, in its order: of clusters, of sepsets.
    _members: Sequence[Places]
    _shared: Mapping[Edge, Places]
    # Of each cluster, the places of its factors in that network.
    _assigned: Sequence[Sequence[int]]
    # Whether its tree is solved in machine code, as `compile` was asked; None where it pays.
    compiled: Any = None

    def __init__(
        self,
        network: MarkovNetwork,
        clusters: Iterable[Iterable[Variable]],
        sepsets: Mapping[Edge, Iterable[Variable]] | None = None,
    ) -> None:
        if not isinstance(network, MarkovNetwork):
            raise GraphError(
                f"a cluster graph is of a network without time, not of {titled(network)}"
            )
        given = as_tuple(clusters)
        if given is None:
            raise GraphError(f"clusters is a sequence of sets of variables, not {clusters!r}")
        given = tuple(tuple(each) if isinstance(each, Iterator) else each for each in given)
        inside = _held(network, given)
        place = inside._places

        def places(members: Iterable[Variable], where: str) -> Places:
            """The places of some variables in the network's order, ascending.

            `members` are the variables, or the names, of a cluster or sepset, in any order; `where`
            is its name in the `GraphError` of members that are none or not in the network.
            """
            items = (members,) if isinstance(members, Variable | str) else as_tuple(members)
            if items is None:
                raise GraphError(f"{where} is a set of variables, not {members!r}")
            found = as_scope(items, where)
            for variable in found:
                if variable not in place:
                    raise GraphError(
                        f"{where} holds {variable!r}, {unknown_name(variable, place)}",
                        variable=variable,
                    )
            return tuple(sorted(map(place.__getitem__, found)))

        scopes = [places(members, f"cluster {k}") for k, members in enumerate(given)]
        if () in scopes:
            empty = scopes.index(())
            raise GraphError(f"cluster {empty} is empty; leave it out", cluster=empty)
        self._assign(network, inside, scopes)
        if sepsets is None:
            named = spanning_tree([self._named(members) for members in scopes])
            joined = {edge: tuple(map(place.__getitem__, shared)) for edge, shared in named.items()}
        else:
            if not isinstance(sepsets, Mapping):
                raise GraphError(
                    f"sepsets maps pairs of clusters to sets of variables; it is {sepsets!r}"
                )
            joined = {}
            for edge, members in sepsets.items():
                i, j = as_edge(edge, len(scopes))
                if (i, j) in joined:
                    raise GraphError(f"clusters {i} and {j} are given two sepsets", cluster=i)
                joined[i, j] = places(members, f"the sepset between clusters {i} and {j}")
        self._set(_shared=joined)
        check_running_intersection([cluster.scope for cluster in self.clusters], self.sepsets)

    @classmethod
    def _tree(
        cls, network: MarkovNetwork, members: Iterable[set[int]], joined: Mapping[Edge, set[int]]
    ) -> ClusterGraph:
        """A graph of places that has running intersection by its making: it is not checked."""
        graph = cls.__new__(cls)
        graph._assign(network, network._factorised, [tuple(sorted(held)) for held in members])
        sepsets = {edge: tuple(sorted(shared)) for edge, shared in joined.items()}
        graph._set(_shared=sepsets, is_tree=True)
        return graph

    def _with(
        self,
        network: MarkovNetwork,
        members: Sequence[Places],
        shared: Mapping[Edge, Places],
        assigned: Sequence[Sequence[int]],
    ) -> ClusterGraph:
        """A graph of another network, of tables, with the structure of this one: not checked."""
        graph = ClusterGraph.__new__(ClusterGraph)
        variables = network.variables
        sizes = tuple([size(tuple([variables[place] for place in held])) for held in members])
        graph._set(network=network, _factorised=network, _members=members)
        graph._set(_assigned=assigned, sizes=sizes)
        graph._set(_shared=shared, is_tree=self.is_tree, compiled=self.compiled)
        return graph

    def _assign(
        self, network: MarkovNetwork, inside: MarkovNetwork, members: Sequence[Places]
    ) -> None:
        extents = list(map(extent, inside.variables))
        combine = math.prod if network.discrete else sum
        sizes = tuple([combine([extents[place] for place in held]) for held in members])
        if network.mixed:
            variables = inside.variables
            sizes = tuple([size(tuple([variables[place] for place in held])) for held in members])
        assigned: list[list[int]] = [[] for _ in members]
        for number, home in enumerate(assign(inside._families, members, sizes)):
            if home < 0:
                raise no_cluster(inside.factors[number], network)
            assigned[home].append(number)
        self._set(network=network, _factorised=inside, _members=members)
        self._set(_assigned=assigned, sizes=sizes)

    def _named(self, places: Places) -> Scope:
        return tuple([self._factorised.variables[place] for place in places])

    # Made on request: nothing of the numbers' work needs them.
    @cached_property
    def _clusters(self) -> tuple[Cluster, ...]:
        found = []
        factors, places = self._factorised.factors, self._factorised._families
        with uncollected(len(factors)):
            for index, numbers in enumerate(self._assigned):
                inside = tuple([factors[number] for number in numbers])
                families = tuple([self._named(places[number]) for number in numbers])
                found.append(Cluster(index, self._named(self._members[index]), inside, families))
        return tuple(found)

    @cached_property
    def _sepsets(self) -> Mapping[Edge, Scope]:
        edges = sorted(self._shared)
        return MappingProxyType({edge: self._named(self._shared[edge]) for edge in edges})

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
        lists: list[list[int]] = [[] for _ in self._members]
        for i, j in self._shared:
            lists[i].append(j)
            lists[j].append(i)
        return tuple(tuple(sorted(found)) for found in lists)

    def neighbours(self, cluster: int | Cluster) -> tuple[int, ...]:
        """The indices of the clusters joined to one, in order."""
        return self._neighbours[self.index(cluster)]

    @cached_property
    def is_tree(self) -> bool:
        """Whether it has no loops: a tree, or several."""
        return is_forest(self.sepsets)

    @property
    def _alike(self) -> Iterable[tuple[Cluster, int]]:
        return ((cluster, 1) for cluster in self._clusters)

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """The size of each cluster: its components, or its table's entries if it is discrete."""
        runs = (repeat(cluster.size, count) for cluster, count in self._alike)
        return tuple(chain.from_iterable(runs))

    @cached_property
    def width(self) -> int:
        """The largest number of variables in a cluster, less one.

        The least width of a network's junction trees is its treewidth.
        """
        return max(map(len, self._members)) - 1

    @cached_property
    def cost(self) -> int:
        """About what a pass of messages takes, over all clusters, if nothing is observed.

        Entries of tables, or the cubes of the components, as eliminating from a Gaussian takes.
        Compare it where a network is compiled by several methods or elimination orders: they differ
        by powers of ten.
        """
        return sum(work(cluster.scope) * count for cluster, count in self._alike)

    def index(self, cluster: int | Cluster) -> int:
        """The index of a cluster, given by it or as it; another graph's is refused."""
        found = cluster.index if isinstance(cluster, Cluster) else cluster
        if not is_whole(found) or not 0 <= found < self._count:
            raise GraphError(
                f"there is no cluster {cluster!r}; clusters are {self._indices()}", cluster=cluster
            )
        if isinstance(cluster, Cluster) and (own := self._view(found)) != cluster:
            raise GraphError(
                f"{cluster!r} is a cluster of another graph; {own!r} has its index in this one. "
                "Give one of this graph's clusters, or an index",
                cluster=cluster,
            )
        return int(found)

    def cluster(self, cluster: int | Cluster) -> Cluster:
        """One of the clusters, by its index, 0 to ``len(graph) - 1``, or the cluster itself."""
        return self._view(self.index(cluster))

    def _view(self, index: int) -> Cluster:
        return self._clusters[index]

    def _indices(self) -> str:
        each = (f"{k} ({listed(self._view(k).scope)})" for k in range(min(self._count, MOST)))
        return f"0..{self._count - 1}" + (f": {', '.join(each)}" if self._count <= MOST else "")

    def families(self) -> Iterable[Scope]:
        """The families of all factors of the network, each of which needs a cluster."""
        return (factor.scope for factor in self._factorised.factors)

    @public
    def check(self, *, jacobians: bool = False) -> None:
        """Prove family preservation and running intersection, or raise a `GraphError`.

        It names the variable and the clusters concerned. With `jacobians`, given Jacobians are
        compared, too, with the derivatives of their functions' traces (differences, where there is
        none), at the prior's mean and at drawn points: a `ModelError` names the wrong entry.
        """
        clusters = list(self.clusters)
        scopes = [cluster.scope for cluster in clusters]
        check_families(scopes, [cluster.families for cluster in clusters], self.families())
        check_running_intersection(scopes, self.sepsets)
        if jacobians:
            check_jacobians(self.network.cpds)

    def to_networkx(self) -> nx.Graph:
        """The structure as a graph: nodes are indices with ``cluster``; edges have ``sepset``."""
        import networkx as nx  # here, since it is slow to import

        graph = nx.Graph()
        graph.add_nodes_from((cluster.index, {"cluster": cluster}) for cluster in self.clusters)
        graph.add_edges_from((i, j, {"sepset": scope}) for (i, j), scope in self.sepsets.items())
        return graph

    def derived(self, make: Callable[..., T], *key: Any) -> T:
        """The result of ``make(graph, *key)``, made once; the latest are kept.

        The place of plans that the layers above compile from the structure.
        """
        plans = self._derived
        found: T = plans.pop((make, key)) if (make, key) in plans else make(self, *key)
        plans[make, key] = found
        if len(plans) > PLANS_KEPT:
            del plans[next(iter(plans))]
        return found

    @cached_property
    def _derived(self) -> dict[Any, Any]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in super().__getstate__().items() if k != "_derived"}

    def __iter__(self) -> Iterator[Cluster]:
        return iter(self.clusters)

    @property
    def _count(self) -> int:
        return len(self._members)

    def __len__(self) -> int:
        return self._count

    @property
    def _title(self) -> str:
        unit = "table entries" if self.network.discrete else "components"
        unit = "numbers" if self.network.mixed else unit
        return (
            f"ClusterGraph({count(len(self), 'cluster')}, {count(len(self.sepsets), 'sepset')}, "
            f"width {self.width}, largest cluster {amount(max(self.sizes))} {unit}, "
            f"cost {amount(self.cost)})"
        )

    def _summary(self) -> Summary:
        return Summary(self._title, [neighbourhoods(self)])


def _held(network: MarkovNetwork, clusters: Iterable[Any]) -> MarkovNetwork:
    """The network with CPDs of independent causes in factors, but those that a cluster holds whole.

    Clusters that name intermediate variables of a CPD are for its factors.
    """
    if network._factorised is network:
        return network
    found = [
        {v for v in as_tuple(members) or () if isinstance(v, Variable)} for members in clusters
    ]
    named = set[Variable]().union(*found)
    taken = {v.name for v in network.variables}
    whole = [
        factor
        for factor in network.factors
        if isinstance(factor, CausalIndependence)
        and named.isdisjoint(factor._intermediate(taken))
        and any(held.issuperset(factor.scope) for held in found)
    ]
    return network._in_factors(whole)


@dataclass(frozen=True, eq=False)
class Forest:
    """The trees of a cluster graph, each hung at its centre, so that few rounds reach all.

    `parent` is −1 at a root; `levels` are the clusters at each depth, the roots first.
    """

    parent: Integers
    depth: Integers
    levels: list[Integers]

    @classmethod
    def of(cls, graph: ClusterGraph) -> Forest:
        """Root the trees of a graph without loops."""
        neighbours = graph._neighbours
        parent = np.full(len(graph), -1, dtype=np.intp)
        depth = np.full(len(graph), -1, dtype=np.intp)
        for first in range(len(graph)):
            if depth[first] < 0:
                root = _centre(neighbours, first)
                depth[root] = 0
                for source, target in _edges(neighbours, root):
                    parent[target], depth[target] = source, depth[source] + 1
        order = np.argsort(depth, kind="stable")
        bounds = np.cumsum(np.bincount(depth))
        return cls(parent, depth, np.split(order, bounds[:-1]))

    @cached_property
    def children(self) -> list[list[int]]:
        """The clusters that hang on each."""
        found: list[list[int]] = [[] for _ in self.parent]
        for k, parent in enumerate(self.parent.tolist()):
            if parent >= 0:
                found[parent].append(k)
        return found

    @cached_property
    def roots(self) -> Integers:
        """The root of each cluster's tree, (clusters,)."""
        found = np.arange(self.parent.size)
        for level in self.levels[1:]:
            found[level] = found[self.parent[level]]
        return found


def _edges(neighbours: Sequence[tuple[int, ...]], root: int) -> list[tuple[int, int]]:
    found, queue = [], deque([(root, -1)])
    while queue:
        at, before = queue.popleft()
        for other in neighbours[at]:
            if other != before:
                found.append((at, other))
                queue.append((other, at))
    return found


def _centre(neighbours: Sequence[tuple[int, ...]], first: int) -> int:
    """The middle of a longest path, which joins the two clusters farthest from one another."""
    edges = _edges(neighbours, first)
    end = edges[-1][1] if edges else first
    before = {target: source for source, target in _edges(neighbours, end)}
    path = [next(reversed(before), end)]
    while path[-1] != end:
        path.append(before[path[-1]])
    return path[len(path) // 2]
