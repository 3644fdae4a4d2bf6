"""What a pass of messages over a tree of tables does, laid out once for a graph.

The clusters of a tree hang at its centre. Those of one depth that have as many entries for each
entry of the sepset to their parent, the same number of children and parents of like shape form a
stack: their tables are the columns of one matrix, so that the messages of a stack are one sum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.evidence.discrete import BoundStates
from pgm.factors.axes import States, sizes
from pgm.inference.discrete.enumeration import Enumeration
from pgm.inference.discrete.place import Place
from pgm.inference.discrete.products import Product
from pgm.inference.discrete.storage import Storage
from pgm.inference.discrete.sums import Marginals, Sum
from pgm.inference.forest import Forest
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import LOG_SUM_PRODUCT
from pgm.variables import Discrete


@dataclass(frozen=True, eq=False)
class Stack:
    """Clusters that are computed together.

    A column is an entry of the sepset to the parent; a root has one, of an empty sepset.

    Attributes
    ----------
    clusters : ndarray of int
    bit : int
        The one bit that stands for the stack in sets of stacks.
    entries, columns, tops : slice
        Where their tables, the columns of their messages, and the scales taken out of these stand:
        one for each cluster, and of a hub one more for each time that its table is rescaled.
    shape : tuple of int
        Of their tables as one matrix: (rows, columns), or (columns, rows) where `axis` is 1.
    axis : int
        The axis of the rows.
    first, widths : ndarray of int
        Of each cluster, its first column in the stack and their number.
    absorbed : sequence of Product
        Messages from the children.
    senders : sequence of int
        For each of these, the set of the stacks that send them.
    hub : bool
        Whether the clusters have so many children that their tables are rescaled in between.
    down : Sum or None
        Sums the parents' tables to the columns; of roots None.
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
    hub: bool
    down: Sum | None

    @cached_property
    def single(self) -> bool:
        """Whether it is one cluster."""
        return self.clusters.size == 1

    @cached_property
    def narrow(self) -> bool:
        """Whether each cluster has one column."""
        return self.clusters.size == int(self.widths.sum())

    @cached_property
    def top(self) -> slice:
        """Where the scales of the messages stand; behind them are those of a hub's table."""
        return slice(self.tops.start, self.tops.start + self.clusters.size)


@dataclass(frozen=True, eq=False)
class TreePlan:
    """The stacks of a graph without loops.

    Attributes
    ----------
    storage : Storage
    forest : Forest
    stacks : sequence of Stack
        The roots first, parents before children.
    sepsets : sequence of tuple of Discrete
        Of each cluster and its parent, in the order of the message's columns.
    columns : int
        Columns of all messages.
    tops : int
        Scales taken out of all messages.
    first : ndarray of int
        (clusters,): the first column of each cluster's message to its parent.
    large : int
        Tables of so many entries stand by themselves.
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
        """The graph that this is the plan of."""
        return self.storage.graph

    @cached_property
    def logs(self) -> Array:
        """The logarithms of the clusters' potentials."""
        return self.storage.potentials(LOG_SUM_PRODUCT)

    @cached_property
    def enumeration(self) -> Enumeration | None:
        """The joint of all variables, where the network is tiny."""
        return Enumeration.of(self.storage, self.forest, self.sepsets, self.first)

    @cached_property
    def everything(self) -> int:
        """The set of all stacks."""
        return (1 << len(self.stacks)) - 1

    def homes_of(self, evidence: BoundStates) -> int:
        """The set of the stacks that evidence is put into."""
        found = 0
        for variable in (*evidence.states, *evidence.weights):
            found |= self._bits[variable]
        return found

    @cached_property
    def _bits(self) -> dict[Discrete, int]:
        bits = {k: stack.bit for stack in self.stacks for k in stack.clusters.tolist()}
        return {variable: bits[home] for variable, home in self.storage.homes.items()}

    @cached_property
    def _roots(self) -> int:
        return sum(stack.bit for stack in self.stacks if stack.down is None)

    @cached_property
    def _paths(self) -> dict[Discrete, int]:
        """The stacks on the way from each variable's home to the root."""
        to_root = [0] * len(self.graph)
        for stack in self.stacks:
            for k in stack.clusters.tolist():
                parent = int(self.forest.parent[k])
                to_root[k] = stack.bit | (to_root[parent] if parent >= 0 else 0)
        return {variable: to_root[home] for variable, home in self.storage.homes.items()}

    def above(self, evidence: BoundStates) -> int:
        """The set of the stacks on the ways from the evidence to the roots, and of these."""
        found = self._roots
        for variable in (*evidence.states, *evidence.weights):
            found |= self._paths[variable]
        return found

    @cached_property
    def tree_of_top(self) -> Integers:
        """The root of the tree from which each scale was taken, (tops,)."""
        roots = self.forest.roots
        found = [np.resize(roots[s.clusters], s.tops.stop - s.tops.start) for s in self.stacks]
        return np.concatenate(found)

    @cached_property
    def marginals(self) -> Marginals:
        """What sums the tables and sepsets to the probabilities of each variable."""
        sources = self.storage.by_state
        smallest = {v: self._smallest(v, source) for v, source in sources.items()}
        return Marginals.of(smallest, self.storage.entries + self.columns)

    def _smallest(self, variable: Discrete, home: Integers | Place) -> Integers | Place:
        """Where to sum a variable from: its home, or a smaller sepset."""
        best, least = home, self.graph.sizes[self.storage.homes[variable]]
        for k, sepset in self._sepsets.get(variable, ()):
            width = math.prod(sizes(sepset))
            if width < least:
                start = self.storage.entries + int(self.first[k])
                place = Place(sepset, 1, width, start, width, 1, width >= self.large)
                best, least = place if place.large else place.split(variable), width
        return best

    @cached_property
    def _sepsets(self) -> dict[Discrete, list[tuple[int, States]]]:
        found: dict[Discrete, list[tuple[int, States]]] = {}
        for k, sepset in enumerate(self.sepsets):
            for variable in sepset:
                found.setdefault(variable, []).append((k, sepset))
        return found
