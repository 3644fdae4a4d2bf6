"""Tables whose arrays have names, by which they are found again for other plans of the same form.

A chain is told in two parts (`kernels.machine.sweeps.told`): the key of its code, and the places of
its numbers. The key is found once for plans of one form. The places are found for each sweep: a
form keeps how the owners of arrays are asked for them, and asks those of the plan at hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.compiled.called import Calls
from pgm.beliefs.moments.compiled.table import Get, Integers64, Record, Table, readable
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels.arrays import Array, address
from pgm.kernels.machine.sweeps import told


class Named(NamedTuple):
    """An array of a plan: its place in a table, its owner's number, and how that is asked for it.

    `lies` is how it lay when the code was made, as it has to lie again; None where that is no
    matter. `copied` says that machine code cannot read it as it lies.
    """

    place: int
    owner: int
    get: Get
    lies: tuple[Any, ...] | None = None
    copied: bool = False


class Filled(NamedTuple):
    """The numbers of a table for one sweep, and the arrays by the places of their addresses."""

    numbers: Integers64
    arrays: Mapping[int, npt.NDArray[Any]]


class Form(NamedTuple):
    """The table of a sweep for plans of one form: its numbers, and the names of its arrays."""

    numbers: Sequence[int]
    named: Sequence[Named]

    def filled(self, owners: Sequence[Any], *first: int) -> Filled | None:
        """The table of arrays of these owners; None where they do not lie as the code has them.

        It begins with the numbers `first`.
        """
        numbers, arrays = [*first, *self.numbers[len(first) :]], {}
        for place, owner, get, lies_, copied in self.named:
            array = get(owners[owner])
            if lies_ is not None and lies_ != lies(array):
                return None
            if copied:
                array = readable(array)
            arrays[place] = array
            numbers[place] = address(array)
        return Filled(np.array(numbers, dtype=np.int64), arrays)


class NamedTable(Table):
    """A table that notes how the owners of its arrays, by their number, are asked for them."""

    def __init__(
        self,
        plan: ChainPlan,
        lanes: int,
        owners: Sequence[Any],
        record: Record | None = None,
        calls: Calls | None = None,
    ) -> None:
        super().__init__(plan, lanes, calls)
        self.record = {} if record is None else record
        self._owners = {id(owner): k for k, owner in enumerate(owners)}
        self._named: list[Named] = []

    def of(self, owner: Any, get: Get) -> told.Array:
        """An array that an owner has, told."""
        given = get(owner)
        found = self.array(given)
        copied = readable(given) is not given
        self._note(Named(found.place, self._owners[id(owner)], get, lies(given), copied))
        return found

    def at_of(self, owner: Any, get: Get) -> int:
        """The place in the table of the address of an array that an owner has."""
        place = self.at(get(owner))
        self._note(Named(place, self._owners[id(owner)], get))
        return place

    def put_of(self, place: int, owner: Any, get: Get) -> None:
        """Put the address of an array that an owner has into the table."""
        self.put(place, get(owner))
        self._note(Named(place, self._owners[id(owner)], get))

    @property
    def form(self) -> Form:
        """The names of the arrays, of which others may be of the same form."""
        return Form(self.numbers, self._named)

    def filled(self, *first: int) -> Filled:
        """The table of the arrays that were told of, which begins with the numbers `first`."""
        return Filled(np.array([*first, *self.numbers[len(first) :]], dtype=np.int64), self.arrays)

    def _note(self, named: Named) -> None:
        self._named.append(named)


def lies(array: Array) -> tuple[Any, ...]:
    """How an array (rows, runs, own axes) lies, but for its number of rows."""
    return array.strides, array.shape[0] == 1, array.size == 0, array.shape[1:]
