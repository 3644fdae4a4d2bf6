"""Listings of clusters and their neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pgm.display import Listing, few
from pgm.factors.scope import listed

if TYPE_CHECKING:
    from pgm.clustergraph.structure import ClusterGraph

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
