"""The assignment to which max-product messages on a graph of any shape lead.

The belief of a cluster is its potential times all messages to it: of a tree, once no message
changes any more, the largest product of all factors for each of its joint states. States of single
variables, each the best by itself, need not belong to one assignment where several are equally
good. So the clusters are gone through from neighbour to neighbour, and each takes the best joint
state that agrees with the states chosen before.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np

from pgm.beliefs.discrete.loopy_messages import TableMessages
from pgm.clustergraph import ClusterGraph
from pgm.errors import NumericalError
from pgm.factors.axes import sizes
from pgm.factors.scope import in_run, names
from pgm.kernels.arrays import Array, Integers, Mask, unravelled
from pgm.variables import Discrete


def decoded(messages: TableMessages) -> tuple[dict[Discrete, Integers], Array]:
    """The states chosen, (runs,) by variable, and ln p(assignment, evidence) of theirs, (runs,).

    Of equally good states the first is chosen. ln p is the sum of all factors' logarithms at the
    assignment, and owes nothing to the messages.

    Raises
    ------
    EvidenceError
        If the belief of a cluster is zero throughout: no assignment is possible.
    NumericalError
        If all states that agree with those chosen before are impossible. On a graph with loops
        another choice might have been possible.
    """
    storage, graph, lead = messages.storage, messages.storage.graph, messages.evidence.lead
    beliefs = messages.belief_logs()
    lengths = np.array(graph.sizes)
    tops = np.maximum.reduceat(beliefs, np.cumsum(lengths) - lengths, 0)
    messages.require_possible(tops, np.arange(lengths.size))
    runs = np.arange(messages.runs)
    states: dict[Discrete, Integers] = {}
    log_probability = np.zeros(messages.runs)
    for cluster in _in_turn(graph):
        scope = storage.scopes[cluster]
        known = [v for v in scope if v in states]
        free = tuple(v for v in scope if v not in states)
        if free:
            order = [len(scope), *(scope.index(v) for v in (*known, *free))]
            table = storage.table(beliefs, cluster).transpose(order)
            table = table.reshape(*table.shape[: 1 + len(known)], -1)
            each = table[(runs, *(states[v] for v in known))]
            states |= dict(zip(free, unravelled(each.argmax(axis=1), sizes(free)), strict=True))
        own = (*(states[v] for v in scope), runs)
        level = storage.table(messages.potentials, cluster)[own]
        if (level == -np.inf).any():
            raise _dead_end(graph, cluster, (level == -np.inf).reshape(lead))
        log_probability += level
    return states, log_probability


def _dead_end(graph: ClusterGraph, cluster: int, lost: Mask) -> NumericalError:
    """The error where no state of a cluster agrees with those chosen, in the runs `lost`."""
    return NumericalError(
        f"max-product leads to no assignment of positive probability{in_run(lost)}: with the "
        f"states that the beliefs of other clusters chose, no state of cluster {cluster} over "
        f"{names(graph.clusters[cluster].scope)} is possible. Messages round loops may not tell "
        "several best assignments apart; try larger clusters, pgm.JoinGraph(max_size), another "
        "schedule or damping=, or a junction tree, pgm.compile(network), which is exact",
        cluster=cluster,
        run=int(lost.reshape(-1).argmax()) if lost.ndim else None,
    )


def _in_turn(graph: ClusterGraph) -> Iterator[int]:
    """The clusters, each but the first of its part after a neighbour."""
    seen: set[int] = set()
    for first in range(len(graph)):
        if first in seen:
            continue
        seen.add(first)
        waiting = deque([first])
        while waiting:
            cluster = waiting.popleft()
            yield cluster
            new = [k for k in graph.neighbours(cluster) if k not in seen]
            seen.update(new)
            waiting += new
