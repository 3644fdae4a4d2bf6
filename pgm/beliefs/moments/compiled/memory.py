"""Memory that begins where machine code needs it to."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array, address


def aligned(floats: int, width: int) -> Array:
    """Memory for so many floats, which begins at a multiple of `width` bytes."""
    spare = width // 8
    room = np.empty(floats + spare)
    begin = -(address(room) // 8) % spare
    return room[begin : begin + floats]
