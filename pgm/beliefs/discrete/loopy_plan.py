"""The layout of rounds of messages on a graph of any shape, with like clusters in one call.

Clusters are alike if they have equally many neighbours and table entries. Message 2e goes along
sepset e, from the cluster of lower number to the other, message 2e + 1 back. A *round* is a set of
messages that are computed together, all from the messages before it. One array has all messages, in
*columns*: one for each joint state of a message's sepset, in C order.

A *group* is some clusters that are alike and send messages in a round. Its *products*, (neighbours
· entries of the group, runs), are the clusters' potentials times all messages to a cluster but one:
first those without the message of each cluster's first neighbour, at all entries of the group; then
those without the second neighbour's, and so on. A message is a sum of products.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.discrete.place import positions, steps
from pgm.beliefs.discrete.storage import contiguous
from pgm.clustergraph import ClusterGraph
from pgm.factors.axes import States, discrete, sizes, without
from pgm.kernels.arrays import Integers
from pgm.schedules import limits
from pgm.schedules.rounds import Directed

# Of each axis of a cluster, whether its variable is in the sepset.
Kept = tuple[bool, ...]


@dataclass(frozen=True, eq=False)
class Outlet:
    """Messages that the clusters of a group send, all of equally many columns.

    index: (summands, messages · columns): for each column of each message, the products of which it
        is the sum, as indices into the first axis of the group's products. All columns of the first
        message come first, then those of the second, and so on.
    columns: (messages, columns): the indices of the messages' columns in the array of all messages.
    order: (messages,): the place of each message in the round, from 0.
    senders: (messages,): the numbers of the clusters that send the messages.
    """

    index: Integers
    columns: Integers
    order: Integers
    senders: Integers


@dataclass(frozen=True, eq=False)
class Group:
    """Clusters with equally many neighbours and entries, computed in one batch, and their messages.

    In shapes, clusters · entries is the number of table entries of all clusters of the group.

    entries: (clusters · entries,): the index of each entry in the flat array of all tables.
    incoming: (neighbours, clusters · entries): for each entry, the column of each neighbour's
        message by which the entry is multiplied, as an index into the array of all messages.
    outlets: The messages that the clusters send in the round, those of equally many columns
        together.
    """

    entries: Integers
    incoming: Integers
    outlets: Sequence[Outlet]


class LoopyPlan:
    """The layout of a graph's messages and of its rounds.

    storage: The layout of the clusters' tables in one flat array.
    directed: The source and the target of each message.
    sepsets: Of each message, the variables of its sepset.
    widths, first: (messages,): of each message, the number of its columns, and the first of them.
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
        """The groups of the round in which all messages are sent, for so many runs at once.

        More runs make for fewer clusters in a group. So the layout is kept only until it is asked
        for with another number of runs.
        """
        if self._all is None or self._all[0] != runs:
            self._all = runs, self.lay_out(range(len(self.directed)), runs)
        return self._all[1]

    def lay_out(self, messages: Sequence[int], runs: int) -> list[Group]:
        """The groups of clusters that send some messages, which are given by number.

        The clusters of a group have equally many neighbours and entries. A group takes as many
        clusters as will keep its products, (neighbours · entries of the group, runs), at 2²²
        numbers (`limits.BATCH`) or fewer; it takes one cluster even if that has more.
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

        `asked` has for each cluster the messages that it is to send, as pairs (place of the message
        in the round, number of the message).
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
        """For each message to a cluster, the column that multiplies each entry of its table.

        The result, (messages, entries), has indices into the array of all messages. The messages
        are in the order of the cluster's neighbours, which send them.
        """
        return np.array(
            [
                self.first[message ^ 1] + self._shape(cluster, message)[1]
                for message in self.directed.outgoing[cluster]
            ]
        )

    def _shape(self, cluster: int, message: int) -> tuple[Integers, Integers]:
        """How entries of a cluster's table correspond to columns of a message from or to it.

        Returns two arrays of indices, in which entries are counted from the table's first, and
        columns from the message's first:

        - (summands, columns): for each column of the message, the entries that have its states;
        - (entries,): for each entry, the column that has its states.

        Both depend on the shape of the table and on the axes of the sepset alone, and are cached by
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
