"""Tables in flat storage: the place of each, views of it, and its shape with axes merged.

The flat storage holds the tables of all clusters, (entries, [runs]), in C order; [runs] is an axis
that a single run lacks. Small tables may be interleaved; a table is *contiguous* if its entries
stand together. Strides count entries, of a single run, if nothing else is said.
"""

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

    scope: The table's variables.
    start: The index of the table's first entry.
    steps: Of each variable, the stride of its axis, in entries.
    large: Whether the table is contiguous and is used where it stands; the entries of a table that
        is not large are gathered by their positions.
    """

    scope: States
    start: int
    steps: Mapping[Discrete, int]
    large: bool

    @classmethod
    def of(cls, scope: States, start: int, least: int) -> Place:
        """The place of a contiguous table in C order of a scope, whose first entry is at `start`.

        The table is `large` if it has `least` entries or more.
        """
        return cls(scope, start, steps(scope, 1), math.prod(sizes(scope)) >= least)

    @cached_property
    def size(self) -> int:
        """The number of the table's entries."""
        return math.prod(sizes(self.scope))

    @property
    def entries(self) -> slice:
        """The slice of flat storage that a contiguous table takes."""
        return slice(self.start, self.start + self.size)

    @property
    def stored(self) -> States:
        """The variables of a contiguous table by the strides of their axes, the largest first."""
        return tuple(sorted(self.scope, key=self.steps.__getitem__, reverse=True))

    def positions(self, scope: States) -> Integers:
        """The positions of the table's entries, with an axis for each variable of a scope.

        The positions are indices into the flat storage. `scope` has all variables of the table, in
        any order, and may have others, along whose axes the positions are constant.
        """
        return positions(self.start, self.steps, scope)

    def view(self, scope: States) -> View:
        """The view of the table with an axis for each variable of `scope`, in that order.

        `scope` has the same variables as the table, in any order.
        """
        entry = np.dtype(np.float64).itemsize
        strides = tuple(entry * self.steps[variable] for variable in scope)
        return View(sizes(scope), entry * self.start, strides)

    def merged(self, wanted: States) -> Merged:
        """The shape of this contiguous table with neighbouring axes merged.

        The table is to be summed to the variables `wanted`, or multiplied by an array over them.
        Axes that follow one another are merged if their variables are all wanted, or none is, so
        that the sum or product has few axes. The order of `wanted` is that of the axes of the sum's
        result, or of the array.
        """
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
    """A view of a table in flat storage, with its axes in some order.

    The offset and the strides, in bytes, are for storage of a single run; in storage of several
    they are multiplied by the number of runs.

    shape: The numbers of states along the axes, in that order.
    start: The offset of the first entry.
    strides: The strides of the axes.
    """

    shape: tuple[int, ...]
    start: int
    strides: tuple[int, ...]

    def of(self, tables: Array) -> Array:
        """The table in the flat storage `tables`, (entries, [runs]), as a view (*shape, [runs])."""
        if tables.ndim == 1:
            return np.ndarray(self.shape, np.float64, tables, self.start, self.strides)
        runs = tables.shape[1]
        strides = (*(runs * stride for stride in self.strides), tables.itemsize)
        return np.ndarray((*self.shape, runs), np.float64, tables, runs * self.start, strides)


def by_state(place: Place, variable: Discrete) -> View:
    """The view of a table with the axis of a variable first, then the others in their order."""
    return place.view((variable, *without(place.scope, (variable,))))


def steps(scope: States, last: int) -> dict[Discrete, int]:
    """The stride of each variable's axis, in entries, for axes in C order of a scope.

    `last` is the stride of the last axis.
    """
    found: dict[Discrete, int] = {}
    for variable in reversed(scope):
        found[variable] = last
        last *= variable.size
    return found


def positions(start: int, step: Mapping[Discrete, int], scope: States) -> Integers:
    """The indices start + Σ_v step[v] · (state of v), with an axis for each variable v of a scope.

    A variable that `step` does not have counts with step 0.
    """
    found: Integers = np.array(start)
    for variable in scope:
        found = found[..., None] + step.get(variable, 0) * np.arange(variable.size)
    return found


@dataclass(frozen=True, eq=False)
class Merged:
    """The shape of a contiguous table, with axes merged for sums and products over few axes.

    Some variables of the table are *wanted*: the table is summed to these variables, or multiplied
    by an array over them. The result, or that array, has the variables in an order of its own, the
    order *asked for*. Neighbouring axes of the table are merged if their variables are all wanted,
    or none is.

    shape: The lengths of the merged axes, without that of runs.
    others: The indices, in `shape`, of the merged axes that are not of wanted variables.
    sizes: The numbers of states of the wanted variables, in the order in which they are stored.
    order: Of each wanted variable, in the order asked for, its index in `sizes`.
    """

    shape: tuple[int, ...]
    others: tuple[int, ...]
    sizes: tuple[int, ...]
    order: tuple[int, ...]

    def axes(self, tail: int) -> tuple[int, ...]:
        """The axes by which `transpose` brings an array (*sizes, [runs]) to the order asked for.

        `tail` is the number of the array's axes of runs, 1 or 0.
        """
        return (*self.order, *range(len(self.order), len(self.order) + tail))

    def spread(self, values: Array) -> Array:
        """Values over the wanted variables, reshaped to broadcast with the table of merged axes.

        `values` are (joint states in the order asked for, [runs]); the result is (*shape, [runs]),
        with length 1 for the axes `others`.
        """
        tail = values.shape[1:]
        asked = [self.sizes[k] for k in self.order]
        stored = np.argsort(self.order).tolist()
        stored += range(len(asked), len(asked) + len(tail))
        kept = [1 if k in self.others else n for k, n in enumerate(self.shape)]
        return values.reshape((*asked, *tail)).transpose(stored).reshape((*kept, *tail))
