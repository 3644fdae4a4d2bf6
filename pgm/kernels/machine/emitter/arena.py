"""Room on a card for arrays that stay there, taken piece by piece of one allocation."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.kernels.arrays import Array, address
from pgm.kernels.machine.emitter.driver import Device

# Pieces begin at multiples of so many bytes, as allocations of the driver do.
_LINE = 256
_FLOAT = 8


class Arena:
    """Memory of a card from an address on, of which pieces are taken in order.

    Without a card it has no end, and nothing is copied: `most` tells how many bytes are taken.
    """

    def __init__(self, card: Device | None = None, place: int = 0, size: int = 0) -> None:
        self.card, self._place, self._size = card, place, size
        self._used = self.most = 0

    def floats(self, count: int) -> int:
        """The address of room for so many floats."""
        place, self._used = self._place + self._used, self._used + padded(count)
        self.most = max(self.most, self._used)
        if self.card is not None and self._used > self._size:
            raise MemoryError(f"an arena of {self._size} bytes has no room for {count} floats")
        return place

    def put(self, array: npt.NDArray[Any]) -> int:
        """The address of a copy of an array of numbers of 64 bits, contiguous in C's order."""
        array = np.ascontiguousarray(array)
        place = self.floats(array.size)
        self.renew(place, array)
        return place

    def renew(self, place: int, array: npt.NDArray[Any]) -> None:
        """Copy an array to room that has been taken for it."""
        array = np.ascontiguousarray(array)
        if array.size and self.card is not None:
            self.card.put(place, address(array), array.nbytes)

    def get(self, place: int, shape: tuple[int, ...]) -> Array:
        """A copy here of the floats at an address, in C's order."""
        found = np.empty(shape)
        if found.size and self.card is not None:
            self.card.get(place, address(found), found.nbytes)
        return found

    @contextmanager
    def scratch(self) -> Iterator[None]:
        """A context; room that is taken in it is free again after it."""
        used = self._used
        try:
            yield
        finally:
            self._used = used


def padded(floats: int) -> int:
    """The bytes that room for so many floats takes of an arena."""
    return -(-max(floats, 1) * _FLOAT // _LINE) * _LINE
