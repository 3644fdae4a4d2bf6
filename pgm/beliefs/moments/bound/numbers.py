"""The numbers of a bound call's tables, of which some are addresses that vary from call to call."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.array_utils import byte_bounds

from pgm.beliefs.moments.bound.call import Made
from pgm.beliefs.moments.compiled.table import Get, Integers64
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import Array, address
from pgm.variables import Variable


class Numbers:
    """Whole numbers of which some are addresses, in arrays that are others in each call."""

    def __init__(self, numbers: Sequence[int], arrays: Sequence[Array]) -> None:
        self._rest = np.array(numbers, dtype=np.int64)
        self._inside = np.zeros((len(arrays), len(numbers)), dtype=np.int64)
        for row, array in zip(self._inside, arrays, strict=True):
            # Of an array that repeats its rows there are fewer bytes than it counts.
            first, last = byte_bounds(array)
            row[:] = (self._rest >= first) & (self._rest < last)
            self._rest -= row * address(array)

    def at(self, begins: Sequence[int]) -> Integers64:
        """The numbers where the arrays begin at these addresses."""
        found: Integers64 = self._rest + np.array(begins, dtype=np.int64) @ self._inside
        return found


class Varying(NamedTuple):
    """An array that is another one in each call.

    It is found in the evidence itself by `way`; where that is None, `owner` has it, a number of the
    plan's, and is asked for it by `get`. `lies` is as of `Named`.
    """

    way: Way | None
    owner: int
    get: Get
    lies: tuple[Any, ...] | None

    def of(self, made: Made) -> Array:
        """The array in a call."""
        if self.way is None:
            found: Array = self.get(made.owners[self.owner])
            return found
        return self.way.of(made.evidence)


class Way(NamedTuple):
    """Where an array stands in evidence: as values of a reading, or of a parent, there or not."""

    place: int
    sensor: bool
    parent: Variable | None

    def of(self, evidence: BoundEvidence) -> Array:
        """The array of this evidence."""
        if self.parent is None:
            return evidence.readings[self.place].values
        if self.sensor:
            return evidence.readings[self.place].inputs[self.parent]
        return evidence.transition[self.place][self.parent]


def ways(evidence: BoundEvidence) -> Iterator[tuple[int, Way]]:
    """The identities of evidence's arrays of numbers, each with the way to it."""
    for k, inputs in enumerate(evidence.transition):
        yield from ((id(values), Way(k, False, parent)) for parent, values in inputs.items())
    for k, reading in enumerate(evidence.readings):
        yield id(reading.values), Way(k, True, None)
        yield from ((id(own), Way(k, True, parent)) for parent, own in reading.inputs.items())
