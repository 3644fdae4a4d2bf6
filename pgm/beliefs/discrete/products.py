"""Messages multiplied into tables: the map of table entries to message columns.

Flat storage holds the tables, (entries, [runs]), where [runs] is an axis that a single run lacks;
[runs or 1] is of length one for tables that are the same in all runs. An array of *columns*,
(columns, [runs]), holds all messages to the roots: one column for each joint state of a message's
sepset. A *stack* is some clusters of like shape, whose tables together take one slice of the
storage. Each entry of a table is multiplied by the column of a message whose states agree with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.discrete.place import Merged, Place
from pgm.factors.axes import States, sizes
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import Semiring

# NumPy loops over the last axis. Where that is shorter than `SHORT`, a message is copied out along
# last axes of at most `WIDE` entries together, so that loops are over these.
SHORT, WIDE = 8, 128


@dataclass(frozen=True, eq=False)
class GatheredProduct:
    """The product of the tables of a stack and a few messages to each of them, by an index.

    In shapes, messages is the number of messages to each table, the same for all of the stack.

    children: (messages, clusters): for each cluster of the stack, the numbers of the senders.
    index: (messages, entries): for each entry of the stack, the column of each message by which the
        entry is multiplied.
    """

    children: Integers
    index: Integers

    def multiply(self, source: Array, messages: Array, semiring: Semiring, out: Array) -> None:
        """Write the product of the stack's tables and their messages to `out`.

        source: (entries of the stack, [runs or 1]): the tables.
        messages: (columns, [runs]): all messages, in the entries of the semiring.
        out: (entries of the stack, [runs]); it may be `source` itself.
        """
        if len(self.index) == 1:
            product = messages.take(self.index[0], 0)
        else:
            product = semiring.times.reduce(messages.take(self.index, 0), 0)
        semiring.times(source, product, out)

    def columns(self, at: Integers) -> Integers:
        """The columns by which one entry of each cluster's table is multiplied in each run.

        `at`, (clusters, runs), are the indices of these entries, counted from the stack's first.
        The result is (messages, clusters, runs): one column of each message to a cluster.
        """
        return self.index.take(at, 1)


@dataclass(frozen=True, eq=False)
class BlockProduct:
    """One message to a large, contiguous table: the message is broadcast, and no index is needed.

    children: (1, 1): the number of the sender.
    place: The table's place in flat storage.
    sepset: The variables of the message, in the order of its columns.
    view: The shape of the table with merged axes: neighbouring axes are merged if their variables
        are all in the sepset, or none is.
    source: The slice of the message's columns in an array of all messages.
    wide: The first of those last axes of `view` along which the message of a single run is repeated
        in memory before it is multiplied. This is done if the very last axis is short, for NumPy
        would then loop over a few entries at a time. Else `wide` is the number of axes of `view`.
    """

    children: Integers
    place: Place
    sepset: States
    view: Merged
    source: slice
    wide: int

    @classmethod
    def of(cls, child: int, place: Place, sepset: States, first: int) -> BlockProduct:
        """The product of a large table and a child's message, whose columns begin at `first`.

        `child` is the child's number, `place` the table's place in flat storage, and `sepset` has
        the variables of the message, in the order of its columns.
        """
        source = slice(first, first + math.prod(sizes(sepset)))
        view = place.merged(sepset)
        wide = len(view.shape)
        if view.shape[-1] < SHORT:
            while wide and math.prod(view.shape[wide - 1 :]) <= WIDE:
                wide -= 1
        return cls(np.array([[child]]), place, sepset, view, source, wide)

    def multiply(self, source: Array, messages: Array, semiring: Semiring, out: Array) -> None:
        """Write the product of the table and its message to `out`.

        source: (entries of the table, [runs or 1]): the table.
        messages: (columns, [runs]): all messages, in the entries of the semiring.
        out: (entries of the table, [runs]); it may be `source` itself.
        """
        table = source.reshape((*self.view.shape, *source.shape[1:]))
        message = self.view.spread(messages[self.source])
        if message.ndim == len(self.view.shape):
            shape = message.shape[: self.wide] + self.view.shape[self.wide :]
            message = np.ascontiguousarray(np.broadcast_to(message, shape))
        semiring.times(table, message, out.reshape((*self.view.shape, *out.shape[1:])))

    def columns(self, at: Integers) -> Integers:
        """The column by which one entry of the table is multiplied in each run, (1, 1, runs).

        `at`, (1, runs), are the indices of these entries, counted from the table's first.
        """
        stored = self.place.stored
        states = np.unravel_index(at, sizes(stored))
        own = tuple(states[stored.index(v)] for v in self.sepset)
        column = np.ravel_multi_index(own, sizes(self.sepset)) if own else np.zeros_like(at)
        columns: Integers = self.source.start + column[None]
        return columns


Product = GatheredProduct | BlockProduct
