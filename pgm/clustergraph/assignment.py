"""The assignment of CPDs to clusters, and the tree of clusters, where they are not given."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from heapq import heappop, heappush

from pgm.clustergraph.checks import Edge
from pgm.errors import GraphError
from pgm.factors.scope import Scope
from pgm.variables import Variable


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
    holders: dict[int, set[int]] = {}
    for k, held in enumerate(members):
        for place in held:
            if place in holders:
                holders[place].add(k)
            else:
                holders[place] = {k}
    homes, nowhere = list[int](), set[int]()
    for family in families:
        fits = set.intersection(*[holders.get(place, nowhere) for place in family])
        homes.append(min(sorted(fits), key=sizes.__getitem__, default=-1))
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
