"""Clusters of variables, and the two properties that make a graph of them a cluster graph."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import TYPE_CHECKING, Any

from pgm.boundary import as_tuple, is_whole
from pgm.cpds import CPD
from pgm.display import Listing, Shown, Summary, few
from pgm.errors import GraphError
from pgm.factors.scope import MOST, Scope, dimension, listed
from pgm.networks.markov import Factor, MarkovNetwork
from pgm.variables import Discrete, Variable

if TYPE_CHECKING:
    from pgm.clustergraph.structure import ClusterGraph

Edge = tuple[int, int]


def check_families(
    scopes: Sequence[Iterable[Variable]],
    assigned: Sequence[Iterable[Scope]],
    families: Iterable[Scope] | None = None,
) -> None:
    """Family preservation: each factor's family stands in exactly one cluster, which holds it.

    `assigned` are the families of each cluster, `families` all of the network, or those assigned.
    """
    for index, (scope, inside) in enumerate(zip(scopes, assigned, strict=True)):
        held = set(scope)
        for family in inside:
            lost = [variable for variable in family if variable not in held]
            if lost:
                raise GraphError(
                    f"family preservation fails: cluster {index} is assigned the family "
                    f"({listed(family)}), but lacks ({listed(lost)}) of it; add them to the "
                    "cluster or move the family",
                    variable=lost[0],
                    cluster=index,
                )
    counts = Counter(family for inside in assigned for family in inside)
    due = Counter(dict.fromkeys(counts, 1) if families is None else families)
    for family, number in due.items():
        if counts[family] != number:
            raise GraphError(
                f"family preservation fails: the family ({listed(family)}) is assigned to "
                f"{counts[family]} clusters; {'one' if number == 1 else number} was due",
                variable=family[0] if family else None,
            )


def no_cluster(factor: Factor, network: MarkovNetwork) -> GraphError:
    """The error for a factor whose variables no cluster holds.

    `network` is the user's, which has not the intermediate variables of independent causes.
    """
    cpd = factor if isinstance(factor, CPD) else None
    of = f" of the CPD of {cpd.child!r}" if cpd else " of a factor"
    advice = ""
    if not network._places.keys() >= set(factor.scope):
        advice = (
            "; one for the whole family of its child and all causes, whose table is then made, or "
            "those that pgm.compile(network) makes, with their intermediate variables"
        )
    return GraphError(
        f"family preservation fails: no cluster holds the family ({listed(factor.scope)}){of}; add "
        f"a cluster that does{advice}",
        variable=cpd.child if cpd else factor.scope[0],
        cpd=cpd,
    )


def check_running_intersection(
    scopes: Sequence[Iterable[Variable]], sepsets: Mapping[Edge, Iterable[Variable]]
) -> None:
    """Running intersection: the clusters and sepsets that carry a variable form a tree."""
    holders: dict[Variable, set[int]] = defaultdict(set)
    for index, scope in enumerate(scopes):
        for variable in scope:
            holders[variable].add(index)
    edges = set(sepsets)
    for i, j in edges:
        if i == j or (j, i) in edges:
            raise GraphError(
                f"clusters {i} and {j} are joined twice, or one to itself; one sepset joins two "
                "clusters",
                cluster=i,
            )
    carriers: dict[Variable, list[Edge]] = defaultdict(list)
    for (i, j), sepset in sepsets.items():
        for variable in sepset:
            for end in (i, j):
                if end not in holders.get(variable, ()):
                    raise GraphError(
                        f"the sepset between clusters {i} and {j} holds {variable!r}, which "
                        f"cluster {end} does not",
                        variable=variable,
                        cluster=end,
                    )
            carriers[variable].append((i, j))
    loopless = is_forest(edges)
    for variable, clusters in holders.items():
        carrying = carriers[variable]
        if len(carrying) == len(clusters) - 1 and (loopless or is_forest(carrying)):
            continue
        raise _broken(variable, clusters, carrying)


def _broken(
    variable: Variable, clusters: Collection[int], carrying: Collection[Edge]
) -> GraphError:
    import networkx as nx  # here, since it is slow to import

    graph = nx.Graph(carrying)
    graph.add_nodes_from(clusters)
    pieces = list(nx.connected_components(graph))
    if len(pieces) > 1:
        apart = " and ".join(map(_some, pieces[:2]))
        return GraphError(
            f"running intersection fails: {variable!r} is in clusters {apart}, which no "
            "path of sepsets carrying it joins; add it to the sepsets between them",
            variable=variable,
            cluster=min(pieces[1]),
        )
    loop = [edge[0] for edge in nx.find_cycle(graph)]
    return GraphError(
        f"running intersection fails: the sepsets carry {variable!r} around the loop of "
        f"clusters {_some(loop)}; take it out of one of them",
        variable=variable,
        cluster=loop[0],
    )


def is_forest(edges: Iterable[Edge]) -> bool:
    """Whether no edges form a loop: each joins two trees that were apart."""
    above: dict[int, int] = {}

    def root(index: int) -> int:
        while above.get(index, index) != index:
            above[index] = above.get(above[index], above[index])
            index = above[index]
        return index

    for i, j in edges:
        first, second = root(i), root(j)
        if first == second:
            return False
        above[first] = second
    return True


def _some(clusters: Collection[int]) -> str:
    shown = ", ".join(map(str, sorted(clusters)[:5]))
    return f"[{shown}{', ...' if len(clusters) > 5 else ''}]"


def as_edge(edge: Any, count: int) -> Edge:
    """A pair of different clusters, lower index first."""
    ends = as_tuple(edge) or ()
    if len(ends) != 2 or not all(map(is_whole, ends)):
        raise GraphError(f"sepsets map pairs of clusters to variables; {edge!r} is none")
    i, j = sorted(map(int, ends))
    if i == j or not (i >= 0 and j < count):
        raise GraphError(
            f"a sepset joins two of the clusters 0..{count - 1}, not {edge!r}", cluster=i
        )
    return i, j


@dataclass(frozen=True, eq=False, repr=False)
class Cluster(Shown):
    """A set of variables, with the factors whose product is its potential.

    Attributes
    ----------
    index : int
    scope : tuple of Variable
    factors : tuple of CPD or Table
        The CPDs, or other factors.
    families : tuple of tuple of Variable
        The variables of each factor, of a CPD the child first, all inside the scope.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> cluster = pgm.compile(pair).clusters[0]
    >>> cluster
    Cluster(0: (a, b))
    >>> cluster.cpds
    (GaussianCPD(a), LinearGaussianCPD(b | a))
    """

    index: int
    scope: Scope
    factors: tuple[Factor, ...]
    families: tuple[Scope, ...]

    @property
    def cpds(self) -> tuple[CPD, ...]:
        """The factors that are CPDs."""
        return tuple(factor for factor in self.factors if isinstance(factor, CPD))

    @property
    def size(self) -> int:
        """Components of its continuous variables, or entries of its discrete ones' table."""
        return size(self.scope)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Cluster) and (self.index, self.scope, self.factors) == (
            other.index,
            other.scope,
            other.factors,
        )

    def __hash__(self) -> int:
        return hash((self.index, self.scope))

    @property
    def _title(self) -> str:
        return f"Cluster({self.index}: ({listed(self.scope)}))"

    def _summary(self) -> Summary:
        """The variables, and the factors in the notebook; in a terminal clusters stand in lists."""
        return Summary(self._title, [each._title for each in self.factors[:MOST]])

    def __repr__(self) -> str:
        return self._title


