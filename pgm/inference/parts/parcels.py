"""Values on their way to other processes: pickles, and memory that processes share (Linux).

A pipe moves numbers more slowly than a filter makes them. Large arrays travel apart from the
pickle, as they lie in memory, runs fastest, and what is broadcast once; of those in a block that
both processes see only the places do. A block is a file without a name or a disk, gone when no
process has it any more; since the first use of fresh memory costs as much as a filter, blocks are
kept for the next call with the same executor.
"""

from __future__ import annotations

import io
import itertools
import math
import mmap
import os
import pickle
import weakref
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array

if TYPE_CHECKING:
    from concurrent.futures import Executor

# Blocks of an executor that wait for its next call.
_IDLE = 3
# Blocks that a worker keeps in sight.
_SEEN = 4
# Arrays in a block begin at lines of the processor's cache.
LINE = 64

# Leading axes, the last of runs, and own ones.
Shape = tuple[tuple[int, ...], tuple[int, ...]]

_NUMBERS = itertools.count()
_idle: weakref.WeakKeyDictionary[Executor, list[Block]] = weakref.WeakKeyDictionary()


class Name(NamedTuple):
    """The name of a block in other processes: its maker, number, file and size."""

    process: int
    number: int
    file: int
    size: int

    def open(self, size: int | None = None) -> mmap.mmap:
        """The memory, made larger before if a size is given."""
        file = os.open(f"/proc/{self.process}/fd/{self.file}", os.O_RDWR)
        try:
            if size is not None:
                os.ftruncate(file, size)
            return mmap.mmap(file, self.size if size is None else size)
        finally:
            os.close(file)


@lru_cache(_SEEN)
def seen(name: Name) -> mmap.mmap:
    """A shared block mapped in a worker, kept mapped: pages used once cost nothing again."""
    return name.open()


class Block:
    """A growable block of shared memory."""

    def __init__(self) -> None:
        self.file = os.memfd_create("pgm")
        self.number = next(_NUMBERS)
        self.size = 0
        self._memory: mmap.mmap | None = None
        weakref.finalize(self, os.close, self.file)

    @property
    def name(self) -> Name:
        """Its name, as it is now."""
        return Name(os.getpid(), self.number, self.file, self.size)

    def hold(self, size: int, *, anew: bool = False) -> mmap.mmap:
        """The memory, of so many bytes at least; seen anew, as nobody else sees it."""
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
    """Uninitialised arrays in one shared block, which workers fill in; kept once it is `done`."""

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
        """The offset of an array; None, if it is of other memory."""
        found = address(array) - self._start
        return found if 0 <= found < self.block.size else None

    def done(self, idle: list[Block]) -> None:
        """Keep the block, once nobody looks at it any more."""
        weakref.finalize(self._memory, keep, idle, self.block)


def idle_blocks(executor: Executor) -> list[Block] | None:
    """The blocks that wait for an executor's next call; None, if it shares no memory with us."""
    from concurrent.futures import ProcessPoolExecutor  # here, since few need it

    if not isinstance(executor, ProcessPoolExecutor):
        return None
    if not hasattr(os, "memfd_create") or not os.path.isdir("/proc/self/fd"):
        return None
    return _idle.setdefault(executor, [])


def borrow(idle: list[Block], size: int) -> Block:
    """The idle block that fits best, or a new one."""
    fitting = sorted(idle, key=lambda block: (block.size < size, abs(block.size - size)))
    for block in fitting:
        try:
            idle.remove(block)
        except ValueError:  # another thread was faster
            continue
        return block
    return Block()


def keep(idle: list[Block], block: Block) -> None:
    """Keep a block for another call."""
    if len(idle) < _IDLE:
        idle.append(block)


