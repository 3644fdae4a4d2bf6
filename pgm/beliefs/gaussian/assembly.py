"""Factors of a network, and where the rows of each stand among those of all.

The *factor* of a CPD is exp(−½ ‖A x − r‖²): the matrix A has a row for each component of the child,
and a column for each hidden component x of child and parents. A component's *place* is its index
in the vector of all hidden components.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from pgm.kernels.arrays import Array, Integers


class Factors(Protocol):
    """Factors of one shape: where their rows, over hidden components, belong."""

    @property
    def places(self) -> Integers:
        """The places of the columns of each matrix A, (factors, width)."""

    @property
    def clusters(self) -> Integers:
        """The number of the cluster that each factor is assigned to, (factors,)."""

    @property
    def height(self) -> int:
        """The number of rows of each A."""


class Given(NamedTuple):
    """Factors given by what `Factors` tells of them."""

    places: Integers
    clusters: Integers
    height: int = 1


@dataclass(frozen=True, eq=False)
class Assembly:
    """Factors over so many components, of which rows and entries stand one after another's."""

    size: int
    factors: Sequence[Factors]

    @cached_property
    def entry_starts(self) -> Integers:
        """Where the entries of each item's rows begin, then where all end, (items + 1,).

        An item has factors of one shape: all rows of one stand together, then those of the next.
        """
        return np.cumsum([0, *(f.places.size * f.height for f in self.factors)])

    @cached_property
    def row_starts(self) -> Integers:
        """Where each item's rows begin, as `entry_starts`, then where all end, (items + 1,)."""
        return np.cumsum([0, *(len(f.places) * f.height for f in self.factors)])

    @cached_property
    def clusters(self) -> Integers:
        """The clusters of all factors, one after another's."""
        return np.concatenate([np.zeros(0, dtype=np.intp), *(f.clusters for f in self.factors)])

    def matrices(self, k: int, entries: Array) -> Array:
        """The matrices (V, factors, height, width) of item k, of all `entries` (V, entries)."""
        own = self.factors[k]
        found = entries[:, self.entry_starts[k] : self.entry_starts[k + 1]]
        return found.reshape(len(entries), len(own.places), own.height, own.places.shape[1])

    def sides(self, k: int, right: Array) -> Array:
        """The right sides (V, factors, height, N) of item k, of those of all rows (V, rows, N)."""
        own = self.factors[k]
        found = right[:, self.row_starts[k] : self.row_starts[k + 1]]
        return found.reshape(len(right), len(own.places), own.height, right.shape[-1])
