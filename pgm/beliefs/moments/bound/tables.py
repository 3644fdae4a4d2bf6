"""The tables of a call's sweeps, one behind another, whose addresses are of a call's arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.beliefs.moments.bound.call import Made
from pgm.beliefs.moments.bound.numbers import Numbers, Varying, ways
from pgm.beliefs.moments.compiled.named_table import Named, NamedTable, lies
from pgm.beliefs.moments.compiled.table import Integers64
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.kernels.arrays import Array, address


class Tables:
    """Tables that are told with the arrays of one call, `mine`, and bound to those of others.

    `owners` own the arrays; those of the same call made again, `other`, show which vary. To the
    `numbers` others may be added before all is bound.
    """

    def __init__(self, mine: Made, other: Made) -> None:
        self._mine, self._other, self.owners = mine, other, mine.owners
        self.numbers: list[int] = []
        self._named: list[tuple[int, Named]] = []
        self._kept: list[Array] = []
        self._varying: list[Varying] = []

    def add(self, table: NamedTable) -> int:
        """Put a table behind the others; the result is where its numbers begin."""
        first = len(self.numbers)
        self.numbers += table.numbers
        for each in table.form.named:
            if each.copied:
                raise Uncompiled("machine code reads a copy of an array")
            self._named.append((each.owner, each._replace(place=first + each.place)))
        return first

    def bind(self) -> None:
        """Bind all that was added; what two calls have in common is the same for all."""
        mine, other, others = self._mine, self._other, self._other.owners
        varying, known = list[Array](), dict(ways(mine.evidence))
        for owner, each in self._named:
            array, theirs = each.get(self.owners[owner]), each.get(others[owner])
            # One that is made when it is asked for lies elsewhere each time.
            self.numbers[each.place] = address(array)
            if array is theirs:
                self._kept.append(array)
            elif not any(np.may_share_memory(array, block) for block in mine.blocks):
                way = known.get(id(array))
                if way is not None and way.of(other.evidence) is not theirs:
                    way = None
                self._varying.append(Varying(way, owner, each.get, each.lies))
                varying.append(array)
        self._numbers = Numbers(self.numbers, [*mine.blocks, *varying])
        del self._mine, self._other, self.owners, self.numbers, self._named

    def of(self, made: Made) -> tuple[Integers64, list[Array]] | None:
        """The numbers for a call, and what owns the memory that varies; None if it lies otherwise.

        All of it has to stay as long as the numbers are used.
        """
        varying = list[Array]()
        for each in self._varying:
            array = each.of(made)
            if each.lies is not None and lies(array) != each.lies:
                return None
            varying.append(array)
        begins: list[Any] = [*map(address, made.blocks), *map(address, varying)]
        return self._numbers.at(begins), varying
