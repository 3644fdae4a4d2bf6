"""The layout of rounds of messages on a graph of any shape, with like clusters in one call.

Message 2e goes along sepset e, from the lower cluster to the higher, 2e + 1 back. A *round* is some
messages that are computed together, from those kept. One array keeps all messages, in *columns*:
one for each joint state of a message's sepset, in C order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.factors.axes import States, discrete, sizes, without
from pgm.inference import limits
from pgm.inference.discrete.place import positions, steps
from pgm.inference.discrete.storage import contiguous
from pgm.inference.loopy import Directed
from pgm.kernels.arrays import Integers

# Of each axis of a cluster, whether its variable is in the sepset.
Kept = tuple[bool, ...]


@dataclass(frozen=True, eq=False)
class Outlet:
    """The outgoing messages of equal shape from a group of clusters.

    index: (rows, messages · columns): the messages are the sums over the first axis of these rows
        of `TableMessages._products`.
    columns: (messages, columns): where the messages are kept.
    order: (messages,): the place of each in the round, from 0.
    senders: (messages,): the clusters that send them.
    """

    index: Integers
    columns: Integers
    order: Integers
    senders: Integers


@dataclass(frozen=True, eq=False)
class Group:
    """Clusters with equally many neighbours and entries, computed in one batch, and their messages.

    entries: (clusters · entries,): where the entries of their tables stand in the flat storage.
    incoming: (neighbours, clusters · entries): of each entry, the column of each neighbour's
        message that multiplies it.
    outlets: The messages that they send in the round.
    """

    entries: Integers
    incoming: Integers
    outlets: Sequence[Outlet]


class LoopyPlan:
    """The layout of a graph's messages and of its rounds.

    sepsets: Of each message, the variables that it is over.
    widths, first: (messages,): the number of its columns, and the first of them.
    """

    def __init__(self, graph: ClusterGraph) -> None:
        self.storage, self.directed = contiguous(graph), Directed.of(graph)
        edges = graph.sepsets.values()
        self.sepsets: list[States] = [discrete(s) for s in edges for _ in range(2)]
        self.widths = np.array([math.prod(sizes(s)) for s in self.sepsets], dtype=np.intp)
        self.first = np.cumsum(self.widths) - self.widths
        self._slot = {m: k for found in self.directed.outgoing for k, m in enumerate(found)}
        self._all: tuple[int, list[Group]] | None = None
        self._shapes: dict[tuple[tuple[int, ...], Kept], tuple[Integers, Integers]] = {}

    def everything(self, runs: int) -> list[Group]:
        """The round of all messages, laid out once for a number of runs."""
        if self._all is None or self._all[0] != runs:
            self._all = runs, self.lay_out(range(len(self.directed)), runs)
        return self._all[1]

    def lay_out(self, messages: Sequence[int], runs: int) -> list[Group]:
        """The groups of clusters that compute some messages, given by number.

        Their senders are grouped by their numbers of neighbours and of entries. A group has as many
        clusters as keep its products, for so many `runs` together, within a limit, or one.
        """
        asked: dict[int, list[tuple[int, int]]] = {}
        for order, message in enumerate(messages):
            asked.setdefault(int(self.directed.source[message]), []).append((order, message))
        kinds: dict[tuple[int, int], list[int]] = {}
        for cluster in asked:
            degree = len(self.directed.outgoing[cluster])
            kinds.setdefault((degree, self.storage.graph.sizes[cluster]), []).append(cluster)
        groups = []
        for (degree, entries), clusters in kinds.items():
            some = max(1, limits.BATCH // (degree * entries * runs))
            for at in range(0, len(clusters), some):
                groups.append(self._group(clusters[at : at + some], asked))
        return groups

    def _group(self, clusters: list[int], asked: dict[int, list[tuple[int, int]]]) -> Group:
        """The group of some clusters with equally many entries and neighbours.

        `asked` gives, of each cluster, pairs (place in the round, number) of messages that it is to
        send.
        """
        size = self.storage.graph.sizes[clusters[0]]
        total = size * len(clusters)
        places = [self.storage.places[k] for k in clusters]
        entries = [place.positions(place.scope).ravel() for place in places]
        incoming = [self._incoming(k) for k in clusters]
        shapes: dict[int, list[tuple[int, int, Integers]]] = {}
        for place, cluster in enumerate(clusters):
            for order, message in asked[cluster]:
                start = self._slot[message] * total + place * size
                rows = start + self._shape(cluster, message)[0]
                shapes.setdefault(rows.shape[1], []).append((order, message, rows))
        outlets = [
            Outlet(
                np.concatenate([rows for _, _, rows in found], axis=1),
                np.array([self.first[m] + np.arange(width) for _, m, _ in found]),
                np.array([order for order, _, _ in found]),
                self.directed.source[[m for _, m, _ in found]],
            )
            for width, found in shapes.items()
        ]
        return Group(np.concatenate(entries), np.concatenate(incoming, axis=1), outlets)

    def _incoming(self, cluster: int) -> Integers:
        """The columns of messages to a cluster that multiply its entries, (messages, entries)."""
        return np.array(
            [
                self.first[message ^ 1] + self._shape(cluster, message)[1]
                for message in self.directed.outgoing[cluster]
            ]
        )

    def _shape(self, cluster: int, message: int) -> tuple[Integers, Integers]:
        """How a cluster's entries are summed to a message, and which column meets each entry.

        The first is a matrix of the indices of the cluster's entries, from 0, (rows, columns); the
        sum of these entries over the rows is the message. The second is the column of each entry,
        (entries,), counted from the message's first. Both depend on shapes alone and are cached by
        these.
        """
        scope, sepset = self.storage.scopes[cluster], self.sepsets[message]
        kept = tuple(v in sepset for v in scope)
        key = sizes(scope), kept
        if key not in self._shapes:
            # Sepsets and clusters both have the network's order.
            rows = positions(0, steps(scope, 1), (*without(scope, sepset), *sepset))
            columns = positions(0, steps(sepset, 1), scope)
            self._shapes[key] = rows.reshape(-1, self.widths[message]), columns.ravel()
        return self._shapes[key]