def extent(variable: Variable) -> int:
    """Number of states of a discrete variable, of components of a continuous one."""
    return variable.size if isinstance(variable, Discrete) else variable.dimension


def size(scope: Scope) -> int:
    """Entries of a table over discrete variables, or components of continuous ones.

    Of both it is their product: the components in all configurations.
    """
    return _entries(scope) * (_components(scope) or 1)


def work(scope: Scope) -> int:
    """Entries of a table, or the cube of the components, as of a Cholesky factor, or both."""
    return _entries(scope) * (_components(scope) ** 3 or 1)


def _entries(scope: Scope) -> int:
    return math.prod(v.size for v in scope if isinstance(v, Discrete))


def _components(scope: Scope) -> int:
    return dimension(v for v in scope if not isinstance(v, Discrete))


def is_discrete(scope: Iterable[Variable]) -> bool:
    """Whether a factor over these variables is a table."""
    return any(isinstance(variable, Discrete) for variable in scope)


def amount(number: int) -> str:
    """A number for messages: a power of ten, where its digits would not be read."""
    return str(number) if number < 10**9 else f"10^{math.log10(number):.1f}"


# Sepsets of a cluster, and variables of a sepset, that are shown.
FEW = 3


def neighbourhoods(graph: ClusterGraph) -> Listing:
    """The first and last clusters, each with its variables and its neighbours."""
    rows: list[Sequence[str] | None] = []
    for k in few(len(graph)):
        if k is None:
            rows.append(None)
            continue
        joined = graph.neighbours(k)
        each = [f"{j} by {listed(graph.sepsets[min(k, j), max(k, j)], FEW)}" for j in joined[:FEW]]
        more = [f"... {len(joined)} in all"] * (len(joined) > FEW)
        scope = listed(graph.clusters[k].scope)
        rows.append([str(k), scope, "; ".join(each + more)])
    heads = ("cluster", "variables", "joined to")
    return Listing(heads, rows, names=3)


