"""Shared memory between processes of one machine, where the system has it (Linux).

A *block* is a file in memory, without a name, which is gone when no process has it open any more.
Since the first use of fresh memory costs as much as a filter, blocks are kept for the next call
with the same executor. A *room* is a block with arrays for the results of workers.
"""

from __future__ import annotations

import itertools
import math
import mmap
import os
import weakref
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.kernels.arrays import Array

if TYPE_CHECKING:
    from concurrent.futures import Executor


# The most blocks of an executor that wait for its next call.
_IDLE = 3
# The most blocks that a worker keeps mapped.
_SEEN = 4
# Arrays in a block begin at lines of the processor's cache.
LINE = 64

# Of an array: its leading axes, the last of them runs, and its own ones.
Shape = tuple[tuple[int, ...], tuple[int, ...]]

_NUMBERS = itertools.count()
_idle: weakref.WeakKeyDictionary[Executor, list[Block]] = weakref.WeakKeyDictionary()


class Name(NamedTuple):
    """The name by which other processes open a block.

    It has the id of the process that made the block, the block's number there, its file descriptor
    and its size in bytes. The number tells apart blocks that had the same descriptor one after
    another.
    """

    process: int
    number: int
    file: int
    size: int

    def open(self, size: int | None = None) -> mmap.mmap:
        """Map the block into this process; with a `size` it is first made so large, in bytes."""
        file = os.open(f"/proc/{self.process}/fd/{self.file}", os.O_RDWR)
        try:
            if size is not None:
                os.ftruncate(file, size)
            return mmap.mmap(file, self.size if size is None else size)
        finally:
            os.close(file)


@lru_cache(_SEEN)
def seen(name: Name) -> mmap.mmap:
    """The block of a name, mapped in a worker; the last four mappings are kept for further calls.

    Memory that a mapping has used once costs nothing to use again.
    """
    return name.open()


class Block:
    """A growable block of shared memory.

    `file` is its descriptor in this process, which has made it; `number` is its own among the
    blocks of the process, and `size` is in bytes.
    """

    def __init__(self) -> None:
        self.file = os.memfd_create("pgm")
        self.number = next(_NUMBERS)
        self.size = 0
        self._memory: mmap.mmap | None = None
        weakref.finalize(self, os.close, self.file)

    @property
    def name(self) -> Name:
        """The present name of the block, by which other processes open it."""
        return Name(os.getpid(), self.number, self.file, self.size)

    def hold(self, size: int, *, anew: bool = False) -> mmap.mmap:
        """The block mapped into this process, first enlarged to `size` bytes if it has fewer.

        With `anew` a new mapping is made, which the block does not keep; without it, all calls
        return one mapping, which the block keeps until it is enlarged.
        """
        if size > self.size or not self.size:
            self.size, self._memory = max(size, 1), None
            os.ftruncate(self.file, self.size)
        if anew or self._memory is None:
            memory = mmap.mmap(self.file, self.size)
            if anew:
                return memory
            self._memory = memory
        return self._memory


class Room:
    """Uninitialised arrays in one shared block, which workers fill in.

    `arrays` has one array of float64 for each of `shapes`. A shape is a pair: the lengths of the
    leading axes, the last of which is of runs, and those of the array's own axes, such as (n, n) of
    a covariance. In memory the axis of runs varies fastest. The block is taken from the list
    `idle`, or made if that is empty.
    """

    def __init__(self, idle: list[Block], shapes: Sequence[Shape]) -> None:
        sizes = [lines(8 * math.prod(lead) * math.prod(own)) for lead, own in shapes]
        edges = [0, *itertools.accumulate(sizes)]
        self.block = borrow(idle, edges[-1])
        self._memory = self.block.hold(edges[-1], anew=True)
        self._start = address(np.frombuffer(self._memory, np.uint8))
        self.arrays: list[Array] = []
        for ((*before, runs), own), edge in zip(shapes, edges, strict=False):
            array = np.ndarray((*before, *own, runs), np.float64, self._memory, edge)
            self.arrays.append(np.moveaxis(array, -1, len(before)))

    def offset(self, array: npt.NDArray[Any]) -> int | None:
        """The offset of an array in the block, in bytes; None if it lies elsewhere."""
        found = address(array) - self._start
        return found if 0 <= found < self.block.size else None

    def done(self, idle: list[Block]) -> None:
        """Give the block back to `idle` when no array refers to it any more."""
        weakref.finalize(self._memory, keep, idle, self.block)


def idle_blocks(executor: Executor) -> list[Block] | None:
    """The blocks that wait for an executor's next call; None if it cannot share memory.

    Only a `ProcessPoolExecutor` on Linux can.
    """
    from concurrent.futures import ProcessPoolExecutor  # here, since few need it

    if not isinstance(executor, ProcessPoolExecutor):
        return None
    if not hasattr(os, "memfd_create") or not os.path.isdir("/proc/self/fd"):
        return None
    return _idle.setdefault(executor, [])


def borrow(idle: list[Block], size: int) -> Block:
    """Take the block that fits a size best out of the list `idle`; make one if that is empty.

    It is the smallest of at least `size` bytes, or else the largest, which `hold` enlarges.
    """
    fitting = sorted(idle, key=lambda block: (block.size < size, abs(block.size - size)))
    for block in fitting:
        try:
            idle.remove(block)
        except ValueError:  # another thread was faster
            continue
        return block
    return Block()


def keep(idle: list[Block], block: Block) -> None:
    """Put a block into the list `idle`, to be used again, unless three wait there already."""
    if len(idle) < _IDLE:
        idle.append(block)


def lines(size: int) -> int:
    """A number of bytes rounded up to whole cache lines."""
    return -(-size // LINE) * LINE


def address(array: npt.NDArray[Any]) -> int:
    """The address of an array in this process's memory."""
    found: int = array.__array_interface__["data"][0]
    return found
