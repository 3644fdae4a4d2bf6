"""Which cluster takes which CPD, and which clusters are joined, where nobody says so."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

import networkx as nx

from pgm.clustergraph.checks import Edge
from pgm.cpds import CPD
from pgm.errors import GraphError
from pgm.factors.scope import Scope, dimension, names
from pgm.variables import Variable


def _holders(scopes: Sequence[Scope]) -> dict[Variable, list[int]]:
    """The clusters that hold each variable."""
    holders: dict[Variable, list[int]] = defaultdict(list)
    for k, scope in enumerate(scopes):
        for variable in scope:
            holders[variable].append(k)
    return holders


def assign(cpds: Iterable[CPD], scopes: Sequence[Scope]) -> list[tuple[CPD, ...]]:
    """Each CPD to the smallest cluster that holds its family, the first of equals.

    Raises
    ------
    GraphError
        If no cluster does, naming the CPD.
    """
    holders = _holders(scopes)
    sizes = [dimension(scope) for scope in scopes]
    members = [set(scope) for scope in scopes]
    inside: list[list[CPD]] = [[] for _ in scopes]
    for cpd in cpds:
        rarest = min(cpd.scope, key=lambda variable: len(holders[variable]))
        fits = [k for k in holders[rarest] if members[k].issuperset(cpd.scope)]
        if not fits:
            raise GraphError(
                f"family preservation fails: no cluster holds the family {names(cpd.scope)} of "
                f"the CPD of {cpd.child!r}; add a cluster that does",
                variable=cpd.child,
                cpd=cpd,
            )
        inside[min(fits, key=lambda k: (sizes[k], k))].append(cpd)
    return [tuple(found) for found in inside]


def spanning_tree(scopes: Sequence[Scope]) -> dict[Edge, Scope]:
    """The sepsets of a maximum-weight spanning tree, or forest: full intersections.

    It has running intersection if any spanning tree has.
    """
    weights: dict[Edge, int] = defaultdict(int)
    for variable, found in _holders(scopes).items():
        for a, i in enumerate(found):
            for j in found[a + 1 :]:
                weights[i, j] += variable.dimension if variable.dimension else 1
    graph = nx.Graph()
    graph.add_nodes_from(range(len(scopes)))
    graph.add_weighted_edges_from((i, j, weight) for (i, j), weight in weights.items())
    members = [set(scope) for scope in scopes]
    edges = (tuple(sorted(edge)) for edge in nx.maximum_spanning_edges(graph, data=False))
    return {(i, j): tuple(v for v in scopes[i] if v in members[j]) for i, j in edges}
