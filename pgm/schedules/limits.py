"""Memory limits for tables and covariances of a graph, and for results read from them.

`LIMIT` is 2²⁷ array entries, a gibibyte: all tables, or covariances, of a graph may have so many,
and so may an answer over all runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from pgm.boundary import is_number
from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.cluster import amount
from pgm.display import titled
from pgm.errors import GraphError
from pgm.factors.axes import AXES, require_axes
from pgm.factors.scope import names
from pgm.resources import gibibytes
from pgm.variables import Discrete

# The most array entries of all tables, or covariances, of a graph, or of one answer over all runs:
# a gibibyte. The peak of memory is more, by potentials and intermediate results: two times as much,
# measured, for large tables, five for many small ones, six where messages go round.
LIMIT = 2**27
FACTOR = "about five"
# Bytes that the tables of many runs may take by default, and the table entries, times runs, of two
# halves of it. One half is for tables computed at once, which take up to four times as much while
# they are (measured), the other for those a posterior keeps; others are computed again when asked
# for.
MEMORY = 2**28
BATCH, KEPT = 2**22, 2**24
# Variables of a cluster that a message lists.
LISTED = 8


@dataclass(frozen=True)
class Room:
    """Limits of memory for the tables of many runs, in table entries summed over the runs.

    At most `batch` entries are computed at once: if the tables of all runs have more, the runs are
    worked through in parts. A posterior keeps its tables if they have at most `kept` entries, and
    else computes them again when they are asked for.
    """

    batch: int
    kept: int

    @classmethod
    def of(cls, memory: float | None, graph: ClusterGraph) -> Room:
        """The limits for `memory` bytes; for None the default ones, of 256 MiB.

        A `GraphError` refuses a value that is no finite positive number, or is too little for the
        tables of a single run.
        """
        if memory is None:
            return cls(BATCH, KEPT)
        if not is_number(memory) or not 0 < memory < math.inf:
            raise GraphError(f"memory= is a number of bytes, such as 2**30, not {memory!r}")
        room = cls(int(memory * BATCH / MEMORY), int(memory * KEPT / MEMORY))
        least = sum(graph.sizes)
        if room.batch < least:
            raise GraphError(
                f"memory={float(memory):g} is less than {MEMORY // BATCH * least:,} bytes, which a "
                f"single run may take: the tables of {titled(graph)} have {least:,} entries; give "
                "more, or ask pgm.query for what is wanted"
            )
        return room


def require_size(graph: ClusterGraph, entries: Sequence[int], what: str) -> None:
    """Refuse a graph whose clusters need more than `LIMIT` entries, or arrays of too many axes.

    `entries` has for each cluster the number of entries of its table or covariance; `what` names
    the arrays in the error's text ("tables", "covariances"). The error is a `GraphError`.
    """
    total = sum(entries)
    if total <= LIMIT:
        _require_axes(graph)
        return
    index = max(range(len(entries)), key=entries.__getitem__)
    raise GraphError(
        f"the {what} of the graph's {len(graph)} clusters are too large: together they take "
        f"{gibibytes(total)}, where {gibibytes(LIMIT)} is the limit, and inference takes {FACTOR} "
        f"times as much memory; the largest, of cluster {index} over "
        f"{_listed(graph.clusters[index])} takes {gibibytes(entries[index])}, "
        f"{amount(entries[index])} entries. {_advice(graph)}",
        cluster=index,
    )


def _advice(graph: ClusterGraph) -> str:
    """Advice, in words, on how to have smaller tables or covariances."""
    if not graph.is_tree:
        return "Give it smaller clusters"
    return (
        "Another elimination order may make smaller ones, pgm.compile(network, "
        "method=pgm.JunctionTree(pgm.StochasticMinFill(tries=2000))); a loopy graph has small "
        "ones, pgm.infer(pgm.compile(network, method=pgm.LTRIP()), evidence, "
        "schedule=pgm.Flooding()), but its beliefs are approximate; pgm.query(network, variables, "
        "evidence) takes no more of the network than a single answer needs"
    )


def _require_axes(graph: ClusterGraph) -> None:
    """Refuse, by a `GraphError`, a cluster of more discrete variables than arrays can have axes."""
    # Of two states each, so many variables would be refused above: most of them have one.
    if len(graph.network.variables) <= AXES or graph.width < AXES:
        return
    if not any(isinstance(v, Discrete) for v in graph.network.variables):
        return
    for cluster in graph.clusters:
        scope = tuple(v for v in cluster.scope if isinstance(v, Discrete))
        require_axes(scope, f"cluster {cluster.index}", cluster=cluster.index)


def require_runs(entries: int, runs: int, what: str) -> None:
    """Refuse an answer of `entries` array entries for each run, if all runs' exceed `LIMIT`.

    `what` names the answer in the error's text ("the joint of 3 variables"); the error is a
    `GraphError`.
    """
    if entries * runs > LIMIT:
        many = f" for {runs} runs" if runs > 1 else ""
        advice = "ask with fewer runs at once" if runs > 1 else "ask for less at once"
        fit = LIMIT // entries
        raise GraphError(
            f"{what} would take {gibibytes(entries * runs)}{many}, where "
            f"{gibibytes(LIMIT)} is the limit; {advice}" + (f", {fit} at the most" if fit else "")
        )


def _listed(cluster: Cluster) -> str:
    """The variables of a cluster, or the first eight of more, as text that ends with a comma."""
    scope = cluster.scope
    if len(scope) <= LISTED:
        return f"{names(scope)},"
    return f"{names(scope[:LISTED])[:-1]}, ...), {len(scope)} variables,"
