"""How large the tables and covariances of a graph may be."""

from __future__ import annotations

from collections.abc import Sequence

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.size import amount
from pgm.errors import GraphError
from pgm.factors.scope import names

# Entries of all tables, or covariances, that a graph may have: a gigabyte.
LIMIT = 2**27
# Entries of all tables, times runs, that are calibrated at once: what stays near the processor.
BATCH = 2**22
# Entries, times runs, that a posterior keeps; those of more are calibrated again when asked for.
KEPT = 2**24
# Variables of a cluster that a message lists.
LISTED = 8


def require_size(graph: ClusterGraph, entries: Sequence[int], what: str) -> None:
    """Refuse a graph whose tables or covariances would not fit, before any is made.

    Parameters
    ----------
    graph : ClusterGraph
    entries : sequence of int
        Of each cluster.
    what : str
        What they are entries of.

    Raises
    ------
    GraphError
        Naming the largest cluster, its entries and bytes.
    """
    total = sum(entries)
    if total <= LIMIT:
        return
    index = max(range(len(entries)), key=entries.__getitem__)
    raise GraphError(
        f"the {what} of {graph!r} are too large: cluster {index} over "
        f"{_listed(graph.clusters[index])} has {amount(entries[index])} entries, "
        f"{entries[index] / 2**27:.3g} GiB, and all clusters together {amount(total)}, where "
        f"{LIMIT} are the limit; a loopy graph has small ones: "
        "pgm.infer(pgm.compile(network, method=pgm.Bethe()), evidence, schedule=pgm.Flooding()), "
        "whose beliefs are approximate",
        cluster=index,
    )


def _listed(cluster: Cluster) -> str:
    scope = cluster.scope
    if len(scope) <= LISTED:
        return names(scope)
    return f"{names(scope[:LISTED])[:-1]}, ...), {len(scope)} variables,"
