"""Room for the matrices of a sweep, which is given with each call."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.wholes import Address

# Floats of a line of the cache, where each matrix begins.
LINE = 8
_OWN = "%frame"


class Frame:
    """Room at an address, taken piece by piece as code is written."""

    def __init__(self, code: Code, address: Address) -> None:
        self._code, self._address = code, address
        self._used = 0
        self.size = 0  # floats in all

    @classmethod
    def of_function(cls, code: Code) -> Frame:
        """Room of a function's own, for matrices that are not too many; it ends by `settle`."""
        return cls(code, Address(code, _OWN))

    def settle(self) -> None:
        """Reserve the room of a function's own, once all of it is taken."""
        if self.size:
            self._code.reserve(f"[{self.size} x double]", 8 * LINE, _OWN)

    def take(self, floats: int) -> Address:
        """Room for so many floats, until the end of the innermost `scratch`."""
        place, self._used = self._used, self._used + -(-floats // LINE) * LINE
        self.size = max(self.size, self._used)
        return self._address + place

    @contextmanager
    def scratch(self) -> Iterator[None]:
        """Room that is taken inside is free again after it."""
        used = self._used
        yield
        self._used = used

    def with_room(self, function: Callable[..., None]) -> Callable[..., None]:
        """The function, given room of its own with each call as its last argument."""
        size = self.size

        def called(*given: int) -> None:
            room = np.empty(size + LINE)
            address: int = room.__array_interface__["data"][0]
            function(*given, address + -address % (8 * LINE))

        return called
