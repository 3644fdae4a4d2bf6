"""Messages between the clusters of a discrete network whose graph has any shape."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.evidence.static import BoundStates
from pgm.factors.axes import States, discrete, sizes, without
from pgm.inference import limits
from pgm.inference.discrete.place import positions, steps
from pgm.inference.discrete.storage import Storage, contiguous, enter_everywhere
from pgm.inference.discrete.tree_passes import contradicted
from pgm.inference.loopy import Directed
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.tables import exp, log_sum
from pgm.variables import Discrete


class TableMessages:
    """The messages of a graph as logarithms; each sums to one. All arrays end in the axis of runs.

    A message is the sum of the sender's potential times all messages to it but the receiver's,
    each product made without division: it may have zeros.
    """

    def __init__(self, graph: ClusterGraph, evidence: BoundStates, damping: float) -> None:
        _require_room(graph, evidence)
        self.plan = graph.derived(LoopyPlan)
        self.storage = self.plan.storage
        self.directed = self.plan.directed
        self.evidence = evidence
        self.damping = damping
        self.runs = evidence.runs
        self.potentials = enter_everywhere(self.storage, evidence)
        equal = np.repeat(-np.log(self.plan.widths), self.plan.widths)
        self.logs = np.repeat(equal[:, None], self.runs, axis=1)
        self._proposed = np.empty_like(self.logs)

    @property
    def bounded(self) -> bool:
        """A probability changes by one at the most."""
        return True

    def round(self, messages: Sequence[int]) -> Sequence[Group]:
        """Lay out the computation of some messages."""
        if messages == range(len(self.directed)):
            return self.plan.everything(self.runs)
        return self.plan.lay_out(messages, self.runs)

    def propose(self, round: Sequence[Group]) -> Array:
        """Compute them from those kept; the largest changes of their entries, (messages, runs)."""
        count = sum(outlet.order.size for group in round for outlet in group.outlets)
        change = np.empty((count, self.runs))
        for group in round:
            products = self._products(group)
            for outlet in group.outlets:
                sums: Array = log_sum(products.take(outlet.index, 0), 0)
                new = self._normalised(sums.reshape(*outlet.columns.shape, self.runs), outlet)
                old = self.logs[outlet.columns]
                change[outlet.order] = np.abs(exp(new) - exp(old)).max(axis=1)
                self._proposed[outlet.columns] = new
        return change

    def _products(self, group: Group) -> Array:
        """The potential times all messages but that of one neighbour, of each in turn."""
        incoming = self.logs.take(group.incoming, 0)
        products = np.empty_like(incoming)
        products[0] = self.potentials.take(group.entries, 0)
        products[1:] = incoming[:-1]
        np.add.accumulate(products, 0, out=products)
        after = np.add.accumulate(incoming[:0:-1], 0)
        products[:-1] += after[::-1]
        return products.reshape(-1, self.runs)

    def _normalised(self, messages: Array, outlet: Outlet) -> Array:
        total = log_sum(messages, 1)
        self._require_possible(total, outlet.senders)
        normalised: Array = messages - total[:, None]
        return normalised

    def _require_possible(self, totals: Array, clusters: Integers) -> None:
        empty = totals == -np.inf
        if empty.any():
            found = [self.storage.graph.clusters[k] for k in clusters.tolist()]
            raise contradicted(empty, found, self.evidence.lead)

    def accept(self, round: Sequence[Group], active: Mask, lost: Mask) -> None:
        """Keep what was proposed, damped, for the runs that are active, (runs,)."""
        for group in round:
            for outlet in group.outlets:
                new, old = self._proposed[outlet.columns], self.logs[outlet.columns]
                if self.damping:
                    new = self._normalised((1.0 - self.damping) * new + self.damping * old, outlet)
                self.logs[outlet.columns] = np.where(active, new, old)

    def relinearise(self, active: Mask) -> None:
        """Tables have nothing to linearise."""
        return

    def beliefs(self) -> tuple[Array, Array]:
        """The clusters' beliefs as probabilities, (entries, runs); logarithms of their sums.

        The beliefs stand as in the storage; the sums are (clusters, runs).
        """
        logs = self.potentials.copy()
        for group in self.plan.everything(self.runs):
            logs[group.entries] += self.logs.take(group.incoming, 0).sum(axis=0)
        lengths = np.array(self.storage.graph.sizes)
        totals = _segments(logs, lengths)
        self._require_possible(totals, np.arange(lengths.size))
        return exp(logs - totals.repeat(lengths, 0)), totals

    def log_evidence(self, totals: Array) -> Array:
        """The Bethe value Σ ln Z_cluster − Σ ln Z_sepset, (runs,)."""
        value: Array = totals.sum(axis=0)
        widths = self.plan.widths
        if widths.size:
            owner = np.repeat(np.arange(widths.size), widths)
            there, back = self.logs[owner % 2 == 0], self.logs[owner % 2 == 1]
            sepsets = _segments(there + back, widths[::2])
            self._require_possible(sepsets, self.directed.source[::2])
            value = value - sepsets.sum(axis=0)
        return value


def _require_room(graph: ClusterGraph, evidence: BoundStates) -> None:
    # A cluster's table is multiplied by the messages of all neighbours but each in turn: where
    # these meet it is laid out for all clusters, the products are made for some at once.
    products = [size * max(1, len(graph.neighbours(k))) for k, size in enumerate(graph.sizes)]
    limits.require_size(graph, products, "tables, one for each message that a cluster sends,")
    entries = sum(graph.sizes) + max(products)
    limits.require_runs(entries, evidence.runs, "messages round the graph")


def _segments(logs: Array, lengths: Integers) -> Array:
    """The value ln Σ exp over consecutive rows, (segments, runs)."""
    first = np.cumsum(lengths) - lengths
    top = np.maximum.reduceat(logs, first, 0)
    top = np.where(top == -np.inf, 0.0, top)
    with np.errstate(divide="ignore"):
        total: Array = np.log(np.add.reduceat(exp(logs - top.repeat(lengths, 0)), first, 0))
    return total + top


@dataclass(frozen=True, eq=False)
class LoopyBeliefs:
    """The beliefs that messages make."""

    messages: TableMessages
    storage: Storage
    evidence: BoundStates
    _tables: Array
    _totals: Array

    @classmethod
    def of(cls, messages: TableMessages) -> LoopyBeliefs:
        """Multiply the messages into the potentials."""
        tables, totals = messages.beliefs()
        if messages.runs == 1:
            tables = tables[:, 0]
        return cls(messages, messages.storage, messages.evidence, tables, totals)

    @cached_property
    def _marginals(self) -> Array:
        return self.storage.marginals.read(self._tables)

    def marginal(self, variable: Discrete) -> Array:
        """The probabilities of a variable, (states, [runs])."""
        return self._marginals[self.storage.marginals.where[variable]]

    def read(self, reader: Callable[[Array], Array]) -> Array:
        """The result of a function of the tables, whose last axis, if any, is of runs."""
        return reader(self._tables)

    def log_evidence(self) -> Array:
        """The Bethe value, (runs,)."""
        return self.messages.log_evidence(self._totals)

    def log_total(self, cluster: int) -> Array:
        """The logarithm of the sum of a cluster's unnormalised belief, (runs,)."""
        total: Array = self._totals[cluster]
        return total

    def message(self, source: int, target: int) -> tuple[Array, None]:
        """The message from one cluster to a neighbour, (sizes..., runs), which sums to one."""
        plan, graph = self.messages.plan, self.storage.graph
        edge = min(source, target), max(source, target)
        number = 2 * list(graph.sepsets).index(edge) + (source > target)
        first = plan.first[number]
        logs = self.messages.logs[first : first + plan.widths[number]]
        return exp(logs).reshape((*sizes(plan.sepsets[number]), -1)), None


