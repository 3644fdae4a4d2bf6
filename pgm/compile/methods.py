"""Methods of compiling networks without time: trees, join graphs, and clusters of families."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from pgm.arguments import public
from pgm.boundary import as_tuple, is_unordered, is_whole
from pgm.clustergraph import ClusterGraph
from pgm.clustergraph.cluster import Edge, amount, holding, is_discrete, size
from pgm.compile.elimination import clique_tree, moral
from pgm.compile.orders import MinFill, Order, StochasticMinFill, places
from pgm.cpds import CPD
from pgm.display import InCode
from pgm.errors import GraphError
from pgm.factors.scope import Scope, listed
from pgm.networks import MarkovNetwork
from pgm.networks.markov import written
from pgm.resources import uncollected
from pgm.variables import Discrete, Variable


@public
@dataclass(frozen=True)
class JunctionTree(InCode):
    """Compile to a tree of the cliques of the triangulated moral graph.

    Calibrating it is exact; what it costs grows with the largest clique. A network whose parts
    are not connected gives several trees. Of a mixed network continuous variables are eliminated
    before all discrete ones, which makes a strong junction tree (Lauritzen, 1992).

    Parameters
    ----------
    order : Order or iterable of Variable, optional
        Elimination order: `StochasticMinFill()`, if not given, `MinFill()`, `WeightedMinFill()`,
        `MinDegree()`, `NestedDissection()`, a function from networks to variables, or the variables
        themselves, each once. What it decides is what calibrating costs: compare `graph.cost`. If
        not given, it is chosen by the network: for tables min-fill, and a search where it pays; for
        continuous networks min-fill as long as at most 5,000 variables are parents, and minimum
        degree above.

    References
    ----------
    Lauritzen and Spiegelhalter (1988), Local computations with probabilities on graphical
    structures and their application to expert systems.

    Examples
    --------
    >>> JunctionTree()
    JunctionTree(order=StochasticMinFill(tries=200, seed=0))
    """

    order: Order | Iterable[Variable] = field(default_factory=StochasticMinFill)

    def __post_init__(self) -> None:
        order = self.order
        listed = None if callable(order) or is_unordered(order) else as_tuple(order)
        if isinstance(order, type) or (listed is None and not callable(order)):
            raise GraphError(
                f"{order!r} is no elimination order; give a value like pgm.MinFill() or "
                "pgm.WeightedMinFill(), or the network's variables"
            )
        if listed is not None:
            object.__setattr__(self, "order", listed)

    def __call__(self, network: MarkovNetwork) -> ClusterGraph:
        """Compile a network."""
        inside = network._factorised
        adjacent = moral(inside)
        order = places(self.order, network, adjacent)
        if network.mixed:  # what is left of Gaussians is then a table of the discrete variables
            order.sort(key=lambda place: isinstance(inside.variables[place], Discrete))
        with uncollected(len(order)):
            tree = clique_tree(adjacent, order)
            return ClusterGraph._tree(network, tree.cliques, tree.sepsets)


def graph_of(
    network: MarkovNetwork,
    clusters: Iterable[set[int]],
    sepsets: Mapping[Edge, set[int]],
) -> ClusterGraph:
    """The cluster graph of sets of places among the variables of the network in its factors."""
    variables = network._factorised.variables
    return ClusterGraph(
        network,
        [[variables[k] for k in cluster] for cluster in clusters],
        {edge: [variables[k] for k in shared] for edge, shared in sepsets.items()},
    )


@public
@dataclass(frozen=True)
class JoinGraph(InCode):
    """Compile to clusters of at most some size, as near to a junction tree as that allows.

    Variables are eliminated in an order. All scopes that hold the next one, X, would make one
    clique; they are put into as many *mini-buckets* as it takes for none to be too large. Each
    passes its scope without X on, by a sepset of all of it, and those of X are joined in a chain by
    sepsets of X alone. Where every clique is small enough, the graph is the junction tree of the
    order, and inference is exact; smaller clusters take less and, as a rule, approximate worse.

    Parameters
    ----------
    max_size : int
        The most that a cluster may hold, in the unit of `graph.sizes`: entries of its table if the
        network is discrete, or components if it is continuous.
    order : Order or iterable of Variable, optional
        Elimination order; see `JunctionTree`.

    References
    ----------
    Dechter, Kask and Mateescu (2002), Iterative join-graph propagation. Mateescu, Kask, Gogate and
    Dechter (2010), Join-graph propagation algorithms, section 4, where the bound is on the number
    of variables.

    Examples
    --------
    >>> JoinGraph(max_size=64)
    JoinGraph(max_size=64, order=MinFill())
    """

    max_size: int
    order: Order | Iterable[Variable] = field(default_factory=MinFill)

    def __post_init__(self) -> None:
        if not is_whole(self.max_size) or self.max_size < 1:
            raise GraphError(
                "JoinGraph makes clusters of at most `max_size` table entries or components, a "
                f"whole number, 1 or more, not {self.max_size!r}"
            )
        object.__setattr__(self, "order", JunctionTree(self.order).order)

    def __call__(self, network: MarkovNetwork) -> ClusterGraph:
        """Compile a network; a family that is too large alone is refused."""
        inside = network._factorised
        largest = max(inside.factors, key=lambda factor: size(factor.scope))
        if (least := size(largest.scope)) > self.max_size:
            unit = "table entries" if is_discrete(largest.scope) else "components"
            cpd = largest if isinstance(largest, CPD) else None
            raise GraphError(
                f"{self!r} has no cluster for {written(largest)}: its family "
                f"({listed(largest.scope)}) takes {amount(least)} {unit}; give max_size={least} "
                "or more",
                variable=largest.scope[0],
                cpd=cpd,
            )
        variables = inside.variables
        order = places(self.order, network, moral(inside))
        families = [set(family) for family in inside._families if family]

        def fits(members: set[int]) -> bool:
            return size(tuple(variables[k] for k in members)) <= self.max_size

        return graph_of(network, *_mini_buckets(families, order, fits))


@dataclass
class _MiniBucket:
    """Scopes that make a cluster together, each with the cluster that passed it on, if one did."""

    members: set[int]
    scopes: list[tuple[set[int], int | None]]


def _mini_buckets(
    families: Iterable[set[int]], order: Sequence[int], fits: Callable[[set[int]], bool]
) -> tuple[list[set[int]], dict[Edge, set[int]]]:
    """Clusters, none inside another, and sepsets, from eliminating vertices in an order."""
    position = {vertex: k for k, vertex in enumerate(order)}
    buckets: list[list[tuple[set[int], int | None]]] = [[] for _ in order]

    def put(scope: set[int], sender: int | None) -> None:
        buckets[min(map(position.__getitem__, scope))].append((scope, sender))

    clusters: list[set[int]] = []
    sepsets: dict[Edge, set[int]] = {}

    def join(i: int, j: int, shared: set[int]) -> None:
        # Running intersection: what joins two clusters for different variables is disjoint.
        sepsets.setdefault((min(i, j), max(i, j)), set()).update(shared)

    for family in families:
        put(family, None)
    for vertex, bucket in zip(order, buckets, strict=True):
        last: int | None = None
        for mini in _parted(bucket, fits):
            # One that is no more than what a cluster passed on is that cluster.
            inside = (k for scope, k in mini.scopes if len(scope) == len(mini.members))
            home = next((k for k in inside if k is not None), len(clusters))
            if home == len(clusters):
                clusters.append(mini.members)
            for scope, sender in mini.scopes:
                if sender is not None and sender != home:
                    join(sender, home, scope)
            if last is not None:
                join(last, home, {vertex})
            last = home
            if left := mini.members - {vertex}:
                put(left, home)
    return clusters, sepsets


def _parted(
    bucket: Iterable[tuple[set[int], int | None]], fits: Callable[[set[int]], bool]
) -> list[_MiniBucket]:
    """The scopes of a bucket, larger ones first, each in the first mini-bucket with room for it."""
    minis: list[_MiniBucket] = []
    for scope, sender in sorted(bucket, key=lambda each: -len(each[0])):
        mini = next((mini for mini in minis if fits(mini.members | scope)), None)
        if mini is None:
            mini = _MiniBucket(set(), [])
            minis.append(mini)
        mini.members |= scope
        mini.scopes.append((scope, sender))
    # One may lie inside another that grew after it.
    kept: list[_MiniBucket] = []
    for mini in sorted(minis, key=lambda each: -len(each.members)):
        holder = next((other for other in kept if other.members >= mini.members), None)
        if holder:
            holder.scopes += mini.scopes
        else:
            kept.append(mini)
    return kept


@dataclass(frozen=True)
class Bethe(InCode):
    """Compile to a cluster for each family, joined through a cluster for each variable they share.

    Families inside other families have no cluster of their own. Where the graph has loops, messages
    go round: means of Gaussian networks are exact if they converge, all else is an approximation.

    References
    ----------
    Yedidia, Freeman and Weiss (2005), Constructing free-energy approximations and generalized
    belief propagation algorithms.

    Examples
    --------
    >>> Bethe()
    Bethe()
    """

    def __call__(self, network: MarkovNetwork) -> ClusterGraph:
        """Compile a network."""
        inside = network._factorised
        families = maximal([factor.scope for factor in inside.factors if factor.scope])
        holders = holding(families)
        shared = [variable for variable in inside.variables if len(holders[variable]) > 1]
        sepsets: dict[Edge, Scope] = {}
        for k, variable in enumerate(shared, start=len(families)):
            sepsets |= {(holder, k): (variable,) for holder in holders[variable]}
        return ClusterGraph(network, [*families, *((variable,) for variable in shared)], sepsets)


def maximal(families: list[Scope]) -> list[Scope]:
    """The families that lie in no other, the first of equals."""
    members = [frozenset(family) for family in families]
    holders = holding(families)

    def inside(k: int, other: int) -> bool:
        return members[k] < members[other] or (members[k] == members[other] and other < k)

    return [
        family
        for k, family in enumerate(families)
        if not any(
            inside(k, other) for other in min((holders[variable] for variable in family), key=len)
        )
    ]


@dataclass(frozen=True)
class LTRIP(InCode):
    """Compile to a cluster for each family, joined by a spanning tree for each variable.

    For each variable, its clusters are joined by the tree of greatest weight, where an edge weighs
    as many variables as its clusters share; all trees together make the sepsets. Of edges that
    weigh the same, the first are those of the cluster that shares most with all others: one order
    for all variables, so that families which can be joined to a junction tree are joined to one,
    and inference is exact. Families inside other families have no cluster of their own.

    Elsewhere the graph has loops, but fewer and shorter ways around them than `Bethe`: families
    that share two variables agree about both together, where they can.

    References
    ----------
    Streicher and du Preez (2017), Graph coloring: comparing cluster graphs to factor graphs,
    arXiv:2110.02048, "layered trees running intersection property"; there, ties are weighed anew
    for each variable.

    Examples
    --------
    >>> LTRIP()
    LTRIP()
    """

    def __call__(self, network: MarkovNetwork) -> ClusterGraph:
        """Compile a network."""
        factors = network._factorised.factors
        clusters = maximal([factor.scope for factor in factors if factor.scope])
        return ClusterGraph(network, clusters, _layers(clusters))


def _layers(clusters: Sequence[Scope]) -> dict[Edge, list[Variable]]:
    """The sepsets: Kruskal's algorithm for the trees of all variables at once."""
    from networkx.utils import UnionFind  # here, since networkx is slow to import

    holders = holding(clusters)
    strength = [sum(len(holders[variable]) for variable in scope) for scope in clusters]
    rank = {k: r for r, k in enumerate(sorted(range(len(clusters)), key=lambda k: -strength[k]))}
    trees = {variable: UnionFind(found) for variable, found in holders.items()}
    sepsets: dict[Edge, list[Variable]] = {}

    def join(i: int, j: int, variable: Variable) -> None:
        tree = trees[variable]
        if tree[i] != tree[j]:
            tree.union(i, j)
            sepsets.setdefault((min(i, j), max(i, j)), []).append(variable)

    overlaps = _overlaps(clusters, holders)
    ends = {edge: sorted(edge, key=rank.__getitem__) for edge in overlaps}
    for i, j in sorted(overlaps, key=lambda e: (-len(overlaps[e]), *map(rank.get, ends[e]))):
        for variable in overlaps[i, j]:
            join(i, j, variable)
    # What is still apart shares one variable alone: all these edges weigh the same.
    for variable, found in holders.items():
        first, *others = sorted(found, key=rank.__getitem__)
        for other in others:
            join(first, other, variable)
    return sepsets


def _overlaps(
    clusters: Sequence[Scope], holders: dict[Variable, list[int]]
) -> dict[Edge, list[Variable]]:
    members = [set(scope) for scope in clusters]
    found: dict[Edge, list[Variable]] = {}
    for i, scope in enumerate(clusters):
        # Such pairs share another variable than the most common: a hub makes no pairs of all.
        common = max(scope, key=lambda variable: len(holders[variable]))
        near = {j for variable in scope if variable != common for j in holders[variable]}
        for j in near:
            if j < i and len(shared := [v for v in clusters[j] if v in members[i]]) > 1:
                found[j, i] = shared
    return found
