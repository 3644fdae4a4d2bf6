"""The memory of arrays, as machine code is given it."""

from __future__ import annotations

from ctypes import addressof, c_char
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.kernels.arrays import Array


def address(array: npt.NDArray[Any]) -> int:
    """Where an array's memory begins."""
    if array.flags.carray and array.size:  # which takes a fifth of the time
        return addressof(c_char.from_buffer(array))
    found: int = array.__array_interface__["data"][0]
    return found


def aligned(floats: int, width: int) -> Array:
    """Memory for so many floats, which begins at a multiple of `width` bytes."""
    spare = width // 8
    room = np.empty(floats + spare)
    begin = -(address(room) // 8) % spare
    return room[begin : begin + floats]
