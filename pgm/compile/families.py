"""Loopy graphs whose clusters are the network's families."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pgm.clustergraph import ClusterGraph
from pgm.clustergraph.assignment import holding
from pgm.clustergraph.checks import Edge
from pgm.display import InCode
from pgm.factors.scope import Scope
from pgm.networks import BayesianNetwork
from pgm.variables import Variable


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

    def __call__(self, network: BayesianNetwork) -> ClusterGraph:
        """Compile a network.

        Parameters
        ----------
        network : BayesianNetwork

        Returns
        -------
        ClusterGraph
        """
        families = maximal([cpd.scope for cpd in network.cpds])
        holders = holding(families)
        shared = [variable for variable in network.variables if len(holders[variable]) > 1]
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
    as many variables as its clusters share; laid on top of each other, the trees of all variables
    make the sepsets. Of edges that weigh the same, the first are those of the cluster that shares
    most with all others. That order is one for all variables, so that families which can be joined
    to a junction tree are joined to one, and inference is exact. Families inside other families
    have no cluster of their own.

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

    def __call__(self, network: BayesianNetwork) -> ClusterGraph:
        """Compile a network.

        Parameters
        ----------
        network : BayesianNetwork

        Returns
        -------
        ClusterGraph
        """
        clusters = maximal([cpd.scope for cpd in network.cpds])
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
