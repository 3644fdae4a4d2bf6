"""Where the tables of a graph stand in one flat array, whose last axis, if any, is of runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.cpds import TableCPD
from pgm.factors.axes import States, discrete, sizes
from pgm.inference.discrete.place import LARGE, Place
from pgm.inference.discrete.sums import Marginals
from pgm.inference.forest import Forest
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import Semiring
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False)
class Storage:
    """The flat array of a graph's tables.

    Attributes
    ----------
    graph : ClusterGraph
    places : sequence of Place
        Of each cluster.
    """

    graph: ClusterGraph
    places: Sequence[Place]

    @cached_property
    def entries(self) -> int:
        """The length of the array."""
        return sum(self.graph.sizes)

    @cached_property
    def scopes(self) -> tuple[States, ...]:
        """The variables of each cluster, in its own order."""
        return tuple(discrete(cluster.scope) for cluster in self.graph.clusters)

    def positions(self, cluster: int) -> Integers:
        """Where the entries of a cluster's table stand, with an axis for each variable."""
        return self.places[cluster].positions(self.scopes[cluster])

    def table(self, entries: Array, cluster: int) -> Array:
        """A cluster's table, with an axis for each variable, then that of the runs, if any."""
        place, scope = self.places[cluster], self.scopes[cluster]
        return place.table(entries, scope) if place.large else entries[place.positions(scope)]

    @cached_property
    def holders(self) -> dict[Discrete, list[int]]:
        """The clusters that hold each variable."""
        found: dict[Discrete, list[int]] = {}
        for cluster, scope in enumerate(self.scopes):
            for variable in scope:
                found.setdefault(variable, []).append(cluster)
        return found

    @cached_property
    def homes(self) -> dict[Discrete, int]:
        """The smallest cluster that holds each variable, the first of equals."""
        sizes_of = self.graph.sizes
        return {v: min(found, key=sizes_of.__getitem__) for v, found in self.holders.items()}

    @cached_property
    def by_state(self) -> dict[Discrete, Integers | Place]:
        """Where the entries of each variable's home stand, (states, entries with each).

        The place of the home, where that is large.
        """
        found: dict[Discrete, Integers | Place] = {}
        for variable, home in self.homes.items():
            place = self.places[home]
            found[variable] = place if place.large else place.split(variable)
        return found

    @cached_property
    def marginals(self) -> Marginals:
        """The sums of the tables to the probabilities of each variable."""
        return Marginals.of(self.by_state, self.entries)

    def potentials(self, semiring: Semiring, room: int = 0) -> Array:
        """The product of each cluster's CPDs, (entries + room,).

        Raises
        ------
        FloatingPointError
            If numbers are wanted, and one is below what a number holds.
        """
        flat = np.full(self.entries + room, semiring.one)
        for cluster, scope in zip(self.graph.clusters, self.scopes, strict=True):
            axis: dict[Variable, int] = {variable: k for k, variable in enumerate(scope)}
            place = self.places[cluster.index]
            table = place.table(flat, scope) if place.large else np.full(sizes(scope), semiring.one)
            for cpd in cast(tuple[TableCPD, ...], cluster.cpds):
                given = [axis[v] for v in (*cpd.given, cpd.child)]
                entries = semiring.entries(cpd.table)
                shape = np.ones(len(scope), dtype=np.intp)
                shape[given] = entries.shape
                with np.errstate(under="raise"):
                    semiring.times(
                        table, entries.transpose(np.argsort(given)).reshape(shape), out=table
                    )
            if not place.large:
                flat[place.positions(scope)] = table
        return flat


def contiguous(graph: ClusterGraph) -> Storage:
    """One table after the other, each in the order of its cluster's scope."""
    starts = np.cumsum([0, *graph.sizes]).tolist()
    places = [
        Place(discrete(c.scope), 1, size, start, size, 1, size >= LARGE)
        for c, size, start in zip(graph.clusters, graph.sizes, starts, strict=False)
    ]
    return Storage(graph, places)


def sepset_to_parent(graph: ClusterGraph, forest: Forest, cluster: int) -> States:
    """The variables that a cluster shares with its parent; of a root none."""
    parent = int(forest.parent[cluster])
    edge = (min(cluster, parent), max(cluster, parent))
    return discrete(graph.sepsets[edge]) if parent >= 0 else ()
