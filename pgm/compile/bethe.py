"""Bethe cluster graphs: loopy graphs whose clusters are no larger than the network's families."""

from __future__ import annotations

from dataclasses import dataclass

from pgm.clustergraph import ClusterGraph
from pgm.clustergraph.checks import Edge
from pgm.factors.scope import Scope
from pgm.networks import BayesianNetwork
from pgm.variables import Variable


@dataclass(frozen=True)
class Bethe:
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
        """Compile a network."""
        families = maximal([cpd.scope for cpd in network.cpds])
        holders: dict[Variable, list[int]] = {variable: [] for variable in network.variables}
        for k, family in enumerate(families):
            for variable in family:
                holders[variable].append(k)
        shared = {variable: found for variable, found in holders.items() if len(found) > 1}
        sepsets: dict[Edge, Scope] = {}
        for k, (variable, found) in enumerate(shared.items(), start=len(families)):
            sepsets |= {(holder, k): (variable,) for holder in found}
        return ClusterGraph(network, [*families, *((variable,) for variable in shared)], sepsets)


def maximal(families: list[Scope]) -> list[Scope]:
    """The families that lie in no other, the first of equals."""
    members = [frozenset(family) for family in families]
    holders: dict[Variable, list[int]] = {}
    for k, family in enumerate(families):
        for variable in family:
            holders.setdefault(variable, []).append(k)

    def inside(k: int, other: int) -> bool:
        return members[k] < members[other] or (members[k] == members[other] and other < k)

    return [
        family
        for k, family in enumerate(families)
        if not any(
            inside(k, other) for other in min((holders[variable] for variable in family), key=len)
        )
    ]
