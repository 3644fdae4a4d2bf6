"""What the C library's allocator does with memory that is freed between steps."""

from __future__ import annotations

import numpy as np

# Just below the largest size by which glibc raises its thresholds, 32 MiB.
_SIZE = 31 * 2**20


def retain() -> None:
    """Have the allocator keep what is freed between steps, rather than fetch it anew each time.

    By default glibc gives freed memory back to the system above a threshold that grows with the
    largest block freed so far; arrays of a step of many runs are above it, and every page of the
    next step's would be faulted in again, which costs more than the arithmetic. A block that is
    made and freed untouched raises the threshold. It costs microseconds and needs no memory; on
    other systems it does nothing.
    """
    np.empty(_SIZE, dtype=np.uint8)
