"""The plan of the passes of messages over a tree of tables, laid out once for a graph.

Each tree is rooted at its centre. A cluster's table is a matrix, with a *column* for each joint
state of the sepset with the parent (a root has one column, of an empty sepset), and a *row* for
each joint state of the other variables. The message to the parent is the sum of the rows: it has
one entry for each column. Clusters of equal depth form a *stack* if they have equally many rows and
children, and their parents' tables have equally many entries for each column. The tables of a stack
stand side by side in one matrix, so that the messages of a stack are one sum. A set of stacks is an
integer with a bit for each.

Flat storage holds the *entries* of all clusters' tables, then the columns of all sepsets. *Tops*
are scales taken out of messages, and of the tables of *hubs*, clusters of more than 32 (`CHUNK`)
children. A *large* table is contiguous, has a stack alone and is used where it stands; the entries
of others are gathered by index. The *home* of a variable is the smallest cluster that holds it;
evidence for the variable is multiplied into the table of its home. In shapes, [runs] is an axis
that a single run lacks.

In a tiny network each message would take NumPy calls on a few numbers. There all tables are instead
computed from the joint of all variables, by one product with a matrix of zeros and ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import or_

import numpy as np

from pgm.beliefs.discrete.place import LARGE, Place, positions, steps
from pgm.beliefs.discrete.products import BlockProduct, GatheredProduct, Product
from pgm.beliefs.discrete.run_pieces import at_once
from pgm.beliefs.discrete.storage import Storage, sepset_between
from pgm.beliefs.discrete.sums import Marginals, Sum, summed
from pgm.clustergraph import ClusterGraph
from pgm.clustergraph.structure import Forest
from pgm.evidence.static import BoundStates
from pgm.factors.axes import States, discrete, sizes, without
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import SUM_PRODUCT
from pgm.schedules.limits import require_size
from pgm.variables import Discrete

# The most entries of the matrix `Enumeration.tables`.
TINY = 2**14


@dataclass(frozen=True, eq=False)
class Enumeration:
    """The joint of all variables of a tiny network whose graph is one tree.

    A *cell* is a joint state of all variables.

    joint: (cells,): probabilities without evidence.
    shown: Of each variable, (states, cells): one where the variable has this state in the cell,
        else zero.
    tables: (cells, entries + columns): one where the states of the cell agree with those of an
        entry of a cluster's or a sepset's table, else zero.
    """

    joint: Array
    shown: Mapping[Discrete, Array]
    tables: Array

    @classmethod
    def of(
        cls, storage: Storage, forest: Forest, sepsets: Sequence[States], first: Integers
    ) -> Enumeration | None:
        """The joint of a network's variables.

        None if the network is not tiny (`tables` would have more than 2¹⁴ entries, `TINY`) or has
        several trees, or if a probability, or their sum, under- or overflows.

        sepsets: Of each cluster, its sepset with its parent.
        first: (clusters,): the first column of each cluster's message to its parent.
        """
        scope = tuple(storage.homes)
        cells = math.prod(sizes(scope))
        length = storage.entries + sum(math.prod(sizes(sepset)) for sepset in sepsets)
        if cells * length > TINY or forest.levels[0].size > 1:
            return None
        joint, tables = np.ones(cells), np.zeros((cells, length))
        each = np.arange(cells)
        try:
            with np.errstate(under="raise", over="raise"):
                potentials = storage.potentials(SUM_PRODUCT)
                for place, sepset, column in zip(storage.places, sepsets, first, strict=True):
                    entry = place.positions(scope).ravel()
                    start = storage.entries + int(column)
                    tables[each, entry] = 1.0
                    tables[each, positions(start, steps(sepset, 1), scope).ravel()] = 1.0
                    joint *= potentials[entry]
                np.add.reduce(joint)
        except FloatingPointError:
            return None
        state = {v: positions(0, {v: 1}, scope).ravel() for v in scope}
        shown = {v: (state[v] == np.arange(v.size)[:, None]).astype(float) for v in scope}
        return cls(joint, shown, tables)

    def given(self, states: Mapping[Discrete, int | Integers]) -> tuple[Array, float]:
        """The tables of a single run, (entries + columns,), each of sum one, and p(evidence).

        `states` has the observed variables' states. If p(evidence) is zero, the tables are zero.
        """
        cells = self.joint
        for variable, state in states.items():
            cells = cells * self.shown[variable][state]
        total = float(np.add.reduce(cells))
        if total > 0.0:
            cells = cells / total
        return cells.dot(self.tables), total


@dataclass(frozen=True, eq=False)
class Stack:
    """Clusters of equal shape and depth, computed in one batch.

    clusters: (clusters,): the numbers of the clusters.
    bit: The one bit that stands for the stack in sets of stacks.
    entries: The slice of flat storage that has the clusters' tables.
    columns: The slice of an array of all messages that has the clusters' messages to their parents.
    tops: The slice of an array of all scales that has those of the stack: first one for each
        cluster's message. If the clusters are hubs, their tables are rescaled several times, and
        each time adds one for each cluster.
    shape: The shape of all tables as one matrix: (rows, columns), or (columns, rows) where `axis`
        is 1.
    axis: The axis of `shape` that has the rows, over which messages sum.
    first, widths: (clusters,): of each cluster, its first column in the stack and the number of its
        columns.
    absorbed: The products that multiply the messages from the clusters' children into the tables,
        a few messages to each table at a time.
    senders: Of each of these products, the set of the stacks that send its messages.
    down: The sum of the parents' tables to the sepsets of the stack's clusters; None for roots.
    """

    clusters: Integers
    bit: int
    entries: slice
    columns: slice
    tops: slice
    shape: tuple[int, int]
    axis: int
    first: Integers
    widths: Integers
    absorbed: Sequence[Product]
    senders: Sequence[int]
    down: Sum | None

    @cached_property
    def single(self) -> bool:
        """Whether the stack consists of one cluster."""
        return self.clusters.size == 1

    @cached_property
    def narrow(self) -> bool:
        """Whether each cluster of the stack has one column."""
        return self.clusters.size == int(self.widths.sum())

    @cached_property
    def top(self) -> slice:
        """The part of `tops` for the messages' scales; those of hubs' tables follow."""
        return slice(self.tops.start, self.tops.start + self.clusters.size)

    def largest(self, columns: Array) -> Array:
        """The largest number in each cluster's columns, (clusters, [runs]).

        `columns` is an array with a number for each column of the stack, (columns, [runs]).
        """
        if self.narrow:
            return columns
        if self.single:
            top: Array = np.maximum.reduce(columns, 0)
            return top[None]
        return np.maximum.reduceat(columns, self.first, 0)

    def by_column(self, each: Array) -> Array:
        """Numbers `each`, one a cluster, (clusters, [runs]), as one a column, (columns, [runs]).

        A cluster's number is repeated for each of its columns. For a stack of one cluster the
        result stays (1, [runs]), which broadcasts.
        """
        return each if self.single or self.narrow else each.repeat(self.widths, 0)

    def by_entry(self, columns: Array) -> Array:
        """An array (columns, [runs]), shaped to broadcast with the tables, (*shape, [runs])."""
        return columns[:, None] if self.axis else columns


@dataclass(frozen=True, eq=False)
class TreePlan:
    """The stacks of a graph without loops.

    storage: The layout of the clusters' tables in flat storage.
    forest: The clusters as rooted trees.
    stacks: All stacks, the roots' first, parents before children.
    sepsets: Of each cluster, its sepset with its parent, the variables in the order in which the
        message's columns count their states.
    columns, tops: How many columns and scales there are in all.
    first: (clusters,): the first column of each cluster's message to its parent.
    large: Tables of at least so many entries are contiguous, and worked on by themselves.
    """

    storage: Storage
    forest: Forest
    stacks: Sequence[Stack]
    sepsets: Sequence[States]
    columns: int
    tops: int
    first: Integers
    large: int

    @property
    def graph(self) -> ClusterGraph:
        """The cluster graph whose computations the plan lays out."""
        return self.storage.graph

    @cached_property
    def enumeration(self) -> Enumeration | None:
        """The joint of all variables; None if the network is not tiny, or has several trees.

        None also if a probability underflows.
        """
        return Enumeration.of(self.storage, self.forest, self.sepsets, self.first)

    @cached_property
    def everything(self) -> int:
        """The set of all stacks."""
        return (1 << len(self.stacks)) - 1

    def homes_of(self, evidence: BoundStates) -> int:
        """The set of the stacks that have the homes of variables with evidence."""
        return _union(self._ways[v][0] for v in (*evidence.states, *evidence.weights))

    def above(self, evidence: BoundStates) -> int:
        """The set of all stacks from the homes of variables with evidence to the roots.

        The stacks of all roots are in it, whether evidence is below them or not.
        """
        ways = _union(self._ways[v][1] for v in (*evidence.states, *evidence.weights))
        return self._roots | ways

    @cached_property
    def _roots(self) -> int:
        """The set of the stacks of roots."""
        return _union(stack.bit for stack in self.stacks if stack.down is None)

    @cached_property
    def _ways(self) -> dict[Discrete, tuple[int, int]]:
        """Of each variable, the stack that its evidence enters, and the stacks that it passes.

        Both are sets of stacks. Evidence enters the stack of the variable's home alone, and passes
        all stacks from there to the root, these two included.
        """
        found = [(0, 0)] * len(self.graph)
        for stack in self.stacks:
            for k in stack.clusters.tolist():
                parent = int(self.forest.parent[k])
                found[k] = stack.bit, stack.bit | (found[parent][1] if parent >= 0 else 0)
        return {variable: found[home] for variable, home in self.storage.homes.items()}

    @cached_property
    def tree_of_top(self) -> Integers:
        """Of each scale, the number of the root of the tree in which it is taken out, (tops,)."""
        roots = self.forest.roots
        found = [np.resize(roots[s.clusters], s.tops.stop - s.tops.start) for s in self.stacks]
        return np.concatenate(found)

    @cached_property
    def marginals(self) -> Marginals:
        """The sums that make marginals, each from the smallest table, of a cluster or a sepset."""
        found = {v: self.storage.places[home] for v, home in self.storage.homes.items()}
        for sepset, first in zip(self.sepsets, self.first.tolist(), strict=True):
            place = Place.of(sepset, self.storage.entries + first, self.large)
            for variable in sepset:
                if place.size < found[variable].size:
                    found[variable] = place
        return Marginals.of(found, self.storage.entries + self.columns)


# A hub multiplies this many messages at the most into its table before that is rescaled; a cluster
# of more children is one.
CHUNK = 32
# In batches, tables of this many entries stand by themselves: runs make calls long, and gathering
# entries that stand anywhere takes longer than using them where they stand.
LARGE_OF_MANY = 2**9
# Entries of expanded messages that are multiplied with one another in one call.
SMALL = 2**12


def plan_for(graph: ClusterGraph, runs: int, batch: int) -> TreePlan:
    """The plan of a graph without loops for evidence of some runs.

    `batch` is the limit on table entries, times runs, that are computed at once. A graph keeps two
    plans. One is for a single run, and for runs that are computed one by one because fewer than 64
    fit into the limit: there a table counts as large from 8192 entries on. The other is for runs
    that are computed many at once: there a table counts as large from 512 entries on.
    """
    if runs == 1 or at_once(sum(graph.sizes), batch) == 1:
        return graph.derived(make_plan, LARGE)
    return graph.derived(make_plan, LARGE_OF_MANY)


def make_plan(graph: ClusterGraph, large: int) -> TreePlan:
    """Lay out the passes of messages over a graph without loops.

    Raises `GraphError` if the graph's tables are too large for memory.

    large: Tables of at least so many entries are contiguous, and worked on by themselves.
    """
    require_size(graph, graph.sizes, "tables")
    return _Planner(graph, large).plan()


def _union(sets: Iterable[int]) -> int:
    """The union of sets of stacks."""
    return reduce(or_, sets, 0)


class _Planner:
    """The layout of the stacks of a graph without loops, while a `TreePlan` is made.

    large: Tables of at least so many entries are contiguous, and worked on by themselves.
    sepsets, width: Of each cluster, the sepset with its parent, and its number of joint states,
        which is that of the message's columns.
    places, first, bits: Of each cluster, the place of its table, its first column, and the bit of
        its stack; filled by `plan`.
    """

    def __init__(self, graph: ClusterGraph, large: int) -> None:
        self.graph, self.large, self.forest = graph, large, graph.derived(Forest.of)
        shared = [sepset_between(graph, *edge) for edge in enumerate(self.forest.parent.tolist())]
        self.sepsets = [self._ordered(k, scope, shared) for k, scope in enumerate(shared)]
        self.width = [math.prod(sizes(sepset)) for sepset in self.sepsets]
        self.places: dict[int, Place] = {}
        self.first = np.zeros(len(graph), dtype=np.intp)
        self.bits = [0] * len(graph)

    def plan(self) -> TreePlan:
        """Group clusters of equal depth and shape into stacks, and lay their tables out."""
        groups: dict[tuple[int, ...], list[int]] = {}
        for level in self.forest.levels:
            for k in level.tolist():
                groups.setdefault(self._kind(k), []).append(k)
        start = column = 0
        for number, clusters in enumerate(groups.values()):
            start, column = self._place(clusters, start, column)
            for k in clusters:
                self.bits[k] = 1 << number
        storage = Storage(self.graph, [self.places[k] for k in range(len(self.graph))])
        stacks, tops = list[Stack](), 0
        for clusters in groups.values():
            stacks.append(self._stack(clusters, storage, tops))
            tops = stacks[-1].tops.stop
        made = storage, self.forest, stacks, self.sepsets, column, tops, self.first, self.large
        return TreePlan(*made)

    def _rows(self, cluster: int) -> int:
        """The number of rows of a cluster's table, whose columns are those of its message."""
        return self.graph.sizes[cluster] // self.width[cluster]

    def _kind(self, cluster: int) -> tuple[int, ...]:
        """The key by which clusters are grouped into stacks: clusters of equal keys share one.

        In order: the depth, the number of rows, the number of children, the number of entries of
        the parent's table for each column (0 for a root), and the cluster itself if its table or
        the parent's is large, so that it has a stack alone, else −1.
        """
        parent = int(self.forest.parent[cluster])
        above = self.graph.sizes[parent] // self.width[cluster] if parent >= 0 else 0
        depth, children = int(self.forest.depth[cluster]), len(self.forest.children[cluster])
        alone = cluster if self._large(cluster) or (parent >= 0 and self._large(parent)) else -1
        return depth, self._rows(cluster), children, above, alone

    def _large(self, cluster: int) -> bool:
        """Whether a table is so large that it is worked on by itself, where it stands."""
        return self.graph.sizes[cluster] >= self.large

    def _ordered(self, cluster: int, scope: States, sepsets: Sequence[States]) -> States:
        """Variables of a cluster, `scope`, in the order in which its table has them.

        In a large table the variables of each child's sepset stand together, where that can be, and
        those of the largest sepset stand last. The product of the table and a child's message, and
        the sum of the table to the sepset, then have few axes, the last of them long. In other
        tables variables keep the order of `scope`. `sepsets` are those of all clusters with their
        parents.
        """
        if not self._large(cluster):
            return scope
        children = [set(sepsets[k]) for k in self.forest.children[cluster]]
        children.sort(key=lambda sepset: math.prod(variable.size for variable in sepset))
        found = {v: [k for k, sepset in enumerate(children) if v in sepset] for v in scope}
        return tuple(sorted(scope, key=lambda v: (found[v][0], found[v][-1]) if found[v] else ()))

    def _place(self, clusters: list[int], start: int, column: int) -> tuple[int, int]:
        """Place the tables of a stack from entry `start` on, and its messages from `column` on.

        The tables are columns of one matrix, which is stored row by row, or column by column if it
        has fewer columns than rows. Returns the entry and the column that come next.
        """
        rows = self._rows(clusters[0])
        columns = sum(self.width[k] for k in clusters)
        offset = 0
        for k in clusters:
            rest = without(discrete(self.graph.clusters[k].scope), self.sepsets[k])
            rest = self._ordered(k, rest, self.sepsets)
            down, across = (columns, 1) if rows <= columns else (1, rows)
            step = steps(rest, down) | steps(self.sepsets[k], across)
            scope = (*rest, *self.sepsets[k])
            self.places[k] = Place(scope, start + offset * across, step, self._large(k))
            self.first[k] = column + offset
            offset += self.width[k]
        return start + rows * columns, column + columns

    def _stack(self, clusters: list[int], storage: Storage, tops: int) -> Stack:
        """The stack of some clusters, whose scales start at `tops` in the array of all scales.

        The clusters' tables have been placed; `storage` tells the places of all tables.
        """
        rows = self._rows(clusters[0])
        widths = np.array([self.width[k] for k in clusters])
        columns = int(widths.sum())
        start = storage.places[clusters[0]].start
        first = int(self.first[clusters[0]])
        absorbed = self._absorbed(clusters, storage, start, rows * columns)
        hub = len(self.forest.children[clusters[0]]) > CHUNK
        scales = len(clusters) * (len(absorbed) if hub else 1)
        return Stack(
            np.array(clusters),
            self.bits[clusters[0]],
            slice(start, start + rows * columns),
            slice(first, first + columns),
            slice(tops, tops + scales),
            (rows, columns) if rows <= columns else (columns, rows),
            int(rows > columns),
            np.cumsum(widths) - widths,
            widths,
            absorbed,
            [_union(self.bits[k] for k in product.children.ravel()) for product in absorbed],
            self._down(clusters, storage),
        )

    def _absorbed(
        self, clusters: list[int], storage: Storage, start: int, entries: int
    ) -> list[Product]:
        """The products of the tables of a stack and the messages from the clusters' children.

        `start` is the index of the stack's first entry, `entries` the number of its entries. One
        product multiplies a few messages into each table of the stack, or one into a large table.
        """
        only = storage.places[clusters[0]]
        if only.large:
            return [
                BlockProduct.of(k, only, self.sepsets[k], int(self.first[k]))
                for k in self.forest.children[clusters[0]]
            ]
        senders = np.array([self.forest.children[k] for k in clusters], dtype=np.intp).T
        count = len(self.forest.children[clusters[0]])
        maps = np.empty((count, entries), dtype=np.intp)
        for k in clusters:
            place = storage.places[k]
            target = place.positions(place.scope) - start
            for slot, child in enumerate(self.forest.children[k]):
                columns = steps(self.sepsets[child], 1)
                maps[slot, target] = positions(int(self.first[child]), columns, place.scope)
        size = min(CHUNK, max(1, SMALL // entries))
        chunks = [slice(at, at + size) for at in range(0, count, size)]
        return [GatheredProduct(senders[some], maps[some]) for some in chunks]

    def _down(self, clusters: list[int], storage: Storage) -> Sum | None:
        """The sum of the parents' tables to the sepsets of a stack's clusters; None for roots."""
        parent = int(self.forest.parent[clusters[0]])
        if parent < 0:
            return None
        start = storage.entries + int(self.first[clusters[0]])
        sources = [(storage.places[int(self.forest.parent[k])], self.sepsets[k]) for k in clusters]
        return summed(sources, start)
