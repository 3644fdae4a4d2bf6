"""Resources of a machine: memory, refused before it is taken, threads, and optional packages."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import pairwise
from threading import Thread
from typing import Any

import numpy as np

from pgm.errors import ModelError, PgmError

# Bytes of a number in double precision.
NUMBER = 8
# More than this no float holds.
_COUNTLESS = 10**300
# Just below the largest size by which glibc raises its thresholds, 32 MiB.
_SIZE = 31 * 2**20
# Numbers to copy that repay a thread.
APIECE = 2**17
# Where the system does not tell.
_UNKNOWN = 64 * 2**30


def retain() -> None:
    """Have the allocator keep freed memory between steps instead of returning it.

    By default glibc gives freed memory back above a threshold that grows with the largest block
    freed; every page of the next step's arrays, of many runs, would be faulted in again, which
    costs more than the arithmetic. A block that is made and freed untouched raises the threshold;
    on other systems it does nothing.
    """
    np.empty(_SIZE, dtype=np.uint8)


# Fewer values than this are not worth it.
_LASTING = 1000


@contextmanager
def uncollected(count: int) -> Iterator[None]:
    """Put off the search for cyclic garbage while a number of values are made that stay.

    Python searches the more often the more values there are, each time among all of them: of a
    network of 300,000 CPDs that takes as long as making it does, and finds nothing. What reference
    counts free is freed as ever. Afterwards searching is as it was; no user's code runs meanwhile.
    """
    if count < _LASTING or not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


# So many doubles are a megabyte.
_FEW = 2**17


def most_memory() -> int:
    """Bytes that arrays may take: the machine's memory, or the process's share."""
    try:
        found = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        import resource  # here, since not every system has it

        share, _ = resource.getrlimit(resource.RLIMIT_AS)
        return min(found, share) if share != resource.RLIM_INFINITY else found
    except (AttributeError, ImportError, OSError, ValueError):
        return _UNKNOWN


def gibibytes(entries: float) -> str:
    """The memory of numbers in double precision, for messages."""
    return f"{min(entries, _COUNTLESS) * NUMBER / 2**30:.3g} GiB"


def require_memory(
    entries: int, what: str, advice: str, *, error: type[PgmError] = ModelError, **where: Any
) -> None:
    """Refuse arrays of so many doubles that this machine's memory cannot hold them.

    `what` names the arrays in the message, `advice` the way out; `where` are the objects concerned.
    """
    if entries < _FEW:  # which every machine holds
        return
    limit = most_memory()
    if entries * NUMBER > limit:
        raise error(
            f"{what} would take {gibibytes(entries)} or more, where this machine has "
            f"{gibibytes(limit / NUMBER)}; {advice}",
            **where,
        )


def in_threads(work: Callable[[int, int], object], count: int, threads: int) -> None:
    """Do work, which must not fail, on shares of a count, from one to another, in so many threads.

    This thread is one of them.
    """
    edges = [k * count // threads for k in range(threads + 1)]
    others = [Thread(target=work, args=share) for share in pairwise(edges[1:])]
    for each in others:
        each.start()
    try:
        work(*edges[:2])
    finally:
        for each in others:
            each.join()


FRAMES = "sepset[frames]"
FILES = "sepset[files]"


def optional(module: str, what: str, requirement: str) -> Any:
    """A module that may not be installed: `what` needs it, pip installs it by `requirement`."""
    try:
        return import_module(module)
    except ImportError as error:
        raise ImportError(
            f"{what} needs {module.partition('.')[0]}: pip install '{requirement}'", name=module
        ) from error
