"""The hidden components of a network, its CPDs in groups, and the places of their rows."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.cpds import CPD, ConditionalGaussian
from pgm.factors.scope import Scope, dimension
from pgm.inference.loopy import Directed
from pgm.kernels.arrays import Integers
from pgm.networks import BayesianNetwork
from pgm.variables import Variable


def known_parents(cpd: CPD, inputs: Collection[Variable]) -> list[Variable]:
    """The parents of a CPD that must have evidence: inputs, and what its noise depends on."""
    return [v for v in cpd.parents if v in inputs or v in cpd.noise_given]


def barren(network: BayesianNetwork, evidence: Collection[Variable]) -> frozenset[Variable]:
    """The variables that inference leaves out: inputs without evidence, and their CPDs' children.

    These stay if something observed or kept depends on them.
    """
    inputs = set(network.inputs)
    used = {v for cpd in network.cpds if cpd.child in evidence for v in cpd.parents}
    absent: set[Variable] = set()
    for cpd in reversed(network.cpds):
        missing = [v for v in known_parents(cpd, inputs) if v not in evidence]
        if missing and cpd.child not in evidence and cpd.child not in used:
            absent.add(cpd.child)
            absent.update(v for v in missing if v in inputs)
        else:
            used.update(cpd.parents)
    return frozenset(absent - used)


@dataclass(frozen=True, eq=False)
class Group:
    """CPDs that are copies of one, with the same parents hidden: one linearisation, many rows.

    `child` (rows, d), empty if observed, and `parents` (rows, n) are places among all hidden
    components; `clusters` (rows,) the clusters that the CPDs are assigned to.
    """

    cpds: tuple[ConditionalGaussian, ...]
    hidden: Scope
    observed: bool
    child: Integers
    parents: Integers
    clusters: Integers

    @property
    def height(self) -> int:
        """Rows of each CPD's factor: the child's components."""
        return self.cpds[0].child.dimension

    @property
    def width(self) -> int:
        """Columns of each CPD's factor: the hidden components of the family."""
        return int(self.child.shape[1] + self.parents.shape[1])

    def shape(self) -> tuple[bool, int, int]:
        """Whether the children are observed; rows and columns."""
        return self.observed, self.height, self.width


@dataclass(frozen=True, eq=False)
class Layout:
    """A cluster graph without its observed variables and those `absent`, in components.

    Made once for each set of observed variables; see `ClusterGraph.derived`.
    """

    graph: ClusterGraph
    observed: frozenset[Variable]
    absent: frozenset[Variable]

    @cached_property
    def hidden(self) -> Scope:
        """The variables without evidence, parents before children."""
        return self.without_evidence(self.graph.network.variables)

    @cached_property
    def places(self) -> dict[Variable, Integers]:
        """The places of each hidden variable's components among all of them."""
        starts = np.cumsum([0, *(v.dimension for v in self.hidden)])
        return {v: np.arange(a, a + v.dimension) for v, a in zip(self.hidden, starts, strict=False)}

    @cached_property
    def size(self) -> int:
        """Number of hidden components."""
        return dimension(self.hidden)

    def components(self, scope: Scope) -> Integers:
        """The places of some hidden variables' components."""
        if not scope:
            return np.zeros(0, dtype=np.intp)
        return np.concatenate([self.places[v] for v in scope])

    def without_evidence(self, scope: Scope) -> Scope:
        """The hidden ones of some variables."""
        return tuple(v for v in scope if v not in self.observed and v not in self.absent)

    @cached_property
    def scopes(self) -> list[Scope]:
        """The hidden variables of each cluster."""
        return [self.without_evidence(cluster.scope) for cluster in self.graph.clusters]

    @cached_property
    def columns(self) -> list[dict[int, int]]:
        """For each cluster, the column of each component that it holds."""
        return [
            {int(place): k for k, place in enumerate(self.components(scope))}
            for scope in self.scopes
        ]

    def columns_of(self, clusters: Integers, places: Integers) -> Integers:
        """The places of components (B, n) in the scopes of clusters (B,)."""
        pairs = zip(clusters.tolist(), places.tolist(), strict=True)
        found = [[self.columns[cluster][place] for place in row] for cluster, row in pairs]
        return np.array(found, dtype=np.intp).reshape(places.shape)

    @cached_property
    def directed(self) -> Directed:
        """The messages."""
        return Directed.of(self.graph)

    @cached_property
    def sepsets(self) -> list[Scope]:
        """The hidden variables of each edge's sepset."""
        return [self.without_evidence(scope) for scope in self.graph.sepsets.values()]

    @property
    def _cpds(self) -> Iterator[ConditionalGaussian]:
        for cpd in self.graph.network.cpds:
            assert isinstance(cpd, ConditionalGaussian)
            if cpd.child not in self.absent:
                yield cpd

    @cached_property
    def groups(self) -> list[Group]:
        """The CPDs, by what they are copies of and which parents are hidden."""
        home = {cpd.child: cluster.index for cluster in self.graph.clusters for cpd in cluster.cpds}
        alike: dict[tuple[CPD, tuple[bool, ...], bool], list[ConditionalGaussian]] = {}
        for cpd in self._cpds:
            mask = tuple(v in self.observed for v in cpd.given)
            alike.setdefault((cpd.origin, mask, cpd.child in self.observed), []).append(cpd)
        groups = []
        for (_, _, observed), cpds in alike.items():
            hidden = [self.without_evidence(cpd.given) for cpd in cpds]
            none = np.zeros((len(cpds), 0), dtype=np.intp)
            group = Group(
                tuple(cpds),
                hidden[0],
                observed,
                none if observed else np.array([self.places[cpd.child] for cpd in cpds]),
                np.array([self.components(scope) for scope in hidden]),
                np.array([home[cpd.child] for cpd in cpds], dtype=np.intp),
            )
            groups.append(group)
        return sorted(groups, key=Group.shape)

    @cached_property
    def shapes(self) -> list[list[int]]:
        """The groups whose factors have one shape, which stand together."""
        every = groupby(enumerate(self.groups), lambda item: item[1].shape())
        return [[k for k, _ in alike] for _, alike in every]

    @cached_property
    def order(self) -> list[tuple[int, int]]:
        """All CPDs as (group, row), parents first, each only when something after it needs it."""
        where = {
            cpd.child: (g, row)
            for g, group in enumerate(self.groups)
            for row, cpd in enumerate(group.cpds)
        }
        parents = {
            cpd.child: [v for v in cpd.given if v not in self.observed] for cpd in self._cpds
        }
        needed = {v for found in parents.values() for v in found}
        stack = [v for v in reversed(parents) if v in self.observed or v not in needed]
        done: dict[Variable, None] = {}
        while stack:
            waiting = [v for v in parents[stack[-1]] if v not in done]
            if waiting:
                stack.extend(reversed(waiting))
            else:
                done[stack.pop()] = None
        return [where[child] for child in done]


