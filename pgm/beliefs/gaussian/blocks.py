"""Blocks of components: those of the clusters of a graph, or of the fronts of a tree.

A component's *place* is its index in the vector of all hidden components; its *column* is its
index in a block that holds it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.kernels.arrays import Integers


@dataclass(frozen=True, eq=False)
class Blocks:
    """Which components each block holds, in the order of its columns.

    Attributes
    ----------
    count : int
        How many components there are.
    sizes : ndarray of int
        How many of them each block has, (blocks,).
    components : ndarray of int
        Their places, block by block.
    """

    count: int
    sizes: Integers
    components: Integers

    def __len__(self) -> int:
        return self.sizes.size

    @cached_property
    def starts(self) -> Integers:
        """Where each block begins in `components`, then where all end, (blocks + 1,)."""
        return np.concatenate([[0], np.cumsum(self.sizes)]).astype(np.intp)

    @cached_property
    def _sorted(self) -> tuple[Integers, Integers]:
        """Numbers of all pairs of a block and a component of it, ascending, and their indices."""
        keys = np.repeat(np.arange(len(self)) * self.count, self.sizes) + self.components
        order = np.argsort(keys, kind="stable")
        return keys[order], order

    def columns(self, blocks: Integers, places: Integers) -> Integers:
        """The columns (B, n) of components at `places` (B, n) in `blocks` (B,), which hold them."""
        keys, order = self._sorted
        found = np.searchsorted(keys, blocks[:, None] * self.count + places)
        return order[found] - self.starts[blocks][:, None]

    def hold(self, places: Integers) -> Integers:
        """The blocks that hold all components at `places` (n,)."""
        wanted = np.zeros(self.count, dtype=bool)
        wanted[places] = True
        blocks = np.repeat(np.arange(len(self)), self.sizes)[wanted[self.components]]
        return np.flatnonzero(np.bincount(blocks, minlength=len(self)) == np.unique(places).size)

    @cached_property
    def homes(self) -> tuple[Integers, Integers]:
        """The smallest block that holds each component, and its column in it, (count,) each.

        Of equally small ones it is the first.
        """
        blocks = np.repeat(np.arange(len(self)), self.sizes)
        order = np.lexsort((blocks, self.sizes[blocks], self.components))
        _, first = np.unique(self.components[order], return_index=True)
        home = blocks[order[first]]
        return home, order[first] - self.starts[home]
