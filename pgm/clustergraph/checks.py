"""The two properties that make a graph of clusters a cluster graph of a network."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from pgm.boundary import as_tuple, is_whole
from pgm.errors import GraphError
from pgm.factors.scope import Scope, listed
from pgm.variables import Variable

Edge = tuple[int, int]


def check_families(
    scopes: Sequence[Iterable[Variable]],
    assigned: Sequence[Iterable[Scope]],
    families: Iterable[Scope] | None = None,
) -> None:
    """Family preservation: each CPD's family stands in exactly one cluster, which holds it.

    `assigned` are the families of each cluster, `families` all of the network, or those assigned.
    """
    for index, (scope, inside) in enumerate(zip(scopes, assigned, strict=True)):
        held = set(scope)
        for family in inside:
            lost = [variable for variable in family if variable not in held]
            if lost:
                raise GraphError(
                    f"family preservation fails: cluster {index} is assigned the CPD of "
                    f"{family[0]!r}, but lacks ({listed(lost)}) of its family ({listed(family)}); "
                    "add them to the cluster or move the CPD",
                    variable=lost[0],
                    cluster=index,
                )
    counts = Counter(family for inside in assigned for family in inside)
    for family in counts if families is None else families:
        if counts[family] != 1:
            raise GraphError(
                f"family preservation fails: the CPD of {family[0]!r}, with family "
                f"({listed(family)}), is assigned to {counts[family]} clusters; one was due",
                variable=family[0],
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
