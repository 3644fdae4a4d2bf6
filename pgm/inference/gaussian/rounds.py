"""Rounds of messages: which rows each batched elimination gathers, and where its result goes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.factors.scope import dimension
from pgm.inference.gaussian.layout import Layout
from pgm.kernels.arrays import Integers


@dataclass(frozen=True, eq=False)
class Stack:
    """Eliminations of one shape: messages that some clusters send, or the beliefs of clusters.

    Attributes
    ----------
    members : ndarray of int
        (B,): the messages, or the clusters.
    clusters : ndarray of int
        (B,): the clusters whose factors are taken.
    drop : int
        How many of a cluster's columns are integrated out.
    components : ndarray of int
        (B, n): the columns' places among all hidden components, those to be dropped first.
    columns : ndarray of int
        (B, n): where they stand in the cluster's scope.
    entries, rows : ndarray of int
        (B, k, n) and (B, k): which entries and right sides of the buffer the factor is made of.
    logs : ndarray of int
        (B, 1 + inputs): which log-scales add up: the cluster's, then its messages'.
    """

    members: Integers
    clusters: Integers
    drop: int
    components: Integers
    columns: Integers
    entries: Integers
    rows: Integers
    logs: Integers

    @property
    def kept(self) -> int:
        """The number of columns left: the sepset's components."""
        return int(self.components.shape[1] - self.drop)


@dataclass(frozen=True, eq=False)
class Rounds:
    """Where the rows of a layout's factors and messages stand in one buffer.

    The factors of the CPDs come first, then the messages, each with as many rows as its sepset has
    components, then a zero.
    """

    layout: Layout

    @cached_property
    def sizes(self) -> Integers:
        """For each message, the components of its sepset."""
        sizes = [dimension(scope) for scope in self.layout.sepsets]
        return np.repeat(np.array(sizes, dtype=np.intp), 2)

    @cached_property
    def own_entries(self) -> int:
        """Entries of the CPDs' factors."""
        groups = self.layout.groups
        return sum(len(g.cpds) * g.height * g.width for g in groups)

    @cached_property
    def own_rows(self) -> int:
        """Rows of the CPDs' factors."""
        return sum(len(g.cpds) * g.height for g in self.layout.groups)

    @cached_property
    def entry_starts(self) -> Integers:
        """Where each message's entries begin, and the zero."""
        return self.own_entries + np.cumsum([0, *(self.sizes**2)])

    @cached_property
    def row_starts(self) -> Integers:
        """Where each message's rows begin, and the zero."""
        return self.own_rows + np.cumsum([0, *self.sizes])

    @cached_property
    def by_size(self) -> list[tuple[int, Integers]]:
        """The messages of each size of sepsets."""
        every = np.unique(self.sizes).tolist()
        return [(size, np.flatnonzero(self.sizes == size)) for size in every]

    @cached_property
    def _factors(self) -> list[tuple[list[Integers], list[Integers]]]:
        """For each cluster, the entries (rows, n) and right sides of its CPDs."""
        layout, zero = self.layout, self.entry_starts[-1]
        found: list[tuple[list[Integers], list[Integers]]] = [([], []) for _ in layout.scopes]
        for group in layout.groups:
            height, width = group.height, group.width
            scope = np.concatenate([group.child, group.parents], axis=1)
            inside = np.arange(height * width).reshape(height, width)
            for row, cluster in enumerate(group.clusters.tolist()):
                columns = layout.columns[cluster]
                block = np.full((height, len(columns)), zero)
                block[:, [columns[place] for place in scope[row].tolist()]] = (
                    group.entries + row * height * width + inside
                )
                found[cluster][0].append(block)
                found[cluster][1].append(group.rows + row * height + np.arange(height))
        return found

    @cached_property
    def _arriving(self) -> list[tuple[Integers, Integers]]:
        """For each message, its entries in the columns of its target, and its right sides."""
        layout, zero = self.layout, self.entry_starts[-1]
        found = []
        for message, target in enumerate(layout.directed.target.tolist()):
            size = int(self.sizes[message])
            columns = layout.columns[target]
            block = np.full((size, len(columns)), zero)
            places = layout.components(layout.sepsets[message // 2]).tolist()
            block[:, [columns[place] for place in places]] = self.entry_starts[message] + np.arange(
                size * size
            ).reshape(size, size)
            found.append((block, self.row_starts[message] + np.arange(size)))
        return found

    def messages(self, wanted: Sequence[int]) -> list[Stack]:
        """The elimination of some messages from what their sources know, but for the target."""
        directed = self.layout.directed
        tasks = [
            (
                message,
                int(directed.source[message]),
                directed.inputs(message),
                self.layout.components(self.layout.sepsets[message // 2]).tolist(),
            )
            for message in wanted
        ]
        return self._stacks(tasks)

    def beliefs(self, clusters: Iterable[int]) -> list[Stack]:
        """The elimination of everything in some clusters, from all that they know."""
        outgoing = self.layout.directed.outgoing
        return self._stacks([(i, i, [m ^ 1 for m in outgoing[i]], []) for i in clusters])

    @cached_property
    def all_beliefs(self) -> list[Stack]:
        """The elimination of everything in every cluster."""
        return self.beliefs(range(len(self.layout.scopes)))

    def _stacks(self, tasks: Iterable[tuple[int, int, list[int], list[int]]]) -> list[Stack]:
        count = len(self.layout.scopes)
        zero, zero_row = int(self.entry_starts[-1]), int(self.row_starts[-1])
        zero_log = count + len(self.layout.directed)
        alike: dict[tuple[int, int, int], list[tuple[int, int, list[int], list[int], int]]]
        alike = defaultdict(list)
        for member, cluster, inputs, kept in tasks:
            rows = sum(block.shape[0] for block in self._factors[cluster][0])
            rows += sum(int(self.sizes[m]) for m in inputs)
            size = len(self.layout.columns[cluster])
            # Stacks are padded with zero rows: few shapes, at most twice the rows.
            room = max(size, 1 << max(rows - 1, 0).bit_length(), 1)
            alike[size, len(kept), room].append((member, cluster, inputs, kept, rows))
        stacks = []
        for (size, kept_size, _), members in alike.items():
            room = max(size, *(rows for *_, rows in members))
            width = 1 + max(len(inputs) for _, _, inputs, _, _ in members)
            entries = np.full((len(members), room, size), zero)
            right = np.full((len(members), room), zero_row)
            logs = np.full((len(members), width), zero_log)
            columns = np.empty((len(members), size), dtype=np.intp)
            components = np.empty((len(members), size), dtype=np.intp)
            for b, (_, cluster, inputs, kept, _) in enumerate(members):
                own, own_right = self._factors[cluster]
                blocks = [*own, *(self._arriving[m][0] for m in inputs)]
                rights = [*own_right, *(self._arriving[m][1] for m in inputs)]
                places = self.layout.columns[cluster]
                order = [place for place in places if place not in set(kept)] + kept
                columns[b] = [places[place] for place in order]
                components[b] = order
                if blocks:
                    block = np.concatenate(blocks)
                    entries[b, : len(block)] = block[:, columns[b]]
                    right[b, : len(block)] = np.concatenate(rights)
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
