"""How large the tables of a graph may be."""

from __future__ import annotations

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.size import amount
from pgm.errors import GraphError
from pgm.factors.scope import names

# Entries of all tables that a graph may have: a gigabyte.
LIMIT = 2**27
# Entries of all tables, times runs, that are calibrated at once: what stays near the processor.
BATCH = 2**22
# Entries, times runs, that a posterior keeps; those of more are calibrated again when asked for.
KEPT = 2**24
# Variables of a cluster that a message lists.
LISTED = 8


def require_size(graph: ClusterGraph) -> None:
    """Refuse a graph whose tables would not fit, before any is made.

    Raises
    ------
    GraphError
        Naming the largest cluster, its entries and bytes.
    """
    total = sum(graph.sizes)
    if total <= LIMIT:
        return
    largest = max(graph.clusters, key=lambda cluster: cluster.size)
    raise GraphError(
        f"the tables of {graph!r} are too large: cluster {largest.index} over {_listed(largest)} "
        f"has {amount(largest.size)} entries, {largest.size / 2**27:.3g} GiB, and all clusters "
        f"together {amount(total)}, where {LIMIT} are the limit; a loopy graph has small ones: "
        "pgm.infer(pgm.compile(network, method=pgm.Bethe()), evidence, schedule=pgm.Flooding()), "
        "whose beliefs are approximate",
        cluster=largest.index,
    )


def _listed(cluster: Cluster) -> str:
    scope = cluster.scope
    if len(scope) <= LISTED:
        return names(scope)
    return f"{names(scope[:LISTED])[:-1]}, ...), {len(scope)} variables,"