def lines(size: int) -> int:
    """Bytes rounded up to whole cache lines."""
    return -(-size // LINE) * LINE


def address(array: npt.NDArray[Any]) -> int:
    """The address of an array in this process's memory."""
    found: int = array.__array_interface__["data"][0]
    return found


# Bytes from which on an array is large, and put apart.
_LARGE = 2**12

AnyArray = npt.NDArray[Any]


class _Place(NamedTuple):
    """An array: its memory (itself, a block, or None, the parcel's own), and how it is seen."""

    memory: AnyArray | Name | None
    offset: int
    dtype: np.dtype[Any]
    strides: tuple[int, ...]
    shape: tuple[int, ...]
    writeable: bool


class Pickle(NamedTuple):
    """A value as bytes, and its large arrays, unless an earlier pickle has brought them."""

    data: bytes
    arrays: list[tuple[int, AnyArray]]

    def fill(self, memory: mmap.mmap) -> None:
        """Put the arrays in memory of the parcel's size."""
        for offset, array in self.arrays:
            np.ndarray(array.shape, array.dtype, memory, offset)[...] = array


class Parcel:
    """Pickles whose large arrays are put in one piece of memory, or stay where they are shared.

    If `apart`, there is memory to put them in; if `shared`, several processes see it, and arrays
    that can be written to do not go there. Of arrays in `room` only the places travel.
    """

    def __init__(self, *, apart: bool, shared: bool = False, room: Room | None = None) -> None:
        self.apart = apart
        self.shared = shared
        self.room = room
        self.size = 0
        self._put: dict[Any, tuple[int, AnyArray]] = {}

    def dumps(self, value: Any) -> Pickle:
        """The pickle of a value."""
        file = io.BytesIO()
        before = len(self._put)
        _Pickler(self, file).dump(value)
        return Pickle(file.getvalue(), list(itertools.islice(self._put.values(), before, None)))

    def place(self, array: AnyArray) -> _Place | None:
        """The place of an array in the parcel; None if it is pickled as any object."""
        seen = (array.dtype, array.strides, array.shape, array.flags.writeable)
        if self.room is not None and (offset := self.room.offset(array)) is not None:
            return _Place(self.room.block.name, offset, *seen)
        apart = self.apart and array.nbytes >= _LARGE
        apart = apart and not (self.shared and array.flags.writeable)
        if array.dtype.hasobject or type(array) is not np.ndarray:
            return None
        if not apart and array.flags.c_contiguous:
            return None
        once = array[tuple(slice(1 if step == 0 else None) for step in array.strides)]
        order = sorted(range(array.ndim), key=lambda axis: -abs(array.strides[axis]))
        memory = once.transpose(order)
        strides = [0] * array.ndim  # as they will be, the memory being contiguous
        step = array.itemsize
        for axis, length in zip(reversed(order), reversed(memory.shape), strict=True):
            strides[axis] = step if array.strides[axis] else 0
            step *= length
        seen = (array.dtype, tuple(strides), array.shape, array.flags.writeable)
        if not apart:
            return _Place(np.ascontiguousarray(memory), 0, *seen)
        key = address(array), array.strides, array.shape, array.dtype
        if key not in self._put:  # what all runs share is put once
            self._put[key] = self.size, memory
            self.size += lines(memory.nbytes)
        return _Place(None, self._put[key][0], *seen)


class _Pickler(pickle.Pickler):
    def __init__(self, parcel: Parcel, file: io.BytesIO) -> None:
        super().__init__(file, protocol=5)
        self._parcel = parcel

    def persistent_id(self, value: Any) -> _Place | None:
        return self._parcel.place(value) if isinstance(value, np.ndarray) else None


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, own: mmap.mmap | None) -> None:
        super().__init__(file)
        self._own = own

    def persistent_load(self, place: _Place) -> AnyArray:
        memory = place.memory
        source: Any = self._own if memory is None else memory
        if isinstance(memory, Name):
            source = seen(memory)
        array = np.ndarray(place.shape, place.dtype, source, place.offset, place.strides)
        array.flags.writeable = place.writeable
        return array


def loads(data: bytes, own: mmap.mmap | None) -> Any:
    """The value of a pickle, whose parcel filled that memory."""
    return _Unpickler(io.BytesIO(data), own).load()


def refuse(named: Sequence[Any], error: Exception) -> ModelError:
    """The error that says which of some objects cannot be pickled, and which part of it."""
    for each in named:
        fault = _fault(each)
        if fault is None:
            continue
        parts = each.__getstate__() if isinstance(each, Immutable) else {}
        parts = {name: value for name, value in parts.items() if _fault(value) is not None}
        part = next((f"the {name} of " for name in parts), "")
        child = getattr(each, "child", None)
        return ModelError(
            f"{part}{each!r} cannot be handed to another process: {fault}; let it be a function or "
            "a class that stands in a module by name, no lambda and none within a function, or "
            "give a ThreadPoolExecutor",
            variable=child,
            cpd=each if child is not None else None,
        )
    return ModelError(f"what the workers would be handed cannot be pickled: {error}")


def _fault(value: Any) -> str | None:
    try:
        pickle.dumps(value)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None
