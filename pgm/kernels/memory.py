"""The memory of the machine, and the allocator's use of it between steps."""

from __future__ import annotations

import os

import numpy as np

# Just below the largest size by which glibc raises its thresholds, 32 MiB.
_SIZE = 31 * 2**20
# Where the system does not tell.
_UNKNOWN = 64 * 2**30


def retain() -> None:
    """Have the allocator keep what is freed between steps, rather than fetch it anew each time.

    By default glibc gives freed memory back above a threshold that grows with the largest block
    freed; every page of the next step's arrays, of many runs, would be faulted in again, which
    costs more than the arithmetic. A block that is made and freed untouched raises the threshold;
    on other systems it does nothing.
    """
    np.empty(_SIZE, dtype=np.uint8)


def most() -> int:
    """Bytes that arrays may take at the most: the machine's memory, or the process's share."""
    try:
        found = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        import resource  # here, since not every system has it

        share, _ = resource.getrlimit(resource.RLIMIT_AS)
        return min(found, share) if share != resource.RLIM_INFINITY else found
    except (AttributeError, ImportError, OSError, ValueError):
        return _UNKNOWN
