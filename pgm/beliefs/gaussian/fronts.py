"""Fronts of a tree of clusters: the batches of components that are eliminated together.

A front is one or more neighbouring clusters of the tree, joined. Its *pivots* are the components
that no front above it holds, which are eliminated there; its *separators* are the others, which its
parent holds too. Fronts are numbered so that children come before their parents, each right after
its last child's; and components have *positions* in the order in which they leave. The matrix of a
front has a column for each of its components, by position: the pivots first.

Clusters whose evidence has left them subsets of a neighbour are joined to it, and so are clusters
whose joined matrix has few more entries: each front costs some time of its own. The elimination is
the multifrontal factorisation of sparse matrices (Duff & Reid, 1983), on the tree that the graph
was compiled to.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np

from pgm.beliefs.gaussian.blocks import Blocks
from pgm.beliefs.gaussian.layout import Layout
from pgm.clustergraph.structure import Forest
from pgm.kernels.arrays import Integers, Mask

# Clusters are joined while no more than this share of the joined columns' entries are zeros,
ZEROS = 0.3
# or while the columns that are eliminated together are so few; more of them in trees that are so
# narrow that NumPy's calls would be of a front or two.
FEW, SEVERAL = 6, 48
NARROW = 4


@dataclass(frozen=True, eq=False)
class Fronts:
    """The fronts of a tree, and their components.

    Attributes
    ----------
    of_cluster : ndarray of int
        The front of each cluster, (clusters,).
    tops : ndarray of int
        The highest cluster of each front, (fronts,).
    parent : ndarray of int
        The front above each, (fronts,); −1 of a root.
    pivots : ndarray of int
        How many components each front eliminates, (fronts,).
    order : ndarray of int
        The place of the component at each position, (size,).
    blocks : Blocks
        The components of each front, by position.
    """

    of_cluster: Integers
    tops: Integers
    parent: Integers
    pivots: Integers
    order: Integers
    blocks: Blocks

    @classmethod
    def of(cls, layout: Layout, without: Mask | None = None, few: int = FEW) -> Fronts:
        """The fronts of the layout's graph, a tree or several, `without` some components.

        Clusters are joined in any case where no more than `few` components are eliminated together.
        """
        scopes, forest = _Scopes.of(layout, without), Forest.of(layout.graph)
        home, pivots, sizes = scopes.homes(forest)
        parent = np.where((sizes > pivots) | (sizes == 0), forest.parent, -1)
        joined = _joined(forest, parent, pivots, sizes, few)
        top = np.flatnonzero(joined == np.arange(joined.size))
        above = np.where(parent[top] >= 0, joined[parent[top]], -1)
        found = _postorder(top, above)
        number = np.full(joined.size, -1)
        number[found] = np.arange(top.size)
        of_cluster, parent = number[joined], np.full(top.size, -1)
        parent[number[top]] = np.where(above >= 0, number[above], -1)
        # Variables leave front by front; in a front, those of the clusters below before others.
        leaving = np.lexsort((home, -forest.depth[home], of_cluster[home]))
        rank = np.empty_like(leaving)
        rank[leaving] = np.arange(leaving.size)
        dims, first = scopes.dims[leaving], scopes.first[leaving]
        held = np.unique(of_cluster[scopes.cluster] * max(rank.size, 1) + rank[scopes.variable])
        front, member = np.divmod(held, max(rank.size, 1))
        sizes = np.bincount(front, dims[member], top.size).astype(np.intp)
        own = np.bincount(of_cluster[home], scopes.dims, top.size).astype(np.intp)
        blocks = Blocks(layout.size, sizes, ranges(first[member], dims[member]))
        return cls(of_cluster, np.array(found), parent, own, ranges(first, dims), blocks)

    def __len__(self) -> int:
        return self.parent.size

    @cached_property
    def separators(self) -> Integers:
        """How many components each front shares with its parent, (fronts,)."""
        return self.blocks.sizes - self.pivots

    @cached_property
    def above(self) -> Integers:
        """The columns that separators have in the parent's matrix, front by front."""
        begin = self.blocks.starts[:-1] + self.pivots
        places = self.blocks.components[ranges(begin, self.separators)]
        parents = np.repeat(np.maximum(self.parent, 0), self.separators)
        return self.blocks.columns(parents, places[:, None])[:, 0]

    @cached_property
    def levels(self) -> list[Integers]:
        """The fronts, in lists of those whose children are in earlier ones."""
        height = [0] * len(self)
        for front, parent in enumerate(self.parent.tolist()):
            if parent >= 0 and height[parent] <= height[front]:
                height[parent] = height[front] + 1
        order = np.argsort(height, kind="stable")
        return np.split(order, np.cumsum(np.bincount(height))[:-1])

    @property
    def is_narrow(self) -> bool:
        """Whether few fronts can be eliminated together, as in chains."""
        return len(self) < NARROW * len(self.levels)

    @cached_property
    def depth(self) -> Integers:
        """How many fronts are above each, (fronts,)."""
        depth = [0] * len(self)
        for front, parent in reversed(list(enumerate(self.parent.tolist()))):
            if parent >= 0:
                depth[front] = depth[parent] + 1
        return np.array(depth, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class _Scopes:
    """The hidden variables of all clusters, by their places among the hidden ones.

    `cluster` and `variable` are the pairs; `dims` and `first` the number of each variable's
    components, and the place of its first.
    """

    count: int
    cluster: Integers
    variable: Integers
    dims: Integers
    first: Integers

    @classmethod
    def of(cls, layout: Layout, without: Mask | None) -> _Scopes:
        graph = layout.graph
        number = np.full(len(graph.network.variables), -1)
        first = np.array([layout.starts[v] for v in layout.hidden], dtype=np.intp)
        dims = np.array([v.dimension for v in layout.hidden], dtype=np.intp)
        hidden = np.array([graph.network._places[v] for v in layout.hidden], dtype=np.intp)
        if without is not None:
            first, dims, hidden = (part[~without[first]] for part in (first, dims, hidden))
        number[hidden] = np.arange(len(hidden))
        lengths = np.fromiter(map(len, graph._members), np.intp, len(graph))
        every = np.fromiter(chain.from_iterable(graph._members), np.intp, int(lengths.sum()))
        variable, cluster = number[every], np.repeat(np.arange(len(graph)), lengths)
        kept = variable >= 0
        return cls(len(graph), cluster[kept], variable[kept], dims, first)

    def homes(self, forest: Forest) -> tuple[Integers, Integers, Integers]:
        """The highest cluster that holds each variable, and each cluster's pivots and components.

        These two are numbers of components, (clusters,).
        """
        found = np.lexsort((forest.depth[self.cluster], self.variable))
        _, first = np.unique(self.variable[found], return_index=True)
        home = self.cluster[found[first]]
        sizes = np.bincount(self.cluster, self.dims[self.variable], self.count)
        pivots = np.bincount(home, self.dims, self.count)
        return home, pivots.astype(np.intp), sizes.astype(np.intp)


def _joined(
    forest: Forest, parent: Integers, pivots: Integers, sizes: Integers, few: int
) -> Integers:
    """The highest cluster of those that each is joined with, (clusters,).

    From below, each cluster, with those that were joined to it, is weighed against its parent, of
    siblings first the one of most separators.
    """
    up, p, s = parent.tolist(), pivots.tolist(), (sizes - pivots).tolist()
    filled = (pivots * (pivots + 1) // 2 + pivots * (sizes - pivots)).tolist()
    joined = list(range(len(up)))
    turns = np.lexsort((pivots - sizes, -forest.depth))
    for k in turns.tolist():
        to = up[k]
        if to < 0:
            continue
        both, there = p[k] + p[to], filled[k] + filled[to]
        entries = both * (both + 1) // 2 + both * s[to]
        if not p[k] or both <= few or entries - there <= ZEROS * entries:
            joined[k] = to
            p[to], filled[to] = both, there
    for k in reversed(turns.tolist()):
        joined[k] = joined[joined[k]]
    return np.array(joined, dtype=np.intp)


def _postorder(tops: Integers, above: Integers) -> list[int]:
    """The clusters `tops`, each after all that hang on it, those below one after another."""
    hanging: dict[int, list[int]] = {}
    for top, parent in zip(tops.tolist(), above.tolist(), strict=True):
        hanging.setdefault(parent, []).append(top)
    found, waiting = [], list(hanging.get(-1, ()))
    while waiting:  # parents before children, which turned round is children before parents
        found.append(waiting.pop())
        waiting.extend(hanging.get(found[-1], ()))
    return found[::-1]


def ranges(first: Integers, lengths: Integers) -> Integers:
    """The whole numbers of ranges, one after another, by their first ones and lengths."""
    begin = np.cumsum(lengths) - lengths
    return np.repeat(first - begin, lengths) + np.arange(int(lengths.sum()))