# Which axes of a cluster its sepset has.
Kept = tuple[bool, ...]


@dataclass(frozen=True, eq=False)
class Outlet:
    """Messages of one shape that a group of clusters sends.

    index: (rows, messages · columns): the entries, of all but one neighbour's product, to sum.
    columns: (messages, columns): where the messages are kept.
    order: (messages,): which of the round's messages they are.
    senders: (messages,): the clusters that send them.
    """

    index: Integers
    columns: Integers
    order: Integers
    senders: Integers


@dataclass(frozen=True, eq=False)
class Group:
    """Clusters with equally many neighbours and entries, and the messages asked of them.

    entries: (clusters · entries,): where their tables stand.
    incoming: (neighbours, clusters · entries): the columns of messages that meet each entry.
    """

    entries: Integers
    incoming: Integers
    outlets: Sequence[Outlet]


class LoopyPlan:
    """Lays out rounds of messages of a graph."""

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
        """All messages; laid out once for a number of runs."""
        if self._all is None or self._all[0] != runs:
            self._all = runs, self.lay_out(range(len(self.directed)), runs)
        return self._all[1]

    def lay_out(self, messages: Sequence[int], runs: int) -> list[Group]:
        """Group the sources of some messages by shape."""
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
        return np.array(
            [
                self.first[message ^ 1] + self._shape(cluster, message)[1]
                for message in self.directed.outgoing[cluster]
            ]
        )

    def _shape(self, cluster: int, message: int) -> tuple[Integers, Integers]:
        """The sum of a cluster's entries to a sepset, and the column that meets each.

        Entries (rows, columns), and columns (entries,); they depend on shapes alone.
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
