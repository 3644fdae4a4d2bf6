"""Messages that are multiplied into tables: which column of them meets which entry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pgm.factors.axes import States, sizes
from pgm.inference.discrete.place import Place
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import Semiring


class Product(Protocol):
    """Which column of some messages meets which entry of the tables of a stack.

    Attributes
    ----------
    children : ndarray of int
        (messages, clusters): the senders, for each cluster of the stack.
    """

    @property
    def children(self) -> Integers:
        """The senders."""
        ...

    def multiply(self, entries: Array, messages: Array, semiring: Semiring) -> None:
        """Multiply the messages into the entries."""
        ...

    def columns(self, at: Integers) -> Integers:
        """The columns that meet some entries, (clusters, runs): (messages, clusters, runs)."""
        ...


@dataclass(frozen=True, eq=False)
class GatheredProduct:
    """Messages to tables of any kind.

    Attributes
    ----------
    children : ndarray of int
    index : ndarray of int
        (messages, entries): the columns.
    """

    children: Integers
    index: Integers

    def multiply(self, entries: Array, messages: Array, semiring: Semiring) -> None:
        """Multiply the messages into the entries."""
        if len(self.index) == 1:
            product = messages.take(self.index[0], 0)
        else:
            product = semiring.times.reduce(messages.take(self.index, 0), 0)
        semiring.times(entries, product, entries)

    def columns(self, at: Integers) -> Integers:
        """The columns that meet some entries."""
        return self.index.take(at, 1)


@dataclass(frozen=True, eq=False)
class BlockProduct:
    """A message to a table that stands by itself.

    Attributes
    ----------
    children : ndarray of int
    place : Place
        Of the table.
    sepset : tuple of Discrete
    first : int
        The first column.
    """

    children: Integers
    place: Place
    sepset: States
    first: int

    def multiply(self, entries: Array, messages: Array, semiring: Semiring) -> None:
        """Multiply the message into the table."""
        view = self.place.merged(self.sepset)
        table = entries.reshape((*view.shape, *entries.shape[1:]))
        width = int(np.prod(view.sizes, dtype=np.intp))
        message = view.spread(messages[self.first : self.first + width])
        semiring.times(table, message, table)

    def columns(self, at: Integers) -> Integers:
        """The columns that meet some entries."""
        stored = self.place.stored
        states = np.unravel_index(at, sizes(stored))
        own = tuple(states[stored.index(v)] for v in self.sepset)
        column = np.ravel_multi_index(own, sizes(self.sepset)) if own else np.zeros_like(at)
        return self.first + column[None]