def holding(scopes: Sequence[Scope]) -> dict[Variable, list[int]]:
    """The clusters that hold each variable."""
    holders: dict[Variable, list[int]] = defaultdict(list)
    for k, scope in enumerate(scopes):
        for variable in scope:
            holders[variable].append(k)
    return holders


def assign(
    families: Sequence[tuple[int, ...]], members: Sequence[tuple[int, ...]], sizes: Sequence[int]
) -> list[int]:
    """The smallest cluster that holds each family, the first of equals; −1, where none does."""
    by_size = sorted(range(len(members)), key=sizes.__getitem__)
    # By variable the clusters that hold it, told by their places in the order of sizes.
    holders: dict[int, list[int]] = defaultdict(list)
    for rank, k in enumerate(by_size):
        for place in members[k]:
            holders[place].append(rank)
    sets: dict[int, set[int]] = {}
    homes = list[int]()
    for family in families:
        if not family:  # a number
            homes.append(by_size[0])
            continue
        held = [holders[place] for place in family]
        # Of most families a variable is in one cluster alone, or few: that of a measurement.
        fewest = min(held, key=len)
        if len(fewest) == 1 and set(members[by_size[fewest[0]]]).issuperset(family):
            homes.append(by_size[fewest[0]])
            continue
        fits = set(fewest)
        for place, ranks in zip(family, held, strict=True):
            if ranks is not fewest:
                if place not in sets:
                    sets[place] = set(ranks)
                fits &= sets[place]
        homes.append(by_size[min(fits)] if fits else -1)
    return homes


def spanning_tree(scopes: Sequence[Scope]) -> dict[Edge, Scope]:
    """The sepsets of a maximum-weight spanning tree, or forest: full intersections.

    An edge weighs as many variables as its clusters share. A tree carries a variable of k clusters
    on at most k − 1 edges, and on as many only if these join all k: so if any spanning tree has
    running intersection, those of maximum weight have it, and no others. Maximum cardinality
    search finds one in time about linear in the clusters' sizes (Tarjan and Yannakakis, 1984,
    section 4; Jensen and Jensen, Optimal junction trees, 1994).
    """
    holders = holding(scopes)
    members = [set(scope) for scope in scopes]
    shared = [0] * len(scopes)
    taken = [False] * len(scopes)
    # Which cluster was the first to hold a variable, and when it was taken.
    first: dict[Variable, tuple[int, int]] = {}
    # Entries of clusters that share more by now stay until they come up.
    heap = [(0, k) for k in range(len(scopes))]
    joined: dict[Edge, Scope] = {}
    while heap:
        _, cluster = heappop(heap)
        if taken[cluster]:
            continue
        taken[cluster] = True
        scope = scopes[cluster]
        old = tuple(variable for variable in scope if variable in first)
        if old:
            _, nearest = max(first[variable] for variable in old)
            lost = [variable for variable in old if variable not in members[nearest]]
            if lost:
                ends = sorted((first[lost[0]][1], cluster))
                raise GraphError(
                    f"running intersection fails: no tree of these clusters carries each variable; "
                    f"{lost[0]!r} is in clusters {ends[0]} and {ends[1]}, but not in {nearest} "
                    "between them. Add it there, or give sepsets, for a graph with loops",
                    variable=lost[0],
                    cluster=nearest,
                )
            joined[min(cluster, nearest), max(cluster, nearest)] = old
        when = len(first)
        for variable in scope:
            if variable not in first:
                first[variable] = (when, cluster)
                for other in holders[variable]:
                    if not taken[other]:
                        shared[other] += 1
                        heappush(heap, (-shared[other], other))
    return joined
