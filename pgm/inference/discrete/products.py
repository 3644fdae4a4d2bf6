"""Messages multiplied into tables: the map of table entries to message columns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pgm.factors.axes import States, sizes
from pgm.inference.discrete.place import Merged, Place
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import Semiring

# A product whose last axis is shorter is a loop over so few entries; the message is written out for
# blocks of at most so many.
SHORT, WIDE = 8, 128


@dataclass(frozen=True, eq=False)
class GatheredProduct:
    """Messages to the tables of a stack, of any kind.

    children: (messages, clusters): the senders, for each cluster of the stack.
    index: (messages, entries): the columns.
    """

    children: Integers
    index: Integers

    def multiply(self, source: Array, messages: Array, semiring: Semiring, out: Array) -> None:
        """Multiply entries and messages; the entries may be those that the products replace."""
        if len(self.index) == 1:
            product = messages.take(self.index[0], 0)
        else:
            product = semiring.times.reduce(messages.take(self.index, 0), 0)
        semiring.times(source, product, out)

    def columns(self, at: Integers) -> Integers:
        """The columns that meet some entries, (clusters, runs): (messages, clusters, runs)."""
        return self.index.take(at, 1)


@dataclass(frozen=True, eq=False)
class BlockProduct:
    """A message to a contiguous table.

    children: (1, 1): the sender.
    wide: The axis from which on the message of a single run is written out for all entries.
    """

    children: Integers
    place: Place
    sepset: States
    view: Merged
    source: slice
    wide: int

    @classmethod
    def of(cls, child: int, place: Place, sepset: States, first: int) -> BlockProduct:
        """The product of a large table and a child's message, whose columns begin at `first`."""
        source = slice(first, first + math.prod(sizes(sepset)))
        view = place.merged(sepset)
        wide = len(view.shape)
        if view.shape[-1] < SHORT:
            while wide and math.prod(view.shape[wide - 1 :]) <= WIDE:
                wide -= 1
        return cls(np.array([[child]]), place, sepset, view, source, wide)

    def multiply(self, source: Array, messages: Array, semiring: Semiring, out: Array) -> None:
        """Multiply entries and the message; the entries may be those that the products replace."""
        table = source.reshape((*self.view.shape, *source.shape[1:]))
        message = self.view.spread(messages[self.source])
        if message.ndim == len(self.view.shape):
            shape = message.shape[: self.wide] + self.view.shape[self.wide :]
            message = np.ascontiguousarray(np.broadcast_to(message, shape))
        semiring.times(table, message, out.reshape((*self.view.shape, *out.shape[1:])))

    def columns(self, at: Integers) -> Integers:
        """The columns that meet some entries."""
        stored = self.place.stored
        states = np.unravel_index(at, sizes(stored))
        own = tuple(states[stored.index(v)] for v in self.sepset)
        column = np.ravel_multi_index(own, sizes(self.sepset)) if own else np.zeros_like(at)
        columns: Integers = self.source.start + column[None]
        return columns


Product = GatheredProduct | BlockProduct
