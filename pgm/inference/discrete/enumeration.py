"""Tiny networks: every table of the tree is a sum of the joint of all variables.

Messages over such a tree are calls on a few numbers each. One product with a matrix of zeros and
ones takes less.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgm.clustergraph.structure import Forest
from pgm.factors.axes import States, sizes
from pgm.inference.discrete.place import positions, steps
from pgm.inference.discrete.storage import Storage
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.tables import SUM_PRODUCT
from pgm.variables import Discrete

# Entries of this matrix, at the most.
TINY = 2**14


@dataclass(frozen=True, eq=False)
class Enumeration:
    """The joint of all variables of a network whose graph is one tree.

    joint: (cells,): probabilities without evidence.
    shown: (states, cells): one in the cells of a state, zero in the others.
    tables: (cells, entries + columns): one where a cell is part of an entry of a cluster or a
        sepset.
    """

    joint: Array
    shown: Mapping[Discrete, Array]
    tables: Array

    @classmethod
    def of(
        cls, storage: Storage, forest: Forest, sepsets: Sequence[States], first: Integers
    ) -> Enumeration | None:
        """The joint of a network; None if it is not tiny, or an entry is too small for a number.

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
            with np.errstate(under="raise"):
                potentials = storage.potentials(SUM_PRODUCT)
                for place, sepset, column in zip(storage.places, sepsets, first, strict=True):
                    entry = place.positions(scope).ravel()
                    start = storage.entries + int(column)
                    tables[each, entry] = 1.0
                    tables[each, positions(start, steps(sepset, 1), scope).ravel()] = 1.0
                    joint *= potentials[entry]
        except FloatingPointError:
            return None
        state = {v: positions(0, {v: 1}, scope).ravel() for v in scope}
        shown = {v: (state[v] == np.arange(v.size)[:, None]).astype(float) for v in scope}
        return cls(joint, shown, tables)

    def given(self, states: Mapping[Discrete, int | Integers]) -> tuple[Array, float]:
        """The tables of a single run, each of which sums to one, and p(evidence).

        Where that is zero, the tables are too.
        """
        cells = self.joint
        for variable, state in states.items():
            cells = cells * self.shown[variable][state]
        total = float(np.add.reduce(cells))
        if total > 0.0:
            cells = cells / total
        return cells.dot(self.tables), total
