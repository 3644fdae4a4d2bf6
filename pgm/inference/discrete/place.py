"""Where one table stands in the flat storage."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from pgm.factors.axes import States, sizes
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Discrete

# Tables of this many entries stand by themselves, and are summed and multiplied where they stand:
# positions of their entries, which serve many small tables in one call, would take more room.
LARGE = 2**13


@dataclass(frozen=True, eq=False)
class Place:
    """Where one table stands: entry (row, column) at ``start + row·down + column·across``.

    Attributes
    ----------
    scope : tuple of Discrete
        Its axes: those of the rows, then those of the columns.
    rows, columns : int
        Entries of the axes of either kind.
    start, down, across : int
    large : bool
        Whether it stands by itself and is used where it stands.
    """

    scope: States
    rows: int
    columns: int
    start: int
    down: int
    across: int
    large: bool

    @property
    def entries(self) -> slice:
        """Where a table stands that stands by itself."""
        return slice(self.start, self.start + self.rows * self.columns)

    @property
    def stored(self) -> States:
        """The axes of a table that stands by itself, the last one with entries side by side."""
        if self.down >= self.across:
            return self.scope
        count = 0
        rows = 1
        while rows < self.rows:
            rows *= self.scope[count].size
            count += 1
        return self.scope[count:] + self.scope[:count]

    def positions(self, scope: States) -> Integers:
        """Where its entries stand, with an axis for each variable of a scope."""
        row, column = np.arange(self.rows), np.arange(self.columns)
        flat = self.start + self.down * row[:, None] + self.across * column
        axis = {variable: k for k, variable in enumerate(self.scope)}
        return flat.reshape(sizes(self.scope)).transpose([axis[v] for v in scope])

    def split(self, variable: Discrete) -> Integers:
        """Where its entries stand, (states of a variable, entries with each)."""
        others = tuple(v for v in self.scope if v != variable)
        positions = np.ascontiguousarray(self.positions((variable, *others)))
        return positions.reshape(variable.size, -1)

    def table(self, tables: Array, scope: States) -> Array:
        """A view of a table that stands by itself, (sizes of a scope..., [runs])."""
        stored, tail = self.stored, tables.shape[1:]
        axes = [stored.index(v) for v in scope] + list(range(len(scope), len(scope) + len(tail)))
        return tables[self.entries].reshape((*sizes(stored), *tail)).transpose(axes)

    def by_state(self, tables: Array, variable: Discrete) -> Array:
        """A view of a table that stands by itself, (before, states, after, [runs])."""
        stored = self.stored
        before = math.prod(sizes(stored[: stored.index(variable)]))
        shape = (before, variable.size, -1, *tables.shape[1:])
        return tables[self.entries].reshape(shape)

    def merged(self, wanted: States) -> Merged:
        """The axes of a table that stands by itself, as few as tell some variables apart."""
        stored = self.stored
        runs = [list(same) for _, same in groupby(stored, wanted.__contains__)]
        order = [v for v in stored if v in wanted]
        return Merged(
            tuple(math.prod(sizes(tuple(run))) for run in runs),
            tuple(k for k, run in enumerate(runs) if run[0] not in wanted),
            sizes(tuple(order)),
            tuple(order.index(v) for v in wanted),
        )


@dataclass(frozen=True, eq=False)
class Merged:
    """A table with neighbouring axes made one, where they are all wanted or all others.

    Attributes
    ----------
    shape : tuple of int
    others : tuple of int
        The axes that are not wanted.
    sizes : tuple of int
        Of the wanted variables, as they are stored.
    order : tuple of int
        The place among these of each wanted variable.
    """

    shape: tuple[int, ...]
    others: tuple[int, ...]
    sizes: tuple[int, ...]
    order: tuple[int, ...]

    def axes(self, tail: int) -> tuple[int, ...]:
        """The permutation of wanted variables from the stored order to that asked for."""
        return (*self.order, *range(len(self.order), len(self.order) + tail))

    def spread(self, values: Array) -> Array:
        """Values (entries of the wanted variables, [runs]), to be combined with the table."""
        tail = values.shape[1:]
        asked = [self.sizes[k] for k in self.order]
        stored = np.argsort(self.order).tolist()
        stored += range(len(asked), len(asked) + len(tail))
        kept = [1 if k in self.others else n for k, n in enumerate(self.shape)]
        return values.reshape((*asked, *tail)).transpose(stored).reshape((*kept, *tail))
