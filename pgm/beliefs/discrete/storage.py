"""The layout of a graph's tables in one flat array, whose last axis is of runs.

The array is (entries, [runs]), where [runs] is an axis that a single run lacks. The *home* of a
variable is the smallest cluster that holds it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import cast

import numpy as np

from pgm.beliefs.discrete.place import LARGE, Place, View, by_state
from pgm.beliefs.discrete.sums import Marginals
from pgm.clustergraph import ClusterGraph
from pgm.cpds import TableCPD
from pgm.errors import NumericalError
from pgm.factors import Table
from pgm.factors.axes import States, discrete, spread
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT, Semiring
from pgm.variables import Discrete


@dataclass(frozen=True, eq=False)
class Storage:
    """Where the tables of a graph's clusters stand in one flat array.

    graph: The cluster graph.
    places: Of each cluster, the first index and the strides of its table in the flat array.
    """

    graph: ClusterGraph
    places: Sequence[Place]

    @cached_property
    def entries(self) -> int:
        """The number of entries of all tables together, in one run."""
        return sum(self.graph.sizes)

    @cached_property
    def scopes(self) -> tuple[States, ...]:
        """The variables of each cluster, in the order of ``cluster.scope``."""
        return tuple(discrete(cluster.scope) for cluster in self.graph.clusters)

    def table(self, entries: Array, cluster: int) -> Array:
        """A view of a cluster's table, with an axis for each variable, then one of runs, if any.

        `entries` is the flat array, (entries or more, [runs]); what stands in it behind the tables
        is not looked at.
        """
        return self.places[cluster].view(self.scopes[cluster]).of(entries)

    @cached_property
    def holders(self) -> dict[Discrete, list[int]]:
        """For each variable, the numbers of the clusters that hold it."""
        found: dict[Discrete, list[int]] = {}
        for cluster, scope in enumerate(self.scopes):
            for variable in scope:
                found.setdefault(variable, []).append(cluster)
        return found

    @cached_property
    def homes(self) -> dict[Discrete, int]:
        """For each variable, the number of its home; of equally small clusters, the first."""
        sizes_of = self.graph.sizes
        return {v: min(found, key=sizes_of.__getitem__) for v, found in self.holders.items()}

    @cached_property
    def by_state(self) -> dict[Discrete, View]:
        """Of each variable, the view of its home's table, with the variable's axis first."""
        return {v: by_state(self.places[home], v) for v, home in self.homes.items()}

    @cached_property
    def logs(self) -> Array:
        """The logarithms of the clusters' potentials, (entries,)."""
        try:
            return self.potentials(LOG_SUM_PRODUCT)
        except FloatingPointError:
            raise NumericalError(
                "the log-scales of factors add to more than float64 holds; take what they have in "
                "common out of them"
            ) from None

    @cached_property
    def marginals(self) -> Marginals:
        """The sums that make the marginals of all variables, each from its home's table."""
        homes = {variable: self.places[home] for variable, home in self.homes.items()}
        return Marginals.of(homes, self.entries)

    def potentials(self, semiring: Semiring, room: int = 0) -> Array:
        """The product of each cluster's factors, in entries of a semiring, (entries + room,).

        The last `room` entries are for the caller's use and are filled with the semiring's one.

        Raises
        ------
        FloatingPointError
            If the semiring is of numbers, and a product under- or overflows.
        """
        flat = np.full(self.entries + room, semiring.one)
        for cluster, scope in zip(self.graph.clusters, self.scopes, strict=True):
            table = self.table(flat, cluster.index)
            for factor in cast(tuple[Table | TableCPD, ...], cluster.factors):
                potential = factor._potential
                with np.errstate(under="raise", over="raise"):
                    entries = spread(potential.entries(semiring), potential.axes, scope)
                    semiring.times(table, entries, out=table)
        return flat


def contiguous(graph: ClusterGraph) -> Storage:
    """The storage with one table after the other, each in C order of its cluster's scope."""
    starts = accumulate(graph.sizes, initial=0)
    clusters = zip(graph.clusters, starts, strict=False)
    return Storage(graph, [Place.of(discrete(c.scope), start, LARGE) for c, start in clusters])


def sepset_between(graph: ClusterGraph, i: int, j: int) -> States:
    """The sepset of two neighbours, given by number; empty if one is −1, the parent of a root."""
    return discrete(graph.sepsets[min(i, j), max(i, j)]) if min(i, j) >= 0 else ()
