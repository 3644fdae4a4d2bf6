"""A table's place in flat storage: its first index, and the strides of its axes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import numpy as np

from pgm.factors.axes import States, sizes, without
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Discrete

# Tables of this many entries stand by themselves, and are summed and multiplied where they stand:
# positions of their entries, which serve many small tables in one call, would take more room.
LARGE = 2**13


@dataclass(frozen=True, eq=False)
class Place:
    """A table's place in flat storage: its first index, and the strides of its axes.

    steps: How many entries on the next state of a variable is.
    large: Whether it stands by itself and is used where it stands.
    """

    scope: States
    start: int
    steps: Mapping[Discrete, int]
    large: bool

    @classmethod
    def of(cls, scope: States, start: int, least: int) -> Place:
        """A view of the table in flat storage, with its axes, and an axis of runs if any."""
        return cls(scope, start, steps(scope, 1), math.prod(sizes(scope)) >= least)

    @cached_property
    def size(self) -> int:
        """The number of its entries."""
        return math.prod(sizes(self.scope))

    @property
    def entries(self) -> slice:
        """The slice of a table that is contiguous."""
        return slice(self.start, self.start + self.size)

    @property
    def stored(self) -> States:
        """The axes of a contiguous table, the last one with entries side by side."""
        return tuple(sorted(self.scope, key=self.steps.__getitem__, reverse=True))

    def positions(self, scope: States) -> Integers:
        """The positions of its entries, with an axis for each variable of a scope."""
        return positions(self.start, self.steps, scope)

    def view(self, scope: States) -> View:
        """The view of the table with an axis for each variable of a scope."""
        entry = np.dtype(np.float64).itemsize
        strides = tuple(entry * self.steps[variable] for variable in scope)
        return View(sizes(scope), entry * self.start, strides)

    def merged(self, wanted: States) -> Merged:
        """The axes of a contiguous table, as few as tell some variables apart."""
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
class View:
    """A view of a table with its axes in some order.

    start: Where its first entry is, in bytes, of a single run.
    strides: How many bytes on the next state of each variable is.
    """

    shape: tuple[int, ...]
    start: int
    strides: tuple[int, ...]

    def of(self, tables: Array) -> Array:
        """A view of the table with these axes, and an axis of runs if any."""
        if tables.ndim == 1:
            return np.ndarray(self.shape, np.float64, tables, self.start, self.strides)
        runs = tables.shape[1]
        strides = (*(runs * stride for stride in self.strides), tables.itemsize)
        return np.ndarray((*self.shape, runs), np.float64, tables, runs * self.start, strides)


def by_state(place: Place, variable: Discrete) -> View:
    """The view of a table with the axis of a variable first."""
    return place.view((variable, *without(place.scope, (variable,))))


def steps(scope: States, last: int) -> dict[Discrete, int]:
    """Strides of axes in C order, given the stride of the last."""
    found: dict[Discrete, int] = {}
    for variable in reversed(scope):
        found[variable] = last
        last *= variable.size
    return found


def positions(start: int, step: Mapping[Discrete, int], scope: States) -> Integers:
    """Entries that steps lead to from a first one, with an axis for each variable of a scope.

    A variable that has no step leads nowhere.
    """
    found: Integers = np.array(start)
    for variable in scope:
        found = found[..., None] + step.get(variable, 0) * np.arange(variable.size)
    return found


@dataclass(frozen=True, eq=False)
class Merged:
    """A table with neighbouring axes made one, where they are all wanted or all others.

    others: The axes that are not wanted.
    sizes: Of the wanted variables, as they are stored.
    order: The place among these of each wanted variable.
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
