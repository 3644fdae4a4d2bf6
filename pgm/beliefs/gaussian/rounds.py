"""Rounds of messages: which rows each batched elimination gathers, and where its result goes.

The factor of a CPD, or of a message, is exp(−½ ‖A ξ − r‖²) over some hidden components ξ. Its
*rows* are those of the matrix A, each with its right side in r. The rows of all CPDs and messages
stand in one buffer: the *entries* of the matrices along one axis, the right sides along another,
with one for each row. An *elimination* gathers the rows of a cluster's CPDs and of messages to it,
by indices along both axes, and integrates some columns of A out, which are components of the
cluster.

The *place* of a component is its index in the vector of all hidden components; its *column* is its
index in the scope of a cluster. A *group* is made of copies of one CPD, whose factors have one
shape.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.beliefs.gaussian.assembly import Assembly
from pgm.beliefs.gaussian.layout import Layout
from pgm.factors.scope import dimension
from pgm.kernels.arrays import Integers


@dataclass(frozen=True, eq=False)
class Stack:
    """Batched eliminations of one shape: B outgoing messages, or beliefs, of some clusters.

    `members` (B,) are the numbers of the outgoing messages, or of the clusters whose beliefs are
    made. `clusters` (B,) are the numbers of the clusters at which the eliminations are made: the
    rows of a cluster's CPDs, and of messages to it, are gathered.

    The n components of a cluster are in an order of the stack's own, in which the first `drop` are
    integrated out: `components` (B, n) has their places, `columns` (B, n) their columns in the
    scope. The matrices of the k gathered rows stand in the buffer at `entries` (B, k, n), the right
    sides at `rows` (B, k), and the log-scales at `logs` (B, 1 + inputs): first that of the
    cluster's CPDs, then those of the messages that are gathered.

    Stacks of fronts have `padded` (B,) columns more that are integrated out, which stand for no
    component: their unit rows make them independent of all others. Their place is the number of
    components, their column −1.
    """

    members: Integers
    clusters: Integers
    drop: int
    components: Integers
    columns: Integers
    entries: Integers
    rows: Integers
    logs: Integers
    padded: Integers | int = 0

    @property
    def kept(self) -> int:
        """The number of columns that are not integrated out: those of the sepset; 0 of a belief."""
        return int(self.components.shape[1] - self.drop)


@dataclass(frozen=True, eq=False)
class Rounds:
    """Where the rows of a layout's factors and messages stand in one buffer.

    The factors of the CPDs come first, group by group, then the messages, each with as many rows as
    its sepset has components, then a single zero, to which indices of absent entries and rows
    point.
    """

    layout: Layout

    @property
    def assembly(self) -> Assembly:
        """The factors of the layout."""
        return self.layout.assembly

    @cached_property
    def sizes(self) -> Integers:
        """The number of components of each message's sepset, (messages,)."""
        sizes = [dimension(scope) for scope in self.layout.sepsets]
        return np.repeat(np.array(sizes, dtype=np.intp), 2)

    @cached_property
    def entry_starts(self) -> Integers:
        """The index of each message's first entry, and of the zero, (messages + 1,)."""
        return int(self.assembly.entry_starts[-1]) + np.cumsum([0, *(self.sizes**2)])

    @cached_property
    def row_starts(self) -> Integers:
        """The index of each message's first row, and of the zero, (messages + 1,)."""
        return int(self.assembly.row_starts[-1]) + np.cumsum([0, *self.sizes])

    @property
    def logs(self) -> int:
        """How many log-scales the buffer has: of the clusters' CPDs, of messages, and a zero."""
        return len(self.layout.scopes) + len(self.layout.directed) + 1

    @cached_property
    def of_cluster(self) -> Integers:
        """The number of the log-scale of each cluster's CPDs, (clusters,)."""
        return np.arange(len(self.layout.scopes))

    @cached_property
    def by_size(self) -> list[tuple[int, Integers]]:
        """Pairs (s, messages): the numbers of all messages over sepsets of s components."""
        every = np.unique(self.sizes).tolist()
        return [(size, np.flatnonzero(self.sizes == size)) for size in every]

    @cached_property
    def _factors(self) -> list[list[tuple[Integers, Integers]]]:
        """For each cluster a list: of each of its CPDs a pair of arrays of indices into the buffer.

        The first, (k, n), are those of the entries of the CPD's k rows, over the n columns of the
        cluster in the order of its scope; indices in columns that the CPD lacks point at the zero.
        The second, (k,), are those of the right sides.
        """
        found: list[list[tuple[Integers, Integers]]] = [[] for _ in self.layout.scopes]
        assembly = self.assembly
        starts = assembly.entry_starts[:-1].tolist(), assembly.row_starts[:-1].tolist()
        for factors, entry, first in zip(assembly.factors, *starts, strict=True):
            height, scope = factors.height, factors.places
            size = height * scope.shape[1]
            for row, cluster in enumerate(factors.clusters.tolist()):
                block = self._block(cluster, scope[row], entry + row * size, height)
                found[cluster].append((block, first + row * height + np.arange(height)))
        return found

    @cached_property
    def _arriving(self) -> list[tuple[Integers, Integers]]:
        """For each message a pair: the buffer's indices of its entries (s, n) and right sides (s,).

        s counts the components of the sepset, n the columns of the cluster that the message goes
        to, in the order of its scope. Indices in columns outside the sepset point at the zero.
        """
        found = []
        for message, target in enumerate(self.layout.directed.target.tolist()):
            size = int(self.sizes[message])
            places = self.layout.components(self.layout.sepsets[message // 2])
            block = self._block(target, places, int(self.entry_starts[message]), size)
            found.append((block, self.row_starts[message] + np.arange(size)))
        return found

    def _block(self, cluster: int, places: Integers, first: int, height: int) -> Integers:
        """The buffer's indices, (height, n), of entries of `height` rows in a cluster's n columns.

        In the buffer the rows stand from entry `first` on, over the components at `places` only;
        indices in other columns point at the zero.
        """
        columns = self.layout.columns[cluster]
        block = np.full((height, len(columns)), self.entry_starts[-1])
        inside = np.arange(height * places.size).reshape(height, places.size)
        block[:, [columns[place] for place in places.tolist()]] = first + inside
        return block

    def messages(self, wanted: Sequence[int]) -> list[Stack]:
        """The eliminations that compute some messages, by number.

        Each gathers the rows of the source cluster's CPDs and of all messages to it but the target
        cluster's, and integrates out the components that are not in the sepset.
        """
        layout, directed = self.layout, self.layout.directed
        kept = (layout.components(layout.sepsets[m // 2]).tolist() for m in wanted)
        sources = directed.source[list(wanted)].tolist()
        return self._stacks(zip(wanted, sources, map(directed.inputs, wanted), kept, strict=True))

    def beliefs(self, clusters: Iterable[int]) -> list[Stack]:
        """The eliminations that compute the beliefs of some clusters.

        Each gathers the rows of the cluster's CPDs and of all messages to it, and integrates out
        all columns.
        """
        outgoing = self.layout.directed.outgoing
        return self._stacks([(i, i, [m ^ 1 for m in outgoing[i]], []) for i in clusters])

    def potentials(self, clusters: Iterable[int]) -> list[Stack]:
        """Stacks that gather the rows of the CPDs of some clusters, without messages to them.

        As for beliefs, `drop` counts all columns; they are in the order of the cluster's scope.
        """
        return self._stacks([(i, i, [], []) for i in clusters])

    @cached_property
    def all_beliefs(self) -> list[Stack]:
        """The eliminations that compute the beliefs of every cluster; see `beliefs`."""
        return self.beliefs(range(len(self.layout.scopes)))

    def _stacks(self, tasks: Iterable[tuple[int, int, list[int], list[int]]]) -> list[Stack]:
        """Lay out eliminations, in stacks of one shape.

        A task is the number of a message or cluster, the cluster whose CPDs are gathered, the
        numbers of the messages to gather, and the places of the components to keep. Tasks with
        equal numbers of columns, and of columns kept, and about as many rows make one stack. The
        columns that are integrated out come first. Where a task has fewer rows than others of its
        stack, the indices of the absent rows point at the zero.
        """
        count = len(self.layout.scopes)
        zero, zero_row = int(self.entry_starts[-1]), int(self.row_starts[-1])
        zero_log = count + len(self.layout.directed)
        alike = defaultdict(list)
        for member, cluster, inputs, kept in tasks:
            blocks = [*self._factors[cluster], *(self._arriving[m] for m in inputs)]
            rows, size = sum(len(right) for _, right in blocks), len(self.layout.columns[cluster])
            # Stacks are padded with zero rows: few shapes, at most twice the rows.
            room = max(size, 1 << max(rows - 1, 0).bit_length(), 1)
            alike[size, len(kept), room].append((member, cluster, inputs, kept, blocks, rows))
        stacks = []
        for (size, kept_size, _), members in alike.items():
            room = max(size, *(rows for *_, rows in members))
            width = 1 + max(len(inputs) for _, _, inputs, *_ in members)
            entries = np.full((len(members), room, size), zero)
            right = np.full((len(members), room), zero_row)
            logs = np.full((len(members), width), zero_log)
            columns = np.empty((len(members), size), dtype=np.intp)
            components = np.empty((len(members), size), dtype=np.intp)
            for b, (_, cluster, inputs, kept, blocks, rows) in enumerate(members):
                places, last = self.layout.columns[cluster], set(kept)
                components[b] = [place for place in places if place not in last] + kept
                columns[b] = [places[place] for place in components[b].tolist()]
                if blocks:
                    own, sides = map(np.concatenate, zip(*blocks, strict=True))
                    entries[b, :rows], right[b, :rows] = own[:, columns[b]], sides
                logs[b, 0] = cluster
                logs[b, 1 : 1 + len(inputs)] = [count + m for m in inputs]
            stacks.append(
                Stack(
                    np.array([member for member, *_ in members], dtype=np.intp),
                    np.array([cluster for _, cluster, *_ in members], dtype=np.intp),
                    size - kept_size,
                    components,
                    columns,
                    entries,
                    right,
                    logs,
                )
            )
        return stacks
