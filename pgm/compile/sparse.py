"""Graphs of many thousand vertices as arrays, and SciPy's searches and orders of them."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from itertools import chain

import numpy as np

from pgm.compile.elimination import Adjacency
from pgm.kernels.arrays import Integers, Mask


@dataclass(frozen=True, eq=False)
class SparseGraph:
    """An undirected graph of `count` vertices: edge k leads from tails[k] to heads[k].

    Each edge is there in both directions, sorted by tails.
    """

    count: int
    tails: Integers
    heads: Integers

    @classmethod
    def of(cls, adjacent: Adjacency) -> SparseGraph:
        """The graph of sets of neighbours."""
        degrees = np.fromiter(map(len, adjacent), np.intp, len(adjacent))
        tails = np.repeat(np.arange(len(adjacent)), degrees)
        heads = np.fromiter(chain.from_iterable(adjacent), np.intp, tails.size)
        return cls(len(adjacent), tails, heads)

    @property
    def degrees(self) -> Integers:
        """The number of neighbours of each vertex, (count,)."""
        found: Integers = np.bincount(self.tails, minlength=self.count)
        return found

    def part(self, inside: Mask) -> SparseGraph:
        """The graph of some of the vertices, in their order."""
        place = np.cumsum(inside) - 1
        both = inside[self.tails] & inside[self.heads]
        return SparseGraph(int(inside.sum()), place[self.tails[both]], place[self.heads[both]])

    def without(self, edges: Mask) -> SparseGraph:
        """The graph less some of its edges, which are marked in both directions."""
        return SparseGraph(self.count, self.tails[~edges], self.heads[~edges])

    def components(self) -> Integers:
        """The number of the connected component of each vertex, (count,), from 0 on."""
        from scipy.sparse import csr_array  # here and below, since they are slow to import
        from scipy.sparse.csgraph import connected_components

        edges = np.ones(self.tails.size, dtype=np.int8), (self.tails, self.heads)
        matrix = csr_array(edges, shape=(self.count, self.count))
        found: Integers = connected_components(matrix, directed=False)[1].astype(np.intp)
        return found

    def levels(self, starts: Integers) -> Integers:
        """How far each vertex is from that of its component among `starts`, (count,)."""
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import breadth_first_order

        # All components are searched at once, from one more vertex that leads to their starts.
        heads = np.concatenate([self.heads, starts])
        first = np.zeros(self.count + 2, dtype=np.intp)
        np.cumsum(self.degrees, out=first[1:-1])
        first[-1] = heads.size
        size = self.count + 1
        matrix = csr_array((np.ones(heads.size, dtype=np.int8), heads, first), shape=(size, size))
        order, before = breadth_first_order(matrix, self.count)
        rank = np.empty(size, dtype=np.intp)
        rank[order] = np.arange(order.size)
        # A level begins behind the last vertex that is reached from the level before the last.
        reached = rank[before[order[1:]]].tolist()
        bounds = [1]
        while bounds[-1] < order.size:
            bounds.append(bisect_left(reached, bounds[-1]) + 1)
        found = np.empty(self.count, dtype=np.intp)
        found[order[1:]] = np.repeat(np.arange(len(bounds) - 1), np.diff(bounds))
        return found

    def by_degree(self) -> Integers:
        """An elimination order by minimum degree, (count,).

        SuperLU orders the columns of a matrix before it factorises it, and tells the order with the
        factors alone. Factorising takes ten times as long; an incomplete factorisation that drops
        all it can has the same order, and takes next to nothing. The matrix is diagonally dominant,
        so that no pivot is zero.

        Source: Liu (1985), Modification of the minimum-degree algorithm by multiple elimination.
        """
        from scipy.sparse import csc_array
        from scipy.sparse.linalg import spilu

        if not self.count:
            return np.zeros(0, dtype=np.intp)
        each = np.arange(self.count)
        values = np.concatenate([np.full(self.tails.size, -1.0), self.degrees + 1.0])
        places = np.concatenate([self.tails, each]), np.concatenate([self.heads, each])
        factors = spilu(
            csc_array((values, places), shape=(self.count, self.count)),
            drop_tol=1.0,
            fill_factor=1.0,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        # SciPy's perm_c tells where in the order each column stands.
        found: Integers = np.argsort(factors.perm_c)
        return found