@dataclass(frozen=True, eq=False)
class Stack:
    """Eliminations of one shape: messages that some clusters send, or the beliefs of clusters.

    `members` (B,) are the messages or clusters, from the factors of `clusters`, of whose columns
    the first `drop` are integrated out. `components` (B, n) are the columns' places among all
    hidden components, `columns` in the cluster's scope; `entries` (B, k, n), `rows` (B, k) those of
    the factor in the buffer; `logs` (B, 1 + inputs) of log-scales, the cluster's and its messages'.
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
    """The places of the rows of a layout's factors and messages in one buffer.

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
    def own_entries(self) -> Integers:
        """The first entry of each group of CPDs, and the end."""
        groups = self.layout.groups
        return np.cumsum([0, *(len(g.cpds) * g.height * g.width for g in groups)])

    @cached_property
    def own_rows(self) -> Integers:
        """The first row of each group of CPDs, and the end."""
        return np.cumsum([0, *(len(g.cpds) * g.height for g in self.layout.groups)])

    @cached_property
    def entry_starts(self) -> Integers:
        """The first entry of each message, and the zero."""
        return int(self.own_entries[-1]) + np.cumsum([0, *(self.sizes**2)])

    @cached_property
    def row_starts(self) -> Integers:
        """The first row of each message, and the zero."""
        return int(self.own_rows[-1]) + np.cumsum([0, *self.sizes])

    @cached_property
    def by_size(self) -> list[tuple[int, Integers]]:
        """The messages of each size of sepsets."""
        every = np.unique(self.sizes).tolist()
        return [(size, np.flatnonzero(self.sizes == size)) for size in every]

    @cached_property
    def _factors(self) -> list[list[tuple[Integers, Integers]]]:
        """For each cluster, the entries (rows, n) and right sides of its CPDs."""
        found: list[list[tuple[Integers, Integers]]] = [[] for _ in self.layout.scopes]
        starts = self.own_entries.tolist(), self.own_rows.tolist()
        for group, entry, first in zip(self.layout.groups, *starts, strict=False):
            height = group.height
            scope = np.concatenate([group.child, group.parents], axis=1)
            for row, cluster in enumerate(group.clusters.tolist()):
                block = self._block(cluster, scope[row], entry + row * height * group.width, height)
                found[cluster].append((block, first + row * height + np.arange(height)))
        return found

    @cached_property
    def _arriving(self) -> list[tuple[Integers, Integers]]:
        """For each message, its entries in the columns of its target, and its right sides."""
        found = []
        for message, target in enumerate(self.layout.directed.target.tolist()):
            size = int(self.sizes[message])
            places = self.layout.components(self.layout.sepsets[message // 2])
            block = self._block(target, places, int(self.entry_starts[message]), size)
            found.append((block, self.row_starts[message] + np.arange(size)))
        return found

    def _block(self, cluster: int, places: Integers, first: int, height: int) -> Integers:
        """The entries of rows over some components, from the first on, in a cluster's columns."""
        columns = self.layout.columns[cluster]
        block = np.full((height, len(columns)), self.entry_starts[-1])
        inside = np.arange(height * places.size).reshape(height, places.size)
        block[:, [columns[place] for place in places.tolist()]] = first + inside
        return block

    def messages(self, wanted: Sequence[int]) -> list[Stack]:
        """The elimination of some messages from what their sources know, but for the target."""
        layout, directed = self.layout, self.layout.directed
        kept = (layout.components(layout.sepsets[m // 2]).tolist() for m in wanted)
        sources = directed.source[list(wanted)].tolist()
        return self._stacks(zip(wanted, sources, map(directed.inputs, wanted), kept, strict=True))

    def beliefs(self, clusters: Iterable[int]) -> list[Stack]:
        """The elimination of everything in some clusters, from all that they know."""
        outgoing = self.layout.directed.outgoing
        return self._stacks([(i, i, [m ^ 1 for m in outgoing[i]], []) for i in clusters])

    def potentials(self, clusters: Iterable[int]) -> list[Stack]:
        """The elimination of everything in some clusters, from their CPDs alone."""
        return self._stacks([(i, i, [], []) for i in clusters])

    @cached_property
    def all_beliefs(self) -> list[Stack]:
        """The elimination of everything in every cluster."""
        return self.beliefs(range(len(self.layout.scopes)))

    def _stacks(self, tasks: Iterable[tuple[int, int, list[int], list[int]]]) -> list[Stack]:
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
