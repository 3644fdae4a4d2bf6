"""Values on their way to other processes: pickles, from which large arrays travel apart.

A pipe moves numbers more slowly than a filter computes them. A *parcel* is one or more pickles and
the large arrays of all of them, which are copied to one block of memory. The numbers of an array
are copied in the order in which they lie in memory, and those that are repeated along a broadcast
axis only once. In place of each such array the pickle has its *place*: where its numbers lie, and
how they are read. An array in a block that both processes see (`shared_memory`) is not copied: such
a block is the *room*, into which workers write their results.
"""

from __future__ import annotations

import io
import itertools
import mmap
import pickle
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.workers.shared_memory import Name, Room, address, lines, seen

# Bytes from which on an array is large, and put apart.
_LARGE = 2**12

AnyArray = npt.NDArray[Any]


class _Place(NamedTuple):
    """Where an array is, as it stands in a pickle in place of the array.

    `memory` says where its numbers are: in an array that is pickled with the place, in the shared
    block of a name, or, if it is None, in the parcel's own block. `offset` is in bytes from the
    beginning of that memory; the other fields are how the array views it.
    """

    memory: AnyArray | Name | None
    offset: int
    dtype: np.dtype[Any]
    strides: tuple[int, ...]
    shape: tuple[int, ...]
    writeable: bool


class Pickle(NamedTuple):
    """A pickled value, and the large arrays that no earlier pickle of its parcel has referred to.

    `arrays` has pairs: the offset in the parcel's block, in bytes, and the array.
    """

    data: bytes
    arrays: list[tuple[int, AnyArray]]

    def fill(self, memory: mmap.mmap) -> None:
        """Copy the arrays to their offsets in `memory`, which has at least the parcel's `size`."""
        for offset, array in self.arrays:
            np.ndarray(array.shape, array.dtype, memory, offset)[...] = array


class Parcel:
    """Pickles whose large arrays travel apart from them, in one block of memory.

    apart: Whether large arrays (4 KiB or more) go to a block, which the caller makes; if not, all
        arrays stay in the pickles.
    shared: Whether several processes read the block; writeable arrays then stay in the pickles.
    room: The arrays for workers' results, in a shared block; an array that lies in that block is
        pickled as its place there. None if there are none.
    size: How many bytes the block needs for the arrays of all pickles so far.
    """

    def __init__(self, *, apart: bool, shared: bool = False, room: Room | None = None) -> None:
        self.apart = apart
        self.shared = shared
        self.room = room
        self.size = 0
        self._put: dict[Any, tuple[int, AnyArray]] = {}

    def dumps(self, value: Any) -> Pickle:
        """Pickle a value, and allot its large arrays their offsets in the parcel's block."""
        file = io.BytesIO()
        before = len(self._put)
        _Pickler(self, file).dump(value)
        return Pickle(file.getvalue(), list(itertools.islice(self._put.values(), before, None)))

    def place(self, array: AnyArray) -> _Place | None:
        """The place of an array, to be pickled in its stead; None if it is to be pickled as usual.

        The first of these cases that fits decides:

        - an array in the room has its place there;
        - an array of objects, or of a subclass, is pickled as usual;
        - a large array, if the parcel has a block for it, is put there, once however often it is
          pickled;
        - an array that is contiguous in C order is pickled as usual;
        - of any other array the place itself has the numbers, in the order in which they lie in
          memory.
        """
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
    """A pickler that writes the places of arrays in their stead, as the `parcel` decides."""

    def __init__(self, parcel: Parcel, file: io.BytesIO) -> None:
        super().__init__(file, protocol=5)
        self._parcel = parcel

    def persistent_id(self, value: Any) -> _Place | None:
        return self._parcel.place(value) if isinstance(value, np.ndarray) else None


class _Unpickler(pickle.Unpickler):
    """An unpickler that makes arrays at their places in memory, without a copy.

    `own` is the block of the parcel, mapped into this process; None if it has none.
    """

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
    """The value of a pickle; `own` is the block of its parcel, None if that has none."""
    return _Unpickler(io.BytesIO(data), own).load()


def refuse(named: Sequence[Any], error: Exception) -> ModelError:
    """The `ModelError` to raise where pickling has raised `error`.

    It names the first of the objects `named` that cannot be pickled, such as CPDs, with the part of
    it that is at fault, and why; if all of them can be pickled, it has the words of `error`.
    """
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
    """Why a value cannot be pickled, or None if it can."""
    try:
        pickle.dumps(value)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None
